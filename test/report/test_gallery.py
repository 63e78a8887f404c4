"""docs/gallery.md shows what runs of today do: its figures are compared with a new run of each."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "tools" / "lib"))

import gallery  # noqa: E402

KEPT = json.loads((gallery.FOLDER / "figures.json").read_text("utf-8"))
QUICK = ("walk",)
NEEDS = {"sweep": "pyarrow", "reach": "daqp"}
PUBLIC = ("reach", "hands", "dance", "go1")
"""They run public models and policies."""


def test_the_page_shows_every_picture_and_the_pictures_are_small() -> None:
    assert (ROOT / "docs" / "gallery.md").read_text("utf-8") == gallery.page()
    there = {path.name: path.stat().st_size for path in gallery.FOLDER.iterdir()}
    shown = {f"{name}.{'webp' if e.video else 'png'}" for name, e in gallery.ENTRIES.items()}
    assert there.keys() == {*shown, "figures.json"}
    assert len(shown) == 10
    assert sum(there.values()) <= 10_000_000
    assert list(KEPT) == list(gallery.ENTRIES)


def test_pictures_move_and_are_not_blank() -> None:
    images = pytest.importorskip("PIL.Image")
    for path in sorted(gallery.FOLDER.glob("*.webp")):
        with images.open(path) as image:
            assert image.size == (400, 320)
            assert 40 <= image.n_frames <= 90, path.name
            first = image.convert("L").tobytes()
            image.seek(image.n_frames // 2)
            half = image.convert("L").tobytes()
        moved = sum(abs(a - b) > 16 for a, b in zip(first, half)) / len(first)
        assert moved > 0.005, path.name
        assert len(set(first)) > 60, path.name


@pytest.mark.timeout(900)
@pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=() if n in QUICK else pytest.mark.slow) for n in gallery.ENTRIES],
)
def test_the_figures_are_those_of_a_run_of_today(
    name: str, tmp_path: Path, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("mujoco")
    if name in NEEDS:
        pytest.importorskip(NEEDS[name])
    if name in PUBLIC:
        request.getfixturevalue("assets")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]))
    found: dict[str, Any] = gallery.made(name, tmp_path)
    assert found == pytest.approx(KEPT[name], abs=0.05)  # processors and versions round


def test_a_run_that_goes_elsewhere_has_other_figures(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    walk = gallery.ENTRIES["walk"]
    other = (
        "run",
        "go2_walk",
        "--set",
        "commands.0.velocity_command.schedule.1=[4.0, 0.7, 0.0, 0.0]",
    )
    gallery.ENTRIES["walk"] = type(walk)(walk.text, other, walk.video, walk.seconds)
    try:
        found = gallery.made("walk", tmp_path)
    finally:
        gallery.ENTRIES["walk"] = walk
    assert found != pytest.approx(KEPT["walk"], abs=0.05)
