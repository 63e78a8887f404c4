"""Ticks that come with the data, on a stand-in whose data arrive at a rate of their own."""

from __future__ import annotations

import os
import re
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from unicon_base.errors import PlatformError, WorkflowError
from unicon_core.flow import Stage
from unicon_core.pacing import staying
from unicon_core.runtime import Runner, RunOptions, ticker
from unicon_core.runtime.arrivals import awaited
from unicon_core.workflow import Program, load_workflow

pytestmark = pytest.mark.alone
TIME_PASSES = pytest.mark.usefixtures("time_passes")

WORKFLOW = """\
robot: go2
platform: fake
rate: 50
pacing: {trigger: state}
flow: {hold: {}}
safety: [finite]
"""


class Stream:
    """Data that arrive every `interval_ns`; `recv` takes in what has come."""

    def __init__(self, platform: Any, interval_ns: int) -> None:
        self.begin, self.interval = time.perf_counter_ns(), interval_ns
        self.taken: list[int] = []
        self.looks = 0
        self.ages: list[float] = []
        self._seen = -1
        self._recv = platform.recv
        platform.wait, platform.arrivals, platform.recv = self.wait, self.arrivals, self.recv

    def arrivals(self) -> int:
        return (time.perf_counter_ns() - self.begin) // self.interval

    def wait(self, timeout_s: float) -> bool:
        self.looks += not timeout_s
        end = time.perf_counter_ns() + timeout_s * 1e9
        while self.arrivals() == self._seen:
            if time.perf_counter_ns() > end:
                return False
            time.sleep(20e-6)
        return True

    def recv(self) -> None:
        self._seen = self.arrivals()
        now = time.perf_counter_ns()
        self.taken.append(self._seen)
        self.ages.append((now - self.begin) % self.interval / self.interval)
        self._recv()


def loaded(tmp_path: Path, *overrides: str) -> Program:
    path = tmp_path / "triggered.yaml"
    path.write_text(WORKFLOW, encoding="utf-8")
    return load_workflow(path, overrides)


def streamed(
    tmp_path: Path, interval_ns: int, duration: float, *overrides: str
) -> tuple[Runner, Stream, Any]:
    workflow = loaded(tmp_path, *overrides)
    platform: Any = workflow.platform
    stream = Stream(platform, interval_ns)
    # The graph has bound `recv` at build: route it through the stand-in.
    block = next(block for block in blocks(workflow) if block.stage is Stage.RECV)
    block.tick = stream.recv
    runner = Runner(workflow, RunOptions(duration=duration))
    return runner, stream, runner.run()


def blocks(workflow: Program) -> Any:
    from unicon_core.flow import blocks_of

    return blocks_of(workflow.root)


def test_of_frequent_data_the_tick_takes_what_arrives_nearest_to_its_deadline(
    tmp_path: Path,
) -> None:
    seen = []
    for _ in range(5):  # a machine that is busy otherwise begins its ticks late
        runner, stream, report = streamed(tmp_path, 2_000_000, 1.2)
        assert report.ticks == 60
        starts = runner.statistics.kept()[10:, 2]
        per_tick = np.diff((starts - stream.begin) // 2_000_000)
        assert np.median(per_tick) == pytest.approx(10, abs=1)  # 50 Hz of 500 Hz
        # The tick begins with an arrival, not anywhere between two: half would be chance.
        ages = (starts - stream.begin) % 2_000_000 / 2_000_000
        seen.append(float(np.median(ages)))
        if seen[-1] < 0.35:
            return
    pytest.fail(f"ages of what ticks begin with, in intervals: {seen}")


@pytest.mark.parametrize(("spin_us", "most_ns"), [(200, 200_000), (1e9, 1_000_000)])
def test_data_are_asked_for_without_a_pause_where_the_workflow_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, spin_us: float, most_ns: int
) -> None:
    spins: list[int] = []

    def noted(wait: Any, expected_ns: int, spin_ns: int) -> bool:
        spins.append(spin_ns)
        return awaited(wait, expected_ns, spin_ns)

    monkeypatch.setattr(ticker, "awaited", noted)
    pacing = f"pacing={{trigger: state, arrival_spin_us: {spin_us}}}"
    _, stream, report = streamed(tmp_path, 2_000_000, 0.6, pacing)
    assert report.ticks == 30
    assert stream.looks > 30
    assert len(spins) == 30
    assert max(spins) == pytest.approx(most_ns, rel=0.1)  # half an interval at most


