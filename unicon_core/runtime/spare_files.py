"""SpareFiles: descriptors that a run holds back, so that its end can still open what it needs."""

from __future__ import annotations

import errno
import os
import resource

SPARE = 16
"""Damping, the report, the fault record and lazy imports have at most a few open at once."""


class SpareFiles:
    """Holds descriptors; `release` gives them back, any number of times.

    A process that has none to spare holds as many as it gets.
    """

    def __init__(self) -> None:
        self._held: list[int] = []
        try:
            for _ in range(SPARE):
                self._held.append(os.open(os.devnull, os.O_RDONLY))
        except OSError:  # what it wants to open itself tells
            self.release()

    def release(self) -> None:
        """Close them."""
        while self._held:
            os.close(self._held.pop())


def out_of_files(error: BaseException) -> str:
    """Return the limit and the remedy where a process ran out of file descriptors, else ""."""
    if not isinstance(error, OSError) or error.errno != errno.EMFILE:
        return ""
    limit = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    return (
        f"; this process may have {limit} files open: close what is opened again and again, or "
        f"raise the limit: ulimit -n {max(4096, 4 * limit)}"
    )
