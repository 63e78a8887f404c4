"""Memory: ticks of a whole workflow with its policy leave nothing behind."""

from __future__ import annotations

import os
import sys
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from policy_workflows import write_workflow

from unicon_core import Program, block
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


@pytest.mark.skipif(sys.platform != "linux", reason="pagemap is Linux's")
def test_the_rows_of_ticks_are_in_memory_before_a_run_in_real_time_begins() -> None:
    """They would grow by 350 B a tick else, in steps of 2 MB where the kernel has large pages."""

    def resident(values: np.ndarray) -> np.ndarray:
        page = os.sysconf("SC_PAGE_SIZE")
        first = -(-values.ctypes.data // page)
        last = (values.ctypes.data + values.nbytes) // page
        with open("/proc/self/pagemap", "rb", buffering=0) as pages:
            pages.seek(8 * first)
            entries = np.frombuffer(pages.read(8 * (last - first)), np.uint64)
        return entries >> np.uint64(63) == 1  # Documentation/admin-guide/mm/pagemap.rst

    program = Program(robot="go2", platform="fake", rate=200, flow=block("hold"))
    # So many are seldom given what was freed before: mmap from 32 MB on, see mallopt(3).
    runner = Runner(program, RunOptions(duration=0.02, capacity=500_000))
    assert runner.statistics.rows.nbytes > 1 << 25
    assert runner.run().ticks == 4
    assert resident(runner.statistics.rows).all()
