"""Gate: the last look before `send`; a closed workflow and a tick that hung send nothing."""

from __future__ import annotations

import time
from collections.abc import Callable

from unicon_core.errors import Fault, Hung
from unicon_core.platforms.kit.damping import LastSent

NEVER_NS = 1 << 62
CLOSED = "the workflow is closed and sends nothing any more; build it anew"


class Gate:
    """Lets commands pass until a time, and remembers the last.

    Args:
        sent: takes what has passed.

    Attributes:
        until_ns: on the clock of `time.perf_counter_ns`; what comes to `send` later is refused.
            The runner moves it on with every tick.
        hung: tells what is said of a tick that comes later than that.
        closed: nothing passes any more.
        sent: what has passed last.
    """

    def __init__(self, sent: LastSent) -> None:
        self.sent = sent
        self.until_ns = NEVER_NS
        self.hung: Callable[[], str] = lambda: "a command came too late and was not sent"
        self.closed = False

    def before(self, send: Callable[[], bool | None]) -> Callable[[], bool | None]:
        """Return `send` behind the gate, which costs a tick 0.3 µs.

        Args:
            send: the platform's; of a silent run what stands in its place.

        What is returned raises:
            Fault: the workflow is closed, or the tick took longer than the runner allows.
        """
        now, note = time.perf_counter_ns, self.sent.note

        def guarded() -> bool | None:
            if self.closed or now() > self.until_ns:
                raise Fault(CLOSED) if self.closed else Hung(self.hung())
            done = send()
            note()
            return done

        return guarded

    def close(self) -> None:
        """Let nothing pass any more."""
        self.closed = True
