"""Parent: a process of ours as its child sees it; for processes that `Pipe` starts."""

from __future__ import annotations

import json
import os
import pickle
import select
import signal
import threading
from contextlib import suppress
from typing import Any

from unicon_base.errors import Fault

ALARM = 10
"""In [s]: the kernel ends a process that hangs so long, as its parent would if it still lived."""

LONGEST = 1000
"""Characters of an error that are told."""


class Parent:
    """What it gave first, what it wishes, and what it is told.

    Ctrl-C and Ctrl-Z are the parent's, and what libraries print goes to stderr.

    Args:
        patience: how long the start may take in [s]; the kernel ends what hangs longer.

    Attributes:
        given: what it gave.
    """

    def __init__(self, patience: float) -> None:
        for number in (signal.SIGINT, signal.SIGHUP, signal.SIGTSTP):
            signal.signal(number, signal.SIG_IGN)
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.alarm(round(patience) + ALARM)
        self._told, self._telling = os.dup(1), threading.Lock()
        os.dup2(2, 1)  # what libraries print is not for the parent
        size = int.from_bytes(_exactly(8), "little")
        self.given: dict[str, Any] = pickle.loads(_exactly(size))  # through our own pipe
        self._rest = b""

    def tell(self, **words: Any) -> None:
        """Tell it something; nothing where nobody is there to be told. From any thread."""
        packed = pickle.dumps(words)
        with self._telling, suppress(OSError):
            os.write(self._told, len(packed).to_bytes(8, "little") + packed)

    def wishes(self) -> list[list[Any]] | None:
        """Return what it wishes since the last look, each `[what, *given]`; None: it has closed."""
        found: list[list[Any]] = []
        while select.select([0], [], [], 0.0)[0]:
            read = os.read(0, 1 << 16)
            if not read:
                return None
            *lines, self._rest = (self._rest + read).split(b"\n")
            found += map(json.loads, lines)
        return found


def text_of(error: BaseException) -> str:
    """Return an exception in one short line: a pipe that nobody reads holds no long one."""
    kind = "" if isinstance(error, Fault) else type(error).__name__
    try:
        text = " ".join(str(error).split())
    except Exception:  # its text cannot be had
        text = ""
    whole = ": ".join(filter(None, (kind, text)))
    return whole if len(whole) <= LONGEST else f"{whole[:LONGEST]}…"


def _exactly(count: int) -> bytes:
    data = b""
    while len(data) < count:
        read = os.read(0, count - len(data))
        if not read:
            raise SystemExit(1)  # the parent died
        data += read
    return data
