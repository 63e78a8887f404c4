"""The benchmarks' report: JSON as the command line promises it, and a table."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks import tick
from unicon_core.flow import Block, Zip, compile_graph
from unicon_core.flow.fuse import fuse
from unicon_ros.bench.report import Bench


def example() -> Bench:
    bench = Bench("tick", seed=7, rounds=3)
    bench.case("ours", np.array([1.0, 2.0, 3.0]))
    bench.case("theirs", [[10.0, 20.0], [30.0, 40.0]])
    bench.ratio("speed", 0.1, 0.5)
    return bench


def test_json_has_the_promised_keys() -> None:
    value = json.loads(example().to_json())
    assert {"bench", "machine", "versions", "seed", "rounds", "cases", "ratios"} <= set(value)
    assert (value["bench"], value["seed"], value["rounds"]) == ("tick", 7, 3)
    assert value["cases"]["ours"]["p50"] == 2.0
    assert value["cases"]["ours"]["p99"] == pytest.approx(2.98)
    assert value["cases"]["theirs"]["samples"] == 4
    assert value["cases"]["ours"]["std"] == pytest.approx(np.sqrt(2.0 / 3.0))
    assert value["ratios"]["speed"] == {
        "value": 0.1,
        "bar": 0.5,
        "holds": True,
        "claim": "at most",
    }
    assert value["versions"]["numpy"] == np.__version__
    assert value["machine"]["cores"] >= 1


def test_a_missed_ratio_is_told() -> None:
    bench = example()
    assert bench.holds
    assert not bench.ratio("late", 0.51, 0.5)
    assert not bench.holds
    assert bench.table().splitlines()[-1].split() == ["late", "0.51", "≤", "0.5", "MISSED"]


def test_a_ratio_may_ask_for_at_least() -> None:
    bench = example()
    assert bench.ratio("gain", 4.0, 3.0, at_least=True)
    assert not bench.ratio("small gain", 2.0, 3.0, at_least=True)


def test_what_is_not_finite_never_holds_and_stays_valid_json() -> None:
    bench = example()
    assert not bench.ratio("broken", float("nan"), 1.0)
    assert not bench.ratio("endless", float("inf"), 1.0, at_least=True)
    assert json.loads(bench.to_json())["ratios"]["broken"]["value"] is None


def test_a_case_needs_samples_and_a_name_of_its_own() -> None:
    bench = example()
    with pytest.raises(ValueError, match=r"^case 'none' has no samples$"):
        bench.case("none", [])
    with pytest.raises(ValueError, match=r"^case 'ours' was added before$"):
        bench.case("ours", [1.0])


def test_tick_measures_its_ratios(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tick, "REPEATS", 5)
    monkeypatch.setattr(tick, "SAMPLES", 3)
    bench = tick.run(rounds=2)
    assert {name: ratio["bar"] for name, ratio in bench.ratios.items()} == {
        "dispatch": 0.7,
        "native_dispatch": 0.1,
        "native_half": 1.0,
        "fused_copy": 0.15,
    }
    assert all(case["samples"] == 6 and case["min"] > 0 for case in bench.cases.values())


def test_tick_compares_things_that_do_the_same() -> None:
    states, maps = tick._copies(tick.COPIES)
    blocks = [tick._copy(each) for each in maps]
    for step in (
        tick.closure_zip(*[block.tick for block in blocks]),
        compile_graph(Zip(*blocks)).step,
        compile_graph(fuse(Zip(*blocks), states)).step,
    ):
        states.reset()
        states.buffer_of("float32")[: 16 * 20] = np.arange(320)
        step()
        assert states.buffer_of("float32")[320:].tolist() == list(range(320))
    called: list[int] = []
    empty = [Block(f"b{i}", lambda i=i: called.append(i), endless=True) for i in range(3)]
    for run in (
        tick.loop(tick.closure_zip(*[block.tick for block in empty])),
        tick.as_run(Zip(*empty)),
    ):
        called.clear()
        run()
        assert called == [0, 1, 2] * tick.EVERY
    assert tick.closure_zip(lambda: False, lambda: True)()
    assert not tick.closure_zip(lambda: False, lambda: None)()


def test_a_picture_shows_dots_and_ranges_as_a_logarithmic_axis_has_no_zero(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("matplotlib")
    from matplotlib.figure import Figure
    from matplotlib.patches import Rectangle

    from unicon_ros.bench.report import plot

    bench = Bench("loops", 20)
    bench.case("plain", np.linspace(1000.0, 2000.0, 101))
    bench.case("unicon", np.linspace(100.0, 300.0, 101))
    drawn: list[Figure] = []
    save = Figure.savefig
    monkeypatch.setattr(Figure, "savefig", lambda f, *a, **k: (drawn.append(f), save(f, *a, **k)))
    plot(bench, tmp_path / "bench.png")
    (axes,) = drawn[0].axes
    assert axes.get_xscale() == "log"
    assert not [patch for patch in axes.patches if isinstance(patch, Rectangle)]
    lines, p50, p99 = axes.collections
    assert p50.get_offsets()[:, 0].tolist() == [200.0, 1500.0]
    assert p99.get_offsets()[:, 0].tolist() == pytest.approx([298.0, 1990.0])
    assert [path[:, 0].tolist() for path in lines.get_segments()] == [
        [200.0, pytest.approx(298.0)],
        [1500.0, pytest.approx(1990.0)],
    ]
    assert [text.get_text() for text in axes.texts] == ["200", "1500"]
    assert (tmp_path / "bench.png").read_bytes().startswith(b"\x89PNG")
