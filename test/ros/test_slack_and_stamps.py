"""Slack, stamps, tuning and diagnostics by themselves, with a clock and a runner made up."""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from unicon_core.runtime import Pacing
from unicon_ros.bridge import bindings
from unicon_ros.bridge import services as slack
from unicon_ros.bridge.bindings import WallStamp
from unicon_ros.bridge.services import Controls, SlackServer
from unicon_ros.compat import Piece, services

MS = 1_000_000


class Clock:
    """Stands for `time` in the modules under test; advances as told."""

    def __init__(self) -> None:
        self.now = 1_000 * MS

    def perf_counter_ns(self) -> int:
        return self.now

    def time_ns(self) -> int:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += round(seconds * 1e9)


class Services:
    """Stands for `compat.Serving`: a round of pieces, each of which takes its time."""

    def __init__(self, clock: Clock, cost_ns: int, pieces: int = 1) -> None:
        self.clock, self.cost_ns, self.pieces = clock, cost_ns, pieces
        self.ready = self.rounds = 0
        self.found: list[str] = []
        self.called: list[str] = []

    def round(self) -> Iterator[Piece]:
        for _ in range(self.pieces):
            yield Piece("service", self.ask)
            yield from self.callbacks()
        self.rounds += 1

    def callbacks(self) -> Iterator[Piece]:
        while self.found:
            yield Piece("callback", self.call)

    def ask(self) -> bool:
        self.clock.now += self.cost_ns
        if not self.ready:
            return False
        self.ready -= 1
        self.found.append("request")
        return False

    def call(self) -> bool:
        self.called.append(self.found.pop())
        return True


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    made = Clock()
    monkeypatch.setattr(slack, "time", made)
    monkeypatch.setattr(bindings, "time", made)
    return made


def served(clock: Clock, services: Any, period_ns: int, lead_ns: int = 300_000) -> SlackServer:
    server = SlackServer(None, print)
    server._serving = services
    runner = SimpleNamespace(
        next_due_ns=0, period_ns=period_ns, lead_ns=lead_ns, pacing=Pacing(spin_us=100.0)
    )
    server.runner = runner  # type: ignore[assignment]
    return server


def run_ticks(
    clock: Clock, server: SlackServer, ticks: int, period_ns: int, tick_ns: int
) -> list[int]:
    """Tick on a fixed grid; return by how much each tick's start was late."""
    due, late = clock.now, []
    for _ in range(ticks):
        late.append(max(0, clock.now - due))
        clock.now = max(clock.now, due) + tick_ns
        due += period_ns
        server.runner.next_due_ns = due  # type: ignore[union-attr]
        server()
    return late


def test_services_are_asked_25_times_a_second_and_never_make_a_tick_late(clock: Clock) -> None:
    services = Services(clock, 200_000)
    server = served(clock, services, 2 * MS)
    late = run_ticks(clock, server, 500, 2 * MS, 300_000)
    assert max(late) == 0
    assert 20 <= services.rounds <= 26


def test_a_round_that_is_longer_than_the_slack_is_done_over_several_ticks(clock: Clock) -> None:
    services = Services(clock, 90_000, pieces=15)  # 1.35 ms in a slack of 0.2
    server = served(clock, services, MS, lead_ns=500_000)
    ends = []
    for _ in range(1000):
        run_ticks(clock, server, 1, MS, 300_000)
        due = server.runner.next_due_ns  # type: ignore[union-attr]
        ends.append(due - clock.now)
        clock.now = due
    assert min(ends) >= 500_000  # the warm-up had its time in every tick
    assert services.rounds >= 18
    assert server.forced == 0


def test_a_round_without_slack_takes_the_warm_ups_share_after_a_while_but_no_ticks_start(
    clock: Clock,
) -> None:
    services = Services(clock, 20_000, pieces=15)
    server = served(clock, services, MS, lead_ns=800_000)
    late = run_ticks(clock, server, 1000, MS, 300_000)
    assert max(late) == 0
    assert services.rounds >= 15


def test_a_flood_is_served_in_the_slack_only(clock: Clock) -> None:
    services = Services(clock, 200_000)
    server = served(clock, services, 10 * MS)
    services.ready = 10_000
    late = run_ticks(clock, server, 500, 10 * MS, 300_000)
    assert max(late) == 0
    assert server.served > 400


def test_one_slow_callback_does_not_silence_services_for_long(clock: Clock) -> None:
    services = Services(clock, 100 * MS)
    server = served(clock, services, 5 * MS)
    services.ready = 1
    run_ticks(clock, server, 30, 5 * MS, 300_000)
    services.cost_ns = 100_000
    services.ready = 20
    run_ticks(clock, server, 400, 5 * MS, 300_000)
    assert services.ready == 0


