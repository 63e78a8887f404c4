"""Console: warnings and the status line of a run on standard error, which never hold a tick up."""

from __future__ import annotations

import os
import sys
from typing import Any

from unicon_core.outlet import Outlet, to_stderr

CLEAR = "\r\x1b[K"


def is_terminal() -> bool:
    """Return whether standard error is a terminal that knows cursor codes."""
    return sys.stderr.isatty() and os.environ.get("TERM") != "dumb"


class Console:
    """What a run says while it ticks.

    Attributes:
        terminal: whether it is a terminal: only there is a status line.
    """

    def __init__(self) -> None:
        self.terminal = is_terminal()
        self._outlet = Outlet(to_stderr())
        self._shown = False

    def warn(self, message: str) -> None:
        """Say a warning, one line; dropped where nobody reads."""
        self.say(f"warning: {message}")

    def say(self, message: str) -> None:
        """Say something else, one line; dropped where nobody reads."""
        clear = CLEAR if self.terminal else ""
        self._outlet(f"{clear}unicon: {message}\n")

    def status(self, values: dict[str, Any]) -> None:
        """Rewrite the status line."""
        line = "  ".join(f"{key} {value}" for key, value in values.items())
        self._shown = True
        self._outlet(f"{CLEAR}{line}")

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
