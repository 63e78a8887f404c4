"""What a host needs of the runner: actions between ticks, reset, deadlines, ticks on arrival."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from unicon_base.errors import PlatformError
from unicon_core.platforms.fake import FakePlatform
from unicon_core.runtime import Runner, RunOptions
from unicon_core.workflow import Program, load_workflow

pytestmark = pytest.mark.usefixtures("time_passes")

WORKFLOW = """\
schema: unicon.workflow/1
robot: go2
platform: fake
rate: 500
flow: {sway: {gains: {"*_hip_joint": [1.0, 0, 0]}}}
safety: [finite]
"""


@pytest.fixture
def workflow(tmp_path: Path) -> Callable[..., Program]:
    def load(*overrides: str) -> Program:
        path = tmp_path / "host.yaml"
        path.write_text(WORKFLOW)
        return load_workflow(path, overrides)

    return load


@pytest.mark.parametrize("speed", ["real", "max"])
def test_actions_run_between_two_ticks_in_their_order(
    workflow: Callable[..., Program], speed: Any
) -> None:
    runner = Runner(workflow(), RunOptions(speed=speed, duration=0.2))
    seen: list[tuple[str, int]] = []

    def first() -> None:
        seen.append(("first", runner.statistics.count))
        runner.call_soon(lambda: seen.append(("later", runner.statistics.count)))

    runner.call_soon(first)
    runner.call_soon(lambda: seen.append(("second", runner.statistics.count)))
    report = runner.run()
    assert seen == [("first", 0), ("second", 0), ("later", 1)]
    assert report.ticks == 100


def test_a_pause_does_not_count_into_the_rate(workflow: Callable[..., Program]) -> None:
    runner = Runner(workflow(), RunOptions(duration=0.4))  # 200 ticks of 2 ms

    def pause() -> None:
        time.sleep(0.6)
        for _ in range(10):  # single steps in it are ticks of the run, a period each
            runner.tick(time.perf_counter_ns())

    runner.call_soon(pause)
    report = runner.run()
    assert report.ticks == 200
    assert 0.5 < report.paused_s <= report.wall_s
    assert report.rate_hz == pytest.approx(
        report.ticks / (report.wall_s - report.paused_s), rel=0.02
    )
    assert f"s, paused for {report.paused_s:.2f} s of it, " in report.summary()


def test_a_run_without_a_pause_does_not_speak_of_one(workflow: Callable[..., Program]) -> None:
    runner = Runner(workflow(), RunOptions(speed="max", duration=0.1))
    runner.call_soon(lambda: None)
    report = runner.run()
    assert report.paused_s < 0.01
    assert "paused" not in report.summary()


@pytest.mark.alone
def test_a_long_action_is_no_overrun(workflow: Callable[..., Program]) -> None:
    loaded = workflow()
    runner = Runner(loaded, RunOptions(duration=0.1))
    overruns: list[int] = []

    def pause() -> None:
        overruns.append(runner.statistics.overruns)
        time.sleep(0.4)  # 200 periods

    runner.call_soon(pause)
    report = runner.run()
    assert overruns == [0]
    assert report.overruns < 150  # those of a busy machine


def test_reset_brings_a_simulator_back_to_time_0(workflow: Callable[..., Program]) -> None:
    loaded = workflow()
    runner = Runner(loaded)
    for _ in range(10):
        runner.tick(0)
    assert int(loaded.states.stamp_ns) == 9 * 2_000_000
    runner.reset()
    runner.tick(0)
    assert int(loaded.states.stamp_ns) == 0
    runner.close()


def test_the_next_deadline_is_a_period_after_the_present_one(
    workflow: Callable[..., Program],
) -> None:
    runner = Runner(workflow(), RunOptions(duration=0.05))
    assert runner.next_due_ns == 0
    runner.run()
    last = runner.statistics.kept()[-1]
    assert runner.next_due_ns == last[0] + runner.period_ns


def test_a_platform_that_cannot_wait_cannot_trigger(workflow: Callable[..., Program]) -> None:
    loaded = workflow("pacing={trigger: state}")
    with pytest.raises(PlatformError) as caught:
        Runner(loaded)
    loaded.close()
    assert str(caught.value) == (
        "platform 'fake' cannot tell when its data arrive; set pacing.trigger: deadline"
    )


def test_ticks_come_with_the_data_and_without_them_as_overruns(
    workflow: Callable[..., Program],
) -> None:
    loaded = workflow("pacing={trigger: state}")
    answers = [True] * 20 + [False] * 5 + [True] * 75
    waited: list[float] = []

    def wait(timeout: float) -> bool:
        waited.append(timeout)
        return answers[len(waited) - 1]

    loaded.platform.wait = wait  # type: ignore[attr-defined]
    report = Runner(loaded, RunOptions(duration=0.2)).run()
    assert report.ticks == 100
    assert report.overruns == 5
    assert set(waited) == {3e-9 * 2_000_000}


class Arrivals:
    """Data that come at an even interval into a queue of one."""

    def __init__(self, interval: float) -> None:
        self.interval = interval
        self.begin = time.monotonic()
        self.seen = self.taken = 0

    def newest(self) -> int:
        return int((time.monotonic() - self.begin) / self.interval)

    def wait(self, timeout: float) -> bool:
        end = time.monotonic() + timeout
        while self.newest() == self.seen:
            if time.monotonic() > end:
                return False
            time.sleep(0.0002)
        return True

    def take(self) -> None:
        if self.newest() > self.seen:
            self.seen = self.newest()
            self.taken += 1


@pytest.mark.alone
@pytest.mark.parametrize("interval", [0.002, 0.0125, 0.02])
def test_ticks_keep_their_rate_however_often_data_come(
    workflow: Callable[..., Program], interval: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    recv, rates = FakePlatform.recv, []

    def receive(platform: FakePlatform) -> bool | None:
        data.take()
        return recv(platform)

    monkeypatch.setattr(FakePlatform, "recv", receive)
    monkeypatch.setattr(FakePlatform, "wait", lambda _, t: data.wait(t), raising=False)
    monkeypatch.setattr(FakePlatform, "arrivals", lambda _: data.taken, raising=False)
    for _ in range(5):  # a machine that is busy otherwise may hold up a second of ticks
        data = Arrivals(interval)
        runner = Runner(workflow("pacing={trigger: state}", "rate=50"), RunOptions(duration=1.0))
        report = runner.run()
        assert data.taken >= report.ticks
        rows = runner.statistics.kept()
        rates.append((report.ticks - 1) / ((rows[-1, 2] - rows[0, 2]) * 1e-9))
        if rates[-1] == pytest.approx(50.0, rel=0.1):
            return
    pytest.fail(f"ticks per second: {rates}")
