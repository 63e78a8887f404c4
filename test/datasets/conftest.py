"""What the tests of data sets share: runs of records' and headsets' tests, three recordings."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path += [str(Path(__file__).resolve().parents[1] / each) for each in ("record", "teleop")]


@pytest.fixture(scope="session")
def bags(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Three recordings of 50 ticks at 100 Hz with two cameras; one of them gives JPEG."""
    pytest.importorskip("rosbags")
    pytest.importorskip("PIL")
    from picturing import run

    folder = tmp_path_factory.mktemp("bags")
    cameras = {"every": 4, "height": 96, "width": 128}, {"prefix": "rear", "every": 3, "first": 5}
    for number in range(3):
        place = folder / f"episode {number}"
        place.mkdir()
        run(place, *cameras, frames=["all"], jpeg=0 if number else 90, name="run.mcap")
    return [folder / f"episode {number}" / "run.mcap" for number in range(3)]
