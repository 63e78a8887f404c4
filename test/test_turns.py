"""The turns of workers: who measures time runs alone, and does not wait for ever."""

from __future__ import annotations

import threading
from pathlib import Path

import pytest
from turns import turn

PATIENCE = 20.0
A_WHILE = 0.1


class Worker(threading.Thread):
    """Takes a turn and keeps it until it is told to end."""

    def __init__(self, folder: Path, alone: bool) -> None:
        super().__init__(daemon=True)
        self.folder, self.alone = folder, alone
        self.runs, self.may_end = threading.Event(), threading.Event()
        self.start()

    def run(self) -> None:
        with turn(self.folder, self.alone):
            self.runs.set()
            self.may_end.wait(PATIENCE)

    def end(self) -> None:
        self.may_end.set()
        self.join(PATIENCE)


def test_others_run_at_once(tmp_path: Path) -> None:
    first, second = Worker(tmp_path, False), Worker(tmp_path, False)
    assert first.runs.wait(PATIENCE)
    assert second.runs.wait(PATIENCE)
    first.end()
    second.end()


@pytest.mark.parametrize("alone", [(True, False), (False, True), (True, True)])
def test_who_is_alone_runs_before_or_after(tmp_path: Path, alone: tuple[bool, bool]) -> None:
    first = Worker(tmp_path, alone[0])
    assert first.runs.wait(PATIENCE)
    second = Worker(tmp_path, alone[1])
    assert not second.runs.wait(A_WHILE)
    first.end()
    assert second.runs.wait(PATIENCE)
    second.end()


def test_who_comes_later_waits_for_who_waits_to_be_alone(tmp_path: Path) -> None:
    first = Worker(tmp_path, False)
    assert first.runs.wait(PATIENCE)
    waiting = Worker(tmp_path, True)
    assert not waiting.runs.wait(A_WHILE)
    later = Worker(tmp_path, False)
    assert not later.runs.wait(A_WHILE)
    first.end()
    assert waiting.runs.wait(PATIENCE)
    assert not later.runs.is_set()
    waiting.end()
    assert later.runs.wait(PATIENCE)
    later.end()


def test_a_test_that_fails_ends_its_turn(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="failed"), turn(tmp_path, True):
        raise ValueError("failed")
    with turn(tmp_path, True):
        pass
