"""Overruns: who made a tick late is named, from the time stamps and in a real run."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from unicon_core.flow import Block, Stage, Zip
from unicon_core.runtime import Report, Runner, RunOptions, TickStatistics, percentiles
from unicon_core.runtime.statistics import EVERY, LEARN
from unicon_core.workflow import HookBlocks, Program, load_workflow

pytestmark = pytest.mark.usefixtures("time_passes")

US = 1000  # ns
NAMES = ("recv", "policy", "send", "bridge", "recorder")


def statistics(*ticks: tuple[int, ...]) -> TickStatistics:
    """Each tick: how long each block took in [µs], 0 where it did not run; period 100 µs."""
    kept = TickStatistics(NAMES, frozenset({3, 4}), capacity=16)
    for i, tick in enumerate(ticks):
        begin = i * 1000 * US
        stamps = np.zeros(2 + len(NAMES), np.int64)
        at = stamps[0] = begin
        for block, took in enumerate(tick):
            if block == 3:
                stamps[1] = at
            if took:
                at += took * US
                stamps[2 + block] = at
        kept.add(begin, int(at), stamps)
    return kept


@pytest.mark.parametrize(
    ("ticks", "named"),
    [
        ([(10, 20, 10, 20, 20)], {}),  # in time
        ([(10, 20, 10, 90, 20)], {"bridge": 1}),  # the slack was 60 µs
        ([(10, 20, 10, 20, 50), (10, 20, 10, 45, 30)], {"recorder": 1, "bridge": 1}),
        ([(10, 130, 10, 150, 0)], {"policy": 1}),  # late before the deferred ones began
        ([(40, 30, 20, 0, 15)], {"recorder": 1}),  # all in time before it
        ([(60, 0, 0, 0, 50)] * 3 + [(101, 0, 0, 0, 0)], {"recorder": 3, "recv": 1}),
    ],
)
def test_the_block_that_took_longest_where_time_ran_out_is_named(
    ticks: list[tuple[int, ...]], named: dict[str, int]
) -> None:
    found = statistics(*ticks).overrun_blocks(100.0)
    assert found == named
    assert list(found) == list(named)


def test_the_table_tells_them_only_where_ticks_were_late() -> None:
    kept = statistics((10, 20, 10, 90, 20), (10, 130, 10, 0, 0))
    assert "overran" not in kept.table(100.0)  # `--speed max` has no deadlines
    kept.overruns = 2
    assert kept.table(100.0).splitlines()[-2:] == [
        "bridge overran its slack in 1 of 2 ticks",
        "policy overran the period in 1 of 2 ticks",
    ]


def test_where_blocks_share_a_stamp_their_group_is_named() -> None:
    kept = TickStatistics(NAMES, frozenset({3, 4}), 16, groups=[(0, 1), (2,), (3, 4)])

    def add(begin: int, *ends: int) -> None:
        stamps = np.array([begin, 0, *(end and begin + end for end in ends)]) * US
        kept.add(begin * US, int(stamps.max()), stamps, detailed=False)

    add(1000, 0, 120, 130, 0, 0)
    add(2000, 0, 20, 30, 0, 150)
    add(3000, 0, -950, 130, 0, 140)  # as it stood after the tick before: nobody ran
    assert kept.overrun_blocks(100.0) == {
        "recv … policy, 2 blocks": 1,
        "bridge … recorder, 2 blocks": 1,
        "send": 1,
    }
    kept.overruns = 3
    assert kept.table(100.0).splitlines()[-3:] == [
        "recv … policy, 2 blocks overran the period in 1 of 3 ticks",
        "bridge … recorder, 2 blocks overran its slack in 1 of 3 ticks",
        "send overran the period in 1 of 3 ticks",
    ]
    assert kept.durations_us().tolist() == [130.0, 30.0, 130.0]
    assert {row["calls"] for row in kept.block_us().values()} == {0}
    stamps = np.array([4000, 4040, 4010, 4020, 4040, 4050, 4060]) * US
    kept.add(4000 * US, 4060 * US, stamps)
    assert kept.block_us()["policy"] == {"p50": 10.0, "p99": 10.0, "max": 10.0, "calls": 1}
    spans = [e["name"] for e in json.loads(kept.trace("it", 2))["traceEvents"] if "ts" in e]
    assert spans == ["tick", "send", "bridge … recorder, 2 blocks", "tick", *NAMES]


@pytest.mark.alone
@pytest.mark.parametrize(("blocks", "detail"), [(100, False), (4, True)])
def test_stamps_that_take_longer_than_a_tenth_of_a_tick_are_written_now_and_then(
    blocks: int, detail: bool
) -> None:
    """Four blocks of 0.2 ms bear them in each tick; a hundred of nothing in one of 64."""

    def work() -> None:
        if detail:
            time.sleep(0.0002)

    program = Program(
        robot="go2",
        platform="fake",
        flow={"zip": ["hold", *(work for _ in range(blocks))]},
        rate=50,
    )
    program.root = Zip(*(Block(f"b{i}", work) for i in range(blocks)))
    runner = Runner(program, RunOptions(speed="max", duration=20.0))
    runner.run()
    ticks = runner.statistics
    assert ticks.count == 1000
    calls = {row["calls"] for row in ticks.block_us().values()}
    assert calls == {1000 if detail else LEARN + (1000 - LEARN) // EVERY}


def test_blocks_of_one_name_are_told_apart() -> None:
    kept = TickStatistics(("hold", "send", "hold"), frozenset(), 4)
    assert kept.labels == ("hold", "send", "hold#2")


def test_without_blocks_or_ticks_nobody_is_named() -> None:
    assert TickStatistics((), frozenset(), 4).overrun_blocks(1.0) == {}
    assert TickStatistics(NAMES, frozenset({3}), 4).overrun_blocks(1.0) == {}


WORKFLOW = """\
robot: go2
platform: fake
rate: 100
flow: {hold: {duration: 0.6}}
"""


@pytest.mark.alone
def test_a_slow_observer_of_a_run_is_in_the_report(tmp_path: Path) -> None:
    path = tmp_path / "slow.yaml"
    path.write_text(WORKFLOW, encoding="utf-8")
    calls: list[int] = []

    def sleepy() -> None:
        calls.append(1)
        if len(calls) % 3 == 0:
            time.sleep(0.03)

    def hook(workflow: Any) -> HookBlocks:
        return {Stage.OBSERVE: [Block("sleepy", sleepy, reads=("joint_pos",))]}

    runner = Runner(load_workflow(path, hooks=[hook]), RunOptions())
    report = runner.run()
    assert report.overrun_blocks["sleepy"] >= 3
    assert next(iter(report.overrun_blocks)) == "sleepy"
    assert ", most by sleepy" in report.summary()
    assert report.to_dict()["overrun_blocks"] == report.overrun_blocks
    assert "sleepy overran its slack in " in runner.statistics.table(1e4)


def test_the_start_up_is_told_where_it_is_known(tmp_path: Path) -> None:
    path = tmp_path / "short.yaml"
    path.write_text(WORKFLOW, encoding="utf-8")
    runner = Runner(load_workflow(path), RunOptions(speed="max"))
    report = runner.run()
    if Path("/proc/self/stat").exists():
        assert report.startup_s is not None
        assert report.startup_s > 0.0
        assert f"start-up      {report.startup_s:.2f} s to the first tick" in report.summary()
    assert "start-up" not in Report("w", "r", "p").summary()


def test_times_are_told_to_the_clocks_nanoseconds() -> None:
    found = percentiles(np.array([1.001, 2.003, 46015.1856004]))
    assert found == {"p50": 2.003, "p99": 45094.922, "max": 46015.186}


def test_the_table_has_no_digits_that_mean_nothing() -> None:
    lines = statistics((10, 20, 70, 0, 0), (20, 30, 90, 0, 0)).table(1000.0).splitlines()
    assert lines[1].split() == ["recv", "15.0", "19.9", "20.0", "1.5%"]
    assert lines[-1].split() == ["tick", "120", "140", "140", "12.0%"]
