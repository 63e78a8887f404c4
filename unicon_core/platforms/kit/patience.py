"""A line for people who wait: engines compile for seconds to minutes before their first step."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Timer

AFTER = 2.0
"""Seconds for which nobody asks."""


@contextmanager
def patience(what: str) -> Iterator[None]:
    """Say on standard error what takes long, once it does, and how long it took.

    Args:
        what: such as "mjx: compiling the physics of 64 robots, some 10 s the first time".
    """
    begin = time.monotonic()
    said = []

    def say() -> None:
        said.append(True)
        print(f"{what} …", file=sys.stderr, flush=True)

    timer = Timer(AFTER, say)
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
        if said:
            took = time.monotonic() - begin
            print(f"{what.partition(':')[0]}: ready after {took:.0f} s", file=sys.stderr)
