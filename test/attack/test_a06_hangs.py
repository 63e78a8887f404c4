"""A hang is a fault when it ends, missed ticks are counted, and nothing is caught up on a robot."""

from __future__ import annotations

import signal
import time
from itertools import pairwise
from pathlib import Path

import pytest
from runs import Run

from unicon_base.errors import PlatformError
from unicon_core.flow import Block, Stage
from unicon_core.pacing import CATCH_UP
from unicon_core.runtime import Runner
from unicon_core.workflow import load_workflow


def test_a_process_that_was_stopped_sends_nothing_more(tmp_path: Path) -> None:
    run = Run(tmp_path, hang=None).start()
    run.until_sent()
    run.process.send_signal(signal.SIGSTOP)
    time.sleep(1.2)
    woken = time.monotonic_ns()
    run.process.send_signal(signal.SIGCONT)
    status, _, _ = run.wait()
    assert status == 3
    assert run.closed
    # One command at most: where the tick was stopped between the gate and the motors.
    assert sum(at > woken for at in run.times("send")) <= 1
    assert run.report["overruns"] >= 50
    assert "pacing.hang" in run.report["faults"][0]


@pytest.mark.parametrize("where", ["recv", "send"])
def test_a_hang_in_a_block_is_a_fault_when_it_ends(tmp_path: Path, where: str) -> None:
    run = Run(tmp_path, f"fault: sleep, where: {where}", hang=0.7).start()
    status, _, _ = run.wait()
    assert status == 3
    # Before `send` its command does not leave; in `send` nobody can take it back.
    assert run.sent() == (5 if where == "recv" else 6)
    assert run.report["overruns"] >= 45
    assert f"a tick hung: {where} took 1.0" in run.report["faults"][0]


def test_a_workflow_may_allow_longer_ticks_and_they_count_one_by_one(tmp_path: Path) -> None:
    more = "pacing: {hang: 5.0}\nduration: 0.4"
    run = Run(tmp_path, "fault: sleep, at: 10", more=more).start()
    status, _, _ = run.wait()
    assert status == 0
    assert run.report["overruns"] >= 49
    assert run.report["ticks"] == 20


def test_catch_up_is_refused_on_a_robot(tmp_path: Path) -> None:
    run = Run(tmp_path, more="pacing: {overrun: catch_up}").start()
    status, _, err = run.wait()
    assert status == 1
    assert "set pacing.overrun: skip" in err
    assert run.sent() == 0


WORKFLOW = """\
robot: go2
platform: fake
rate: 100
pacing: {overrun: catch_up}
flow: {hold: {duration: 0.6}}
"""


def test_catch_up_is_bounded_in_a_simulator(tmp_path: Path) -> None:
    path = tmp_path / "late.yaml"
    path.write_text(WORKFLOW)
    starts: list[int] = []

    def sleepy() -> None:
        starts.append(time.perf_counter_ns())
        if len(starts) == 10:
            time.sleep(0.5)

    workflow = load_workflow(path, hooks=[lambda _: {Stage.OBSERVE: [Block("sleepy", sleepy)]}])
    report = Runner(workflow).run()
    assert report.faults == []
    longest = in_a_row = 0  # a busy machine makes further ones, each bounded as this is
    for a, b in pairwise(starts[10:]):
        in_a_row = in_a_row + 1 if b - a < 5_000_000 else 0
        longest = max(longest, in_a_row)
    assert 1 < longest <= CATCH_UP + 1
    assert report.overruns >= 40


def test_a_robot_of_ones_own_is_refused_catch_up_too(tmp_path: Path) -> None:
    path = tmp_path / "late.yaml"
    path.write_text(WORKFLOW)
    workflow = load_workflow(path, ["platform=fake_robot"])
    with pytest.raises(PlatformError, match=r"pacing\.overrun: skip"):
        Runner(workflow)
    workflow.close()