def test_an_overloaded_loop_still_hears_all_its_services_once_a_second(clock: Clock) -> None:
    services = Services(clock, 200_000, pieces=5)
    server = served(clock, services, 2 * MS)
    run_ticks(clock, server, 2000, 2 * MS, 2 * MS)
    assert server.forced == services.rounds
    assert services.rounds in (3, 4)


def test_a_failing_callback_is_told_and_the_tick_goes_on(clock: Clock) -> None:
    told: list[str] = []

    class Failing(Services):
        def ask(self) -> bool:
            raise RuntimeError("mine")

    server = SlackServer(None, told.append)
    server._serving = Failing(clock, 0)  # type: ignore[assignment]
    clock.now += 60 * MS
    server()
    assert told == ["a ROS callback failed: RuntimeError: mine"]


def test_what_was_found_and_not_called_is_called_when_ticks_end(clock: Clock) -> None:
    services = Services(clock, 300_000)
    server = served(clock, services, MS, lead_ns=500_000)
    services.ready = 1
    clock.now = server._due_ns
    server.runner.next_due_ns = clock.now + 800_000  # type: ignore[union-attr]
    server()  # has time to ask, and none to call
    assert (services.found, services.called) == (["request"], [])
    server.rest()
    assert (services.found, services.called) == ([], ["request"])


@pytest.fixture
def answering(monkeypatch: pytest.MonkeyPatch) -> Any:
    """A service of a made-up node; `sent` holds what went out, `readers` who would hear it."""
    monkeypatch.setattr(services, "is_fast_dds", lambda: True)
    sent: list[str] = []
    readers: list[Any] = []
    service = SimpleNamespace(service_name="/n/reset", send_response=lambda r, h: sent.append(r))
    node = SimpleNamespace(
        services=[service], get_subscriptions_info_by_topic=lambda name, no_mangle: readers
    )
    return SimpleNamespace(node=node, service=service, sent=sent, readers=readers)


def test_a_response_is_kept_until_its_client_can_hear_it(answering: Any) -> None:
    responses = services.Responses()
    responses.watch(answering.node)
    answering.service.send_response("answer", None)
    responses.retry()
    assert answering.sent == []
    answering.readers.append("client")
    responses.retry()
    assert answering.sent == ["answer"]
    answering.service.send_response("at once", None)
    assert answering.sent == ["answer", "at once"]


def test_a_pause_sends_kept_responses_too(answering: Any) -> None:
    """No tick comes in a pause: a call of ~/step went unanswered."""
    server = SlackServer(None, list[str]().append)
    server.responses.watch(answering.node)
    answering.service.send_response("answer", None)
    server.spin(0.0)
    assert answering.sent == []
    answering.readers.append("client")
    server.spin(0.0)
    assert answering.sent == ["answer"]


def test_a_response_to_a_client_that_left_is_dropped(
    answering: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = Clock()
    monkeypatch.setattr(services, "time", made)
    responses = services.Responses()
    responses.watch(answering.node)
    answering.service.send_response("answer", None)
    made.now += services.Responses.PATIENCE_NS + 1
    responses.retry()
    assert (answering.sent, responses.dropped) == ([], 1)


def test_the_wall_stamp_is_the_source_plus_the_least_delayed_difference(clock: Clock) -> None:
    source = np.zeros((), np.int64)
    stamp = WallStamp(source)
    rng = np.random.default_rng(1)
    boot = 77 * 10**9
    for tick in range(3000):
        true = 5 * MS * tick + boot
        source[...] = true - boot
        delay = int(rng.integers(200_000, 3 * MS)) if tick else 100_000
        clock.now = true + delay
        stamp()
        assert true <= int(stamp.out) <= clock.now
        if tick > 10:
            assert int(stamp.out) - true < 400_000


def test_the_wall_stamp_without_a_source_is_now(clock: Clock) -> None:
    stamp = WallStamp(None)
    stamp()
    assert int(stamp.out) == clock.now


def test_the_wall_stamp_follows_a_clock_that_is_set(clock: Clock) -> None:
    source = np.zeros((), np.int64)
    stamp = WallStamp(source)
    for jump in (0, 3600 * 10**9, -7200 * 10**9):
        begin = clock.now + jump
        for tick in range(3000):
            source += 5 * MS
            clock.now = begin + 5 * MS * tick
            stamp()
        assert abs(int(stamp.out) - clock.now) < MS


def test_controls_refuse_what_a_real_robot_cannot_do() -> None:
    controls = Controls(lambda seconds: None)
    assert controls.reset() == (False, "nothing runs")
    facts = SimpleNamespace(name="unitree", simulated=False)
    platform = SimpleNamespace(facts=facts)
    controls.runner = SimpleNamespace(program=SimpleNamespace(platform=platform))  # type: ignore[assignment]
    for act in (controls.reset, controls.pause, controls.step):
        done, said = act()
        assert not done
        assert "'unitree' is a real robot" in said
