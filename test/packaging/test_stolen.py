"""What repeats a test: time of the machine that the host took away while it ran."""

from __future__ import annotations

from pathlib import Path

import pytest
import stolen


def test_time_that_the_host_took_away_is_told(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    stat = tmp_path / "stat"
    monkeypatch.setattr(stolen, "STAT", stat)

    def says(idle: int, steal: int) -> None:
        stat.write_text(f"cpu  100 0 50 {idle} 5 0 1 {steal} 0 0\ncpu0 1 2 3\n")

    says(1000, 70)
    told = stolen.Stolen(0.02)
    told.begin()
    assert not told()
    says(1098, 72)
    assert not told()
    says(1097, 73)
    assert told()
    told.begin()
    assert not told()


@pytest.mark.parametrize("text", [None, "", "cpu", "cpu a b c d e f g h"])
def test_where_nobody_tells_nothing_was_taken(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, text: str | None
) -> None:
    stat = tmp_path / "stat"
    if text is not None:
        stat.write_text(text)
    monkeypatch.setattr(stolen, "STAT", stat)
    told = stolen.Stolen()
    told.begin()
    assert not told()