@pytest.mark.parametrize(
    ("extra", "awake"), [("pacing={trigger: state}", True), ("rate=100", False)]
)
def test_the_wait_is_awake_around_an_arrival_where_ticks_are_few(
    tmp_path: Path, extra: str, awake: bool
) -> None:
    _, stream, _ = streamed(tmp_path, 2_000_000, 0.2, extra)
    assert bool(stream.looks) == awake


def test_the_wait_is_asleep_where_the_workflow_says_so(tmp_path: Path) -> None:
    pacing = "pacing={trigger: state, arrival_spin_us: 0}"
    _, stream, _ = streamed(tmp_path, 2_000_000, 0.2, pacing)
    assert not stream.looks


@TIME_PASSES
def test_data_that_stay_away_are_waited_for_asleep_in_spite_of_a_spin(tmp_path: Path) -> None:
    pacing = "pacing={trigger: state, arrival_spin_us: 500}"
    workflow = loaded(tmp_path, pacing)
    stream = Stream(workflow.platform, 2_000_000)
    recv = next(block for block in blocks(workflow) if block.stage is Stage.RECV)
    recv.tick = stream.recv
    runner = Runner(workflow, RunOptions(duration=0.4))
    looks: list[int] = []

    def gone(timeout_s: float) -> bool:
        if workflow.states["tick"] < 10:
            return stream.wait(timeout_s)
        looks.append(not timeout_s)
        time.sleep(timeout_s)
        return False

    workflow.platform.wait = gone  # type: ignore[attr-defined]
    report = runner.run()
    assert report.ticks == 20
    assert report.overruns >= 9
    assert looks.count(False) >= 10


