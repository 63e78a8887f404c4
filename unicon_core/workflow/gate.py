"""Gate: the last look before `send`; a closed workflow and a tick that hung send nothing.

A silent run, for `unicon run --dry` and preflight, computes all and sends nothing.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from unicon_base.errors import Fault, Hung
from unicon_core.platforms.kit.damping import LastSent
from unicon_core.platforms.platform import Platform
from unicon_core.states import States
from unicon_core.states.standard import COMMAND_STATES

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


def withheld(platform: Platform, states: States) -> Callable[[], bool | None]:
    """Return what a silent run does in place of `send`.

    A robot gets nothing. A simulator gets limp joints, since its time goes on with `send` alone;
    the command states hold again afterwards what would have been sent.

    Args:
        platform: of the program.
        states: of the program.
    """
    if not platform.facts.simulated:
        return _nothing
    views = [(states[name], np.zeros_like(states[name])) for name in COMMAND_STATES]
    target, measured = states["joint_pos_target"], states["joint_pos"]

    def limp() -> bool | None:
        for view, kept in views:
            kept[...] = view
            view[...] = 0.0
        target[...] = measured
        try:
            return platform.send()
        finally:
            for view, kept in views:
                view[...] = kept

    return limp


def _nothing() -> None:
    """Send nothing."""
