"""`unicon bench reach` measures both sides, or ours alone, and tells what the arms kept."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks import reach

pytest.importorskip("daqp", reason="daqp is not installed: pip install 'unicon_ros[ik]'")


@pytest.mark.parametrize("there", [False, True])
def test_cases_ratios_and_facts(assets: Path, monkeypatch: pytest.MonkeyPatch, there: bool) -> None:
    if there:
        pytest.importorskip("mink", reason="mink is not installed: pip install mink")
    monkeypatch.setattr(reach, "TICKS", 60)
    monkeypatch.setattr(reach, "find_spec", lambda _: there or None)
    bench = reach.run(rounds=1)
    ways = ["ours", "ours, apart", *(["mink", "mink, apart"] if there else [])]
    motions = ["crossing, 2 rad/s", "circles", "crossing, 6 rad/s"]
    assert list(bench.cases) == [f"{motion}: {way}" for motion in motions for way in ways]
    assert set(bench.ratios) == {"crossing_mm", *(("ik", "ik_apart") if there else ())}
    assert bench.ratios["crossing_mm"]["holds"]
    assert bench.facts["solver failures"] == 0
    assert ("mink" in bench.facts) is not there
