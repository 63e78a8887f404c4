"""Engines at their start: silence where they print past Python, a line where they take long."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Timer


@contextmanager
def quiet(handle: int = 1) -> Iterator[None]:
    """Let nothing reach standard output, of Python or of C, as long as it lasts.

    Short, and while no other thread prints: what goes there is lost. Errors have an output of
    their own, which stays.

    Args:
        handle: 2 for that of errors, where a library complains of what is not an error.
    """
    stream = sys.stdout if handle == 1 else sys.stderr
    stream.flush()
    try:
        kept = os.dup(handle)
    except OSError:  # there is none
        yield
        return
    try:
        with open(os.devnull, "wb") as nowhere:
            os.dup2(nowhere.fileno(), handle)
        try:
            yield
        finally:
            stream.flush()
            os.dup2(kept, handle)
    finally:
        os.close(kept)


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
