"""tools/lib/pictures_of_reports.py makes the pictures of docs/howto/reports.md."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest
from pages import browser

ROOT = Path(__file__).resolve().parents[2]
TOOL = ROOT / "tools" / "lib" / "pictures_of_reports.py"


def test_it_makes_what_the_document_shows() -> None:
    document = (ROOT / "docs" / "howto" / "reports.md").read_text("utf-8")
    shown = re.findall(r"!\[[^]]+\]\(\.\./pictures/(\w+)\.png\)", document)
    assert shown == re.findall(r'^    "(\w+)": Shot\(', TOOL.read_text("utf-8"), re.MULTILINE)
    for name in shown:
        assert (ROOT / "docs" / "pictures" / f"{name}.png").stat().st_size < 150_000


@pytest.mark.slow
def test_a_picture_is_taken_and_is_not_blank(tmp_path: Path) -> None:
    browser()
    images = pytest.importorskip("PIL.Image")
    command = [sys.executable, str(TOOL), "--out", str(tmp_path), "show"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=100, check=False)
    assert done.returncode == 0, done.stderr
    with images.open(tmp_path / "show.png") as image:
        assert image.size == (1500, 1300)
        colours = image.convert("L").histogram()
    assert sum(count > 100 for count in colours) > 10
    assert max(colours) < 0.95 * 1500 * 1300
