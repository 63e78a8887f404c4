"""Rows of the official SDK in `unicon bench latency`: how figures are made, and what lacks."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from unicon_core.signals import SIGNALS
from unicon_ros.bench import latency
from unicon_ros.bench.loops import Slice, _bridged
from unicon_ros.bench.report import Bench
from unicon_ros.bench.rounds import Rows, add_pooled_ratios

pytest.importorskip("cyclonedds", reason="needs cyclonedds: pip install 'unicon_ros[hw-unitree]'")

from unicon_ros.bench.pipelines.fast_robot import WINDOW, Made

SYNC, ASYNC, UNITREE = "SDK (sync)", "SDK (async)", "unicon, unitree, on state"
SYNC_500, OURS_500 = "SDK (sync), G1 at 500 Hz", "unicon, unitree, G1 at 500 Hz"


def test_identity_control_hands_on_which_state_it_answers() -> None:
    made = Made()
    told = [np.float32(made.add(stamp)) for stamp in range(1, WINDOW + 3)]
    assert made.when(float(told[-1])) == WINDOW + 2
    assert made.when(float(told[2])) == 3
    assert made.when(float(told[0])) == WINDOW + 1  # its number is another state's by now


@pytest.mark.parametrize("position", [0.5 / WINDOW, -1.0, 1.0, float("nan"), float("inf"), 1e30])
def test_a_position_that_no_state_told_is_of_none(position: float) -> None:
    made = Made()
    made.add(7)
    assert made.when(position) == 0


def controlled(**columns: list[int]) -> dict[str, np.ndarray]:
    rows = {"stamp": [10, 20, 20], "seen": [11, 21, 22], "begin": [12, 22, 23], "end": [13, 23, 24]}
    return {name: 1000 * np.array(row) for name, row in (rows | columns).items()}


def test_a_state_that_was_received_before_tells_nothing_of_what_receiving_costs() -> None:
    measured = {"stamp": np.array([10_000]), "received": np.array([15_000])}
    everything = Slice(0, 10**9, 0.1, 0.1)
    rows = _bridged(everything, measured, controlled(cost=[3, 4, -1]))
    assert rows["recv_and_send"].tolist() == [3.0, 4.0]
    assert "recv_and_send" not in _bridged(everything, measured, controlled())
    assert "recv_and_send" not in _bridged(everything, measured, controlled(cost=[-1, -1, -1]))


def test_a_state_from_before_the_pause_does_not_count_the_pause() -> None:
    second = 10**9
    stamps = np.array([5 * second, 10 * second])
    measured = {"stamp": stamps, "received": stamps + np.array([5_001_000_000, 1_000_000])}
    given = {name: np.full(2, 10 * second + 1) for name in ("seen", "begin", "end")}
    rows = _bridged(Slice(10 * second, 11 * second, 0.1, 0.1), measured, given | {"stamp": stamps})
    assert rows["end_to_end"].tolist() == [1000.0]
    assert len(rows["recv"]) == 1


def test_rows_and_ratios_are_those_of_the_rounds_that_have_both() -> None:
    def rows(cost: float, end: float) -> Rows:
        times = {"recv_and_send": np.full(3, cost), "end_to_end": np.full(3, end)}
        return times | {"cpu": np.full(3, 1.0)}

    both = {
        SYNC: rows(100, 1000),
        UNITREE: rows(10, 250),
        ASYNC: rows(1, 500),
    }
    both |= {SYNC_500: rows(200, 1), OURS_500: rows(20, 1)}
    bench = Bench("made", seed=0, rounds=2)
    latency.add(
        bench, latency.SDK_VARIANTS, latency.TABLES["sdk_ratios"], [both, {SYNC_500: rows(1, 1)}]
    )
    assert bench.ratios["unitree_recv_and_send"]["value"] == pytest.approx(0.1)
    assert bench.ratios["unitree_recv_and_send"]["holds"]
    assert bench.facts["unitree, end to end, of SDK (sync)"].startswith("0.25 (")
    assert bench.facts["unitree, end to end, of SDK (async)"].startswith("0.5 (")
    assert f"{SYNC}: cpu [% of a core]" in bench.cases
    assert [name for name in bench.cases if "500" in name] == [
        f"{SYNC_500}: recv_and_send",
        f"{OURS_500}: recv_and_send",
    ]


def test_a_ratio_of_tails_is_of_all_rounds_and_has_an_interval() -> None:
    bench, rng = Bench("made", seed=0, rounds=40), np.random.default_rng(1)
    results: list[dict[str, Rows]] = []
    for _ in range(40):
        slow = rng.choice([1.0, 3.0])  # a round in which the machine is slow is so for both
        base = slow * rng.uniform(90.0, 110.0, 50)
        results.append({"ours": {"end_to_end": 0.5 * base}, "theirs": {"end_to_end": base}})
    results.append({"ours": {}, "theirs": {"end_to_end": np.full(50, 1e9)}})
    claim = ("tail", "end_to_end", "ours", "theirs", 99.0, 0.6)
    add_pooled_ratios(bench, results, [claim, ("none", "cpu", "ours", "theirs", None, 1.0)])
    assert set(bench.ratios) == {"tail"}
    assert bench.ratios["tail"]["value"] == pytest.approx(0.5)
    assert bench.facts["tail, 95 % interval"] == "0.5 to 0.5"
    mixed = [
        {"ours": each["ours"], "theirs": other["theirs"]}
        for each, other in zip(results[:40], results[1:40] + results[:1])
    ]
    add_pooled_ratios(bench, mixed, [("mixed", *claim[1:])])
    low, high = map(float, bench.facts["mixed, 95 % interval"].split(" to "))
    assert low <= bench.ratios["mixed"]["value"] <= high
    assert high - low < 0.1


def added(bench: Bench, results: list[dict[str, Rows]]) -> None:
    latency.add(bench, latency.SDK_VARIANTS, latency.TABLES["sdk_ratios"], results)


def test_without_results_nothing_is_told() -> None:
    bench = Bench("made", seed=0, rounds=0)
    added(bench, [])
    assert not bench.cases
    assert not bench.ratios
    assert not bench.facts


def test_what_lacks_is_said_in_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("UNICON_UNITREE_SDK", raising=False)
    assert "UNICON_UNITREE_SDK is ''; name a checkout of unitree_sdk2_python" in latency.sdk_lacks()
    monkeypatch.setenv("UNICON_UNITREE_SDK", str(tmp_path))
    assert "name a checkout" in latency.sdk_lacks()
    (tmp_path / "unitree_sdk2py").mkdir()
    monkeypatch.setenv("UNICON_UNITREE_PYTHON", "")
    assert "UNICON_UNITREE_PYTHON is ''" in latency.sdk_lacks()
    monkeypatch.setenv("UNICON_UNITREE_PYTHON", str(tmp_path / "none"))
    assert "which does not run" in latency.sdk_lacks()
    monkeypatch.setenv("UNICON_UNITREE_PYTHON", sys.executable)
    said = latency.sdk_lacks()
    assert "where the SDK fails (ModuleNotFoundError: No module named" in said
    assert "cyclonedds 0.10.2" in said
    assert "\n" not in said


def test_without_cyclonedds_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(latency, "find_spec", lambda name: None)
    assert "pip install 'unicon_ros[hw-unitree]'" in latency.sdk_lacks()


@pytest.mark.slow
@pytest.mark.alone
@pytest.mark.timeout(200)
def test_the_sdk_and_ours_close_the_loop_with_one_robot(tmp_path: Path) -> None:
    if lacking := latency.sdk_lacks():
        pytest.skip(lacking)
    with SIGNALS.guard():
        results = latency.measure(
            latency.SDK_VARIANTS, 2, 0.6, 49.6, ["--state-rate", "500"], tmp_path
        )
    bench = Bench("made", seed=0, rounds=2)
    added(bench, results)
    for variant in latency.SDK_VARIANTS[:4]:
        cases = {row: bench.cases[f"{variant.name}: {row}"] for row in ("recv", "end_to_end")}
        assert all(case["samples"] >= 20 for case in cases.values())
        assert 0.0 < cases["recv"]["p50"] < cases["end_to_end"]["p50"]
    assert bench.ratios["unitree_recv_and_send"]["value"] > 0.0
    assert bench.cases[f"{OURS_500}: recv_and_send"]["samples"] >= 100
