"""Slack, stamps, tuning and diagnostics by themselves, with a clock and a runner made up."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from unicon_core.runtime import Pacing
from unicon_ros.bridge import slack, stamps
from unicon_ros.bridge.controls import Controls
from unicon_ros.bridge.slack import SlackServer
from unicon_ros.bridge.stamps import WallStamp
from unicon_ros.compat import services

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


class Callbacks:
    """Stands for an executor: so many callbacks are ready, each takes its time."""

    def __init__(self, clock: Clock, cost_ns: int) -> None:
        self.clock, self.cost_ns = clock, cost_ns
        self.ready = self.looks = 0

    def serve(self) -> bool:
        self.clock.now += self.cost_ns
        self.looks += 1
        if self.ready:
            self.ready -= 1
            return True
        return False

    def get_nodes(self) -> list[Any]:
        return []


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    made = Clock()
    monkeypatch.setattr(slack, "time", made)
    monkeypatch.setattr(stamps, "time", made)
    return made


def served(clock: Clock, callbacks: Callbacks, period_ns: int) -> SlackServer:
    server = SlackServer(None, print)
    server._executor, server._serve = callbacks, callbacks.serve
    pacing = Pacing(dry_run_us=1000.0, spin_us=100.0)
    server.runner = SimpleNamespace(next_due_ns=0, period_ns=period_ns, pacing=pacing)  # type: ignore[assignment]
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


def test_services_are_looked_at_twenty_times_a_second_and_never_make_a_tick_late(
    clock: Clock,
) -> None:
    callbacks = Callbacks(clock, 200_000)
    server = served(clock, callbacks, 2 * MS)
    late = run_ticks(clock, server, 500, 2 * MS, 300_000)
    assert max(late) == 0
    assert 15 <= callbacks.looks <= 21


def test_a_flood_is_served_in_the_slack_only(clock: Clock) -> None:
    callbacks = Callbacks(clock, 200_000)
    server = served(clock, callbacks, 10 * MS)
    callbacks.ready = 10_000
    late = run_ticks(clock, server, 500, 10 * MS, 300_000)
    assert max(late) == 0
    assert server.served > 500


def test_one_slow_callback_does_not_silence_services_for_long(clock: Clock) -> None:
    callbacks = Callbacks(clock, 100 * MS)
    server = served(clock, callbacks, 5 * MS)
    callbacks.ready = 1
    run_ticks(clock, server, 30, 5 * MS, 300_000)
    callbacks.cost_ns = 100_000
    callbacks.ready = 20
    run_ticks(clock, server, 400, 5 * MS, 300_000)
    assert callbacks.ready == 0


def test_an_overloaded_loop_still_hears_a_service_once_a_second(clock: Clock) -> None:
    callbacks = Callbacks(clock, 200_000)
    server = served(clock, callbacks, 2 * MS)
    run_ticks(clock, server, 2000, 2 * MS, 2 * MS)
    assert server.forced in (3, 4)


def test_a_failing_callback_is_told_and_the_tick_goes_on(clock: Clock) -> None:
    told: list[str] = []

    def fail() -> bool:
        clock.now += 60 * MS
        raise RuntimeError("mine")

    server = SlackServer(None, told.append)
    server._executor, server._serve = Callbacks(clock, 0), fail
    clock.now += 60 * MS
    server()
    assert told == ["a ROS callback failed: RuntimeError: mine"] * len(told)
    assert told


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
