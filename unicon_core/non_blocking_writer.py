"""NonBlockingWriter: hands lines to a terminal, pipe or log without waiting; for ticking threads.

A terminal that Ctrl-S has stopped, a pipe that nobody reads and a log on a slow disk all block who
writes. Here the writing is a thread's, and what does not fit in its queue is dropped and counted.
"""

from __future__ import annotations

import os
import sys
import threading
import weakref
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from io import TextIOWrapper
from queue import SimpleQueue
from select import select
from typing import Generic, TypeVar

from unicon_base import TextSink

CAPACITY = 256
"""Lines that may wait."""

STDERR = 2

LAST = b"\0"
"""What is written to standard error behind all else; no text has it."""


Line = TypeVar("Line")


class NonBlockingWriter(Generic[Line]):
    """A function that takes lines and returns at once.

    Args:
        sink: takes one line, and may block.
        capacity: lines that may wait for it.

    Attributes:
        dropped: lines that were lost, since the sink blocked or failed.
    """

    def __init__(self, sink: Callable[[Line], object], capacity: int = CAPACITY) -> None:
        self._sink, self._capacity = sink, capacity
        # `put` of a SimpleQueue never blocks and may be called by signal handlers.
        self._lines: SimpleQueue[Line | threading.Event | None] = SimpleQueue()
        self._thread: threading.Thread | None = None
        self.dropped = 0

    def __call__(self, line: Line) -> None:
        """Hand a line over; never blocks, never raises."""
        if self._lines.qsize() >= self._capacity:
            self.dropped += 1
            return
        if self._thread is None:
            self._thread = threading.Thread(target=self._drain, name="outlet", daemon=True)
            self._thread.start()
        self._lines.put(line)

    def flush(self, timeout: float = 1.0) -> bool:
        """Wait until all lines are out, at most `timeout` in [s]; return whether they are."""
        if self._thread is None:
            return True
        reached = threading.Event()
        self._lines.put(reached)
        return reached.wait(timeout)

    def close(self, timeout: float = 1.0) -> None:
        """Let the thread end once all lines are out; wait for that at most `timeout` in [s]."""
        thread, self._thread = self._thread, None
        if thread is not None:
            self._lines.put(None)
            thread.join(timeout)

    def _drain(self) -> None:
        while (line := self._lines.get()) is not None:
            if isinstance(line, threading.Event):
                line.set()
                continue
            try:
                self._sink(line)
            except Exception:  # a sink that fails must not end the thread
                self.dropped += 1


def to_stderr() -> TextSink:
    """Return a sink that writes to standard error, past the lock of Python's own stream.

    Python's stream holds its lock while a write blocks, and the end of the process waits for it.
    """
    try:
        sys.stderr.flush()
        handle = os.dup(sys.stderr.fileno())
    except (OSError, ValueError, AttributeError):  # a stream without a file, as in a notebook
        return lambda text: print(text, end="", file=sys.stderr)

    def write(text: str) -> None:
        rest = text.encode("utf-8", "replace")
        while rest:
            rest = rest[os.write(handle, rest) :]

    weakref.finalize(write, os.close, handle).atexit = False
    return write


def open_standard_files() -> None:
    """Open the null device where standard input, output or error is closed (`unicon … >&- 2>&-`).

    Else the next file that is opened, such as a recording, would get its number, and with it what
    libraries write to standard error. What a terminal cannot show (`LC_ALL=C`) is replaced.
    """
    while (handle := os.open(os.devnull, os.O_RDWR)) <= STDERR:
        os.set_inheritable(handle, True)
    os.close(handle)
    if sys.stdout is None:
        sys.stdout = open(os.devnull, "w")  # noqa: SIM115 - until the process ends
    if sys.stderr is None:
        sys.stderr = open(os.devnull, "w")  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="replace")


@contextmanager
def relayed_stderr() -> Iterator[None]:
    """Let nothing wait for standard error: neither Python nor a library written in C.

    Python's warnings and the logs of ROS go straight to the file, the latter with Python's lock
    held, so that all threads stand still with them and no signal is heard. Meanwhile the file is
    a pipe that never blocks: a thread hands on what comes, and what it cannot hold is lost. A
    message with which a library aborts the process may be lost too. Where nobody has read for
    1 s at the end, it stays so.
    """
    try:
        sys.stderr.flush()
        kept = os.dup(STDERR)
    except (OSError, ValueError, AttributeError):  # there is none
        yield
        return
    if os.isatty(STDERR):  # rcutils looks at the file, which is a pipe from now on
        os.environ.setdefault("RCUTILS_COLORIZED_OUTPUT", "1")
    out, into = os.pipe()
    os.set_blocking(into, False)
    os.dup2(into, STDERR)
    os.close(into)

    drained = threading.Event()

    def relay() -> None:
        with suppress(OSError):
            while some := os.read(out, 4096):
                last = LAST in some
                with suppress(OSError):  # the reader has gone
                    rest = some.replace(LAST, b"")
                    while rest:
                        rest = rest[os.write(kept, rest) :]
                if last:
                    drained.set()

    thread = threading.Thread(target=relay, name="stderr", daemon=True)
    thread.start()
    try:
        yield
    finally:
        with suppress(OSError, ValueError):
            sys.stderr.flush()
            os.write(STDERR, LAST)
        # Where nobody reads, the pipe stays for good: a library that logs while the process ends,
        # with Python's lock held, would else stop all of it.
        if drained.wait(1.0) and select([], [kept], [], 0.0)[1]:
            os.dup2(kept, STDERR)  # which closes the pipe, so that the thread ends
            thread.join(1.0)
            if not thread.is_alive():  # a child may still hold the pipe
                os.close(out)
                os.close(kept)
