"""Memory: ticks of a whole workflow with its policy leave nothing behind."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import pytest
from policy_workflows import write_workflow

from unicon_core.runtime import Runner, RunOptions
from unicon_core.workflow import load_workflow


def growth(runner: Runner, ticks: int) -> int:
    """Bytes that are allocated after some ticks, warm-ups included, and were not before."""
    now = 0
    for _ in range(1500):  # once through the flow: what is made on first use is there
        runner.graph.warm_up()
        runner.tick(now)
    tracemalloc.start()
    before = tracemalloc.get_traced_memory()[0]
    for _ in range(ticks):
        runner.graph.warm_up()
        runner.tick(now)
    after = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    runner.close()
    return after - before


@pytest.mark.parametrize("kind", ["history", "recurrent"])
def test_2000_ticks_of_a_policy_leave_nothing(tmp_path: Path, kind: str) -> None:
    runner = Runner(load_workflow(write_workflow(tmp_path, kind)), RunOptions(speed="max"))
    assert growth(runner, 2000) < 16_384


def test_2000_ticks_of_go2_walk_leave_nothing() -> None:
    runner = Runner(load_workflow("go2_walk"), RunOptions(speed="max"))
    assert growth(runner, 2000) < 16_384


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_100000_ticks_of_go2_walk_leave_nothing() -> None:
    runner = Runner(load_workflow("go2_walk"), RunOptions(speed="max"))
    assert growth(runner, 100_000) < 65_536
