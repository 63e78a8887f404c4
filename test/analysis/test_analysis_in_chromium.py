"""The report in a real browser: every picture is there, and the console stays silent."""

from __future__ import annotations

from pathlib import Path

import pytest
from made_runs import save, walk
from pages import looked_at

from unicon_lab.analysis.pictures import PICTURES
from unicon_ros.cli.main import main

pytestmark = pytest.mark.slow


def test_every_picture_is_there_and_the_console_is_silent(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("matplotlib")
    monkeypatch.setattr("unicon_core.drawing.interactive", lambda: None)
    files = [str(save(tmp_path / f"{n}.npz", walk(seed=n))) for n in range(2)]
    assert main(["analyze", *files, "--out", str(tmp_path / "out")]) == 0
    page = (tmp_path / "out" / "report.html").read_text("utf-8")
    told, console = looked_at(page, tmp_path)
    assert console == []
    headings = [heading for name, (_, heading, _) in PICTURES.items() if name != "temperature"]
    assert [label for label, *_ in told["pictures"]] == headings
    for label, shown, strokes in told["pictures"]:
        assert 300 < shown < 1200, label
        assert strokes > 20, label
    assert told["rows"] > 12
    assert told["wide"] <= 1200  # nothing hangs out of the window
    assert told["height"] > 2000


def test_an_empty_picture_an_error_and_a_request_would_be_seen(tmp_path: Path) -> None:
    page = (
        '<!DOCTYPE html><html><head></head><body><figure><div aria-label="x">'
        '<svg width="20"></svg></div></figure><img src="none.png">'
        '<script>console.error("told"); nothing.at.all</script>'
        "</body></html>"
    )
    told, console = looked_at(page, tmp_path)
    assert told["pictures"] == [["x", 20, 0]]
    assert len(console) == 3, console
    assert sum("none.png" in line for line in console) == 1
