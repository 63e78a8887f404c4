"""What benches claim of medians stands in one table, whose cases are those that they measure."""

from __future__ import annotations

import pytest

from benchmarks import loops, programs, retarget, runs, stores
from benchmarks.samples import BARS, TICK, Samples
from unicon_ros.bench.report import Bench
from unicon_ros.cli.bench import BENCHES


def test_a_ratio_comes_from_the_table_where_both_cases_were_measured() -> None:
    bench, times = Bench("reach", 1), Samples()
    for case, value in (("circles: ours", 3.0), ("circles: mink", 2.0), ("circles: other", 1.0)):
        times.add(case, value)
    times.add_to(bench)
    assert {name: (each["value"], each["bar"]) for name, each in bench.ratios.items()} == {
        "ik": (1.5, 0.5)
    }
    assert not bench.holds


@pytest.mark.parametrize("name", BARS)
def test_rows_are_of_a_bench_and_each_ratio_has_one(name: str) -> None:
    assert name in BENCHES
    assert len({ratio for ratio, *_ in BARS[name]}) == len(BARS[name])
    for ratio, case, base, bar, *percent in BARS[name]:
        assert percent == ([99] if "p99" in ratio else [])
        assert case != base
        assert bar > 0.0


def test_cases_of_the_table_are_called_as_benches_call_them() -> None:
    named = {name: {case for row in rows for case in row[1:3]} for name, rows in BARS.items()}
    assert named["safety"] == {runs.WITH, runs.WITHOUT}
    assert named["start"] == {
        f"{case} [ms]" for case in (programs.BASE, programs.RUN, programs.ROS)
    }
    assert named["retarget"] == {"unicon", retarget.OTHER}
    assert {loops.OURS, loops.USUAL, loops.NATIVE, loops.ALONE} <= named["policy"]
    assert {loops.BESIDE, loops.BESIDE_NONE} <= named["policy"]
    assert named["view"] == {f"{TICK}, {name}" for name in (runs.LOOKED_AT, runs.NONE)}
    sides = runs.RECORD_WITH, runs.RECORD_WITHOUT
    assert named["record"] == {f"{TICK}, {name}" for name in sides}
    ways = {f"{way}: one way" for way in stores.WAYS}
    assert named["stores"] == ways | {stores.PUBLISH, stores.COPY}
    assert {f"receive JointState: {name}" for name in ("ours", "typed")} <= named["bridge"]
    assert all(f"N = {size}" in str(named["batch"]) for size in (1, programs.MANY))
