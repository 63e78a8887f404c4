"""A robot that is stepped in a thread, beside the test that talks to it."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

__all__ = ["stepping"]


@contextmanager
def stepping(step: Callable[[], object], close: Callable[[], object]) -> Iterator[None]:
    """Call `step`, which takes its time, again and again; at the end `close`, once it has ended."""
    ended = threading.Event()

    def steps() -> None:
        while not ended.is_set():
            step()

    thread = threading.Thread(target=steps)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()
        close()
