"""NodeLog: a node's log, which never holds a tick up, for the lifecycle node.

rclpy keeps Python's interpreter lock while it writes to standard error: on a terminal that Ctrl-S
has stopped, all threads would stand still with it. So a line is handed over only where standard
error takes it at once.
"""

from __future__ import annotations

import select
from typing import Any

from unicon_core.non_blocking_writer import NonBlockingWriter

STDERR = 2


class NodeLog:
    """Says lines through a logger, in a thread of its own.

    Args:
        logger: of an rclpy node.
    """

    def __init__(self, logger: Any) -> None:
        self._logger = logger
        self._poll = select.poll()
        self._poll.register(STDERR, select.POLLOUT)
        self._outlet: NonBlockingWriter[tuple[str, str]] = NonBlockingWriter(self._say)

    @property
    def dropped(self) -> int:
        """Lines that nobody took."""
        return self._outlet.dropped

    def info(self, text: str) -> None:
        """Say what happens."""
        self._outlet(("info", text))

    def warning(self, text: str) -> None:
        """Say what is not as it should be."""
        self._outlet(("warning", text))

    def error(self, text: str) -> None:
        """Say what went wrong."""
        self._outlet(("error", text))

    def close(self) -> None:
        """Let what waits out, for a second at most."""
        self._outlet.close()

    def _say(self, line: tuple[str, str]) -> None:
        if not self._poll.poll(500):
            raise BlockingIOError("standard error takes nothing")  # counted as dropped
        level, text = line
        # Each level from a line of its own: rcutils refuses a place that changes its level.
        if level == "info":
            self._logger.info(text)
        elif level == "warning":
            self._logger.warning(text)
        else:
            self._logger.error(text)
