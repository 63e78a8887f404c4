"""What commands print, and the console of a run, which never holds a tick up."""

from __future__ import annotations

import argparse
import json
import os
import shutil
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from unicon_base import AnyDict
from unicon_core.non_blocking_writer import NonBlockingWriter, to_stderr
from unicon_core.text_table import Rows, aligned, display_width, fitted

CLEAR = "\r\x1b[K"


def print_table(rows: Rows, *, underlined: bool = False, **options: Any) -> None:
    """Print rows of cells; options as of `aligned`."""
    print("\n".join(aligned(rows, underlined=underlined, **options)))


def print_text(text: str) -> None:
    """Print lines that fit a terminal."""
    print(fitted(text))


def print_json(values: Any) -> None:
    """Print plain values as JSON."""
    print(json.dumps(values, indent=2, ensure_ascii=False))


def note(line: str) -> None:
    """Print a line on standard error."""
    print(line, file=sys.stderr)


def warn(message: str) -> None:
    """Print a warning on standard error, outside of ticks."""
    note(f"unicon: warning: {message}")


def is_terminal() -> bool:
    """Return whether standard error is a terminal that knows cursor codes."""
    return sys.stderr.isatty() and os.environ.get("TERM") != "dumb"


class Console:
    """Warnings and the status line of a run on standard error.

    Attributes:
        terminal: whether it is a terminal: only there is a status line.
    """

    def __init__(self) -> None:
        self.terminal = is_terminal()
        self._outlet = NonBlockingWriter(to_stderr())
        self._shown = False
        self._next = 0.0

    def due(self, interval: float) -> bool:
        """Return whether a terminal shows the status line, and it is as old as an interval, [s]."""
        now = time.monotonic()
        if not self.terminal or now < self._next:
            return False
        self._next = now + interval
        return True

    def warn(self, message: str) -> None:
        """Say a warning, one line, or what begins with `note: `; dropped where nobody reads."""
        self.say(message if message.startswith("note: ") else f"warning: {message}")

    def say(self, message: str) -> None:
        """Say something else, one line; dropped where nobody reads."""
        clear = CLEAR if self.terminal else ""
        self._outlet(f"{clear}unicon: {message}\n")

    def status(self, values: AnyDict) -> None:
        """Rewrite the status line; the last values are left out where it would scroll."""
        parts = [f"{key} {value}".strip() for key, value in values.items()]
        while len(parts) > 1 and display_width("  ".join(parts)) >= self._columns():
            parts.pop()
        self._shown = True
        self._outlet(f"{CLEAR}{'  '.join(parts)}")

    def _columns(self) -> int:
        with suppress(OSError):
            return os.get_terminal_size(2).columns or 80
        return shutil.get_terminal_size().columns

    def status_of(self, arguments: argparse.Namespace) -> Callable[[AnyDict], None] | None:
        """Return what shows the status line; None where there is none."""
        return None if arguments.quiet or not self.terminal else self.status

    def close(self) -> None:
        """End the status line and let what waits out, for a second at most; safe to call twice."""
        if self._shown:
            self._outlet("\n")
            self._shown = False
        if self._outlet.dropped:
            self._outlet(
                f"unicon: warning: {self._outlet.dropped} lines were dropped: nobody took them\n"
            )
            self._outlet.dropped = 0
        self._outlet.close()
