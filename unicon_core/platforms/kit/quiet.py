"""Silence of libraries that print to the process's own output, past Python."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager


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