def test_of_rare_data_every_one_makes_a_tick(tmp_path: Path) -> None:
    runner, stream, report = streamed(tmp_path, 30_000_000, 0.4)
    assert report.ticks == 20
    starts = runner.statistics.kept()[1:, 2]
    assert np.median(np.diff((starts - stream.begin) // 30_000_000)) == 1
    assert report.overruns <= 2


@TIME_PASSES
def test_without_data_ticks_go_on_slowly_as_overruns(tmp_path: Path) -> None:
    runner, _, report = streamed(tmp_path, 1 << 60, 0.1)
    assert report.ticks == 5
    assert report.overruns >= 4  # the first finds what was there before
    apart = np.diff(runner.statistics.kept()[:, 2])
    assert apart.min() > 2.5 * runner.period_ns  # three periods of patience


def test_the_policy_warms_up_before_the_data_that_are_waited_for(tmp_path: Path) -> None:
    workflow = loaded(tmp_path)
    platform: Any = workflow.platform
    stream = Stream(platform, 2_000_000)
    order: list[str] = []
    recv = next(block for block in blocks(workflow) if block.stage is Stage.RECV)
    recv.tick = lambda: (order.append("tick"), stream.recv())[1]
    runner = Runner(workflow, RunOptions(duration=0.6))
    warm_up = runner.graph.warm_up
    runner.graph.warm_up = lambda: (order.append("warm_up"), warm_up())[1]  # type: ignore[func-returns-value]
    runner.run()
    ticks = "".join(word[0] for word in order).split("t")
    assert sum("w" in part for part in ticks[5:-1]) >= 10


HANG = "pacing={trigger: state, hang: 0.2}"


@TIME_PASSES
def test_a_tick_that_hangs_is_not_sent(tmp_path: Path) -> None:
    workflow = loaded(tmp_path, HANG)
    platform: Any = workflow.platform
    stream = Stream(platform, 20_000_000)
    recv = next(block for block in blocks(workflow) if block.stage is Stage.RECV)

    def slow() -> None:
        if workflow.states["tick"] == 4:
            time.sleep(0.6)
        stream.recv()

    recv.tick = slow
    report = Runner(workflow, RunOptions(duration=0.4)).run()
    assert "a tick hung: recv took 0.6" in report.faults[0]


@TIME_PASSES
def test_data_that_stay_away_while_the_process_is_held_up_are_a_fault(tmp_path: Path) -> None:
    workflow = loaded(tmp_path, HANG)
    platform: Any = workflow.platform
    stream = Stream(platform, 20_000_000)
    recv = next(block for block in blocks(workflow) if block.stage is Stage.RECV)
    recv.tick = stream.recv

    def wait(timeout_s: float) -> bool:
        if workflow.states["tick"] == 4:
            time.sleep(0.8)
        return stream.wait(timeout_s)

    platform.wait = wait
    report = Runner(workflow, RunOptions(duration=0.4)).run()
    assert "no tick ran for 0." in report.faults[0]
    assert report.ticks == 4


def test_each_nth_of_the_data_makes_a_tick(tmp_path: Path) -> None:
    for _ in range(5):  # a machine that is busy otherwise begins its ticks late
        pacing = "pacing={trigger: state, every: 8}"
        runner, stream, report = streamed(tmp_path, 2_400_000, 1.2, pacing)
        assert not report.faults
        per_tick = np.diff((runner.statistics.kept()[10:, 2] - stream.begin) // 2_400_000)
        # 52.1 Hz of 416.7: a deadline of 50 Hz takes the ninth in a third of the ticks.
        if np.mean(per_tick == 8) > 0.9:
            return
    pytest.fail(f"data for each tick: {per_tick}")


def test_each_nth_at_another_rate_than_the_workflows_is_a_fault(tmp_path: Path) -> None:
    _, _, report = streamed(tmp_path, 2_000_000, 1.2, "pacing={trigger: state, every: 5}")
    [fault] = report.faults
    assert re.search(
        r"pacing\.every is 5 and data come at [45]\d\d(\.\d)? Hz, so ticks at \d+(\.\d+)? Hz, not "
        r"at the workflow's 50 Hz; set pacing\.every: (9|10|11), or leave it out",
        fault,
    )
    assert report.ticks == 0


def test_each_nth_goes_on_by_deadlines_where_the_data_change_their_rate(tmp_path: Path) -> None:
    program = loaded(tmp_path, "pacing={trigger: state, every: 10}")
    stream = Stream(program.platform, 2_000_000)
    recv = next(block for block in blocks(program) if block.stage is Stage.RECV)

    def heard() -> None:
        if program.states["tick"] == 20:
            stream.interval = 5_000_000
        stream.recv()

    recv.tick = heard
    runner = Runner(program, RunOptions(duration=2.0))
    report = runner.run()
    assert not report.faults
    periods = np.diff(runner.statistics.kept()[60:, 2]) * 1e-6
    assert np.median(periods) == pytest.approx(20.0, abs=2.0)  # each tenth would be 50 ms


def test_each_nth_is_refused_where_nothing_is_counted(tmp_path: Path) -> None:
    message = (
        r"pacing\.every counts the platform's data; set pacing\.trigger: state, or leave it out"
    )
    with pytest.raises(WorkflowError, match=message):
        loaded(tmp_path, "pacing={every: 10}")
    program = loaded(tmp_path, "pacing={trigger: state, every: 10}")
    platform: Any = program.platform
    platform.wait = lambda timeout_s: True
    with pytest.raises(PlatformError, match=r"does not count its data; leave pacing\.every out"):
        Runner(program).run()


@pytest.mark.slow
def test_a_sender_that_changes_its_rate_is_followed_again(tmp_path: Path) -> None:
    seen = []
    for _ in range(5):  # a machine that is busy otherwise begins its ticks late
        workflow = loaded(tmp_path)
        stream = Stream(workflow.platform, 2_000_000)
        recv = next(block for block in blocks(workflow) if block.stage is Stage.RECV)

        def heard(stream: Stream = stream, workflow: Program = workflow) -> None:
            if workflow.states["tick"] == 20:
                stream.interval = 1_530_000
            stream.recv()

        recv.tick = heard
        runner = Runner(workflow, RunOptions(duration=3.2))
        runner.run()
        starts = runner.statistics.kept()[90:, 2]
        ages = (starts - stream.begin) % 1_530_000 / 1_530_000
        seen.append(float(np.median(ages)))
        if seen[-1] < 0.35:
            return
    pytest.fail(f"ages of what ticks begin with, in intervals: {seen}")


@pytest.mark.skipif(not hasattr(os, "sched_getaffinity"), reason="cores of Linux")
@pytest.mark.parametrize("cpu", [None, 0])
def test_the_thread_sleeps_where_it_warmed_up_and_is_free_in_its_tick(
    tmp_path: Path, cpu: int | None
) -> None:
    everywhere = os.sched_getaffinity(0)
    if len(everywhere) < 2 or 0 not in everywhere:
        pytest.skip("one core")
    workflow = loaded(tmp_path, f"pacing={{trigger: state, cpu: {'null' if cpu is None else cpu}}}")
    stream = Stream(workflow.platform, 2_000_000)
    asleep: list[set[int]] = []
    awake: list[set[int]] = []

    def wait(timeout_s: float) -> bool:
        if timeout_s:
            asleep.append(os.sched_getaffinity(0))
        return stream.wait(timeout_s)

    def recv() -> None:
        awake.append(os.sched_getaffinity(0))
        stream.recv()

    workflow.platform.wait = wait  # type: ignore[attr-defined]
    next(block for block in blocks(workflow) if block.stage is Stage.RECV).tick = recv
    Runner(workflow, RunOptions(duration=0.4)).run()
    assert all(len(cores) == 1 for cores in asleep)
    assert all(cores == ({cpu} if cpu is not None else everywhere) for cores in awake)
    assert os.sched_getaffinity(0) == everywhere


@pytest.mark.skipif(not hasattr(os, "sched_getaffinity"), reason="cores of Linux")
def test_a_wait_that_raises_leaves_the_thread_free() -> None:
    everywhere = os.sched_getaffinity(0)

    def gone(timeout_s: float) -> bool:
        raise RuntimeError("gone")

    with pytest.raises(RuntimeError, match="gone"):
        staying(gone)(0.1)
    assert os.sched_getaffinity(0) == everywhere


@pytest.mark.skipif(not hasattr(os, "sched_getaffinity"), reason="cores of Linux")
def test_somebody_who_moves_the_process_between_two_waits_is_not_undone() -> None:
    everywhere = os.sched_getaffinity(0)
    if len(everywhere) < 2:
        pytest.skip("one core")
    wait = staying(lambda timeout_s: True)
    try:
        assert wait(0.1)
        os.sched_setaffinity(0, {min(everywhere)})
        assert wait(0.1)
        assert os.sched_getaffinity(0) == {min(everywhere)}
    finally:
        os.sched_setaffinity(0, everywhere)


@pytest.mark.skipif(not hasattr(os, "sched_getaffinity"), reason="cores of Linux")
@pytest.mark.parametrize("refused", [1, 2])
def test_a_core_that_is_taken_away_does_not_end_the_wait(
    monkeypatch: pytest.MonkeyPatch, refused: int
) -> None:
    everywhere = os.sched_getaffinity(0)
    if len(everywhere) < 2:
        pytest.skip("one core")
    asked = []
    move = os.sched_setaffinity

    def put(process: int, cores: set[int]) -> None:
        asked.append(cores)
        if len(asked) == refused:
            raise OSError(22, "Invalid argument")
        move(process, cores)

    monkeypatch.setattr(os, "sched_setaffinity", put)
    try:
        assert staying(lambda timeout_s: True)(0.1)
        assert len(asked) == refused
    finally:
        move(0, everywhere)
