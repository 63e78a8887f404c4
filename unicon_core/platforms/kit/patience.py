"""A line for who waits: engines that compile take a minute the first time, and say nothing."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from unicon_core.outlet import to_stderr

__all__ = ["told_if_long"]

_LONG = 5.0  # [s]


@contextmanager
def told_if_long(line: str, after: float = _LONG) -> Iterator[None]:
    """Tell in a line on standard error why it takes long, once, where it does.

    Args:
        line: what is told.
        after: in [s].
    """
    timer = threading.Timer(after, to_stderr(), (f"{line}\n",))
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
