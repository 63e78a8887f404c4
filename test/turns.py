"""Turns of the workers of `pytest -n 2`: a test that measures time runs while no other does."""

from __future__ import annotations

import fcntl
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

__all__ = ["turn"]


@contextmanager
def turn(folder: Path, alone: bool) -> Iterator[None]:
    """Wait until a test may run, and hold off whom it may not run with.

    Args:
        folder: of the workers' locks.
        alone: it runs with no other.
    """
    with open(folder / "queue", "w") as queue, open(folder / "running", "w") as running:
        fcntl.flock(queue, fcntl.LOCK_EX)  # who waits to be alone holds up those who come later
        fcntl.flock(running, fcntl.LOCK_EX if alone else fcntl.LOCK_SH)
        fcntl.flock(queue, fcntl.LOCK_UN)
        try:
            yield
        finally:
            fcntl.flock(running, fcntl.LOCK_UN)  # a child of the test may still have the file
