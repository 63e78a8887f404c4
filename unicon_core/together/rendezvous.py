"""Rendezvous: what a run asks in each tick until the moment comes; for the runner."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Protocol

from unicon_core.together.meeting import Meeting
from unicon_core.together.moment import WallClock

if TYPE_CHECKING:
    from unicon_core.workflow import Program

REPEAT = 5.0
"""How often what is waited for is told again, [s]."""

GRACE = 1.0
"""What is waited for that long is told, [s]; the last second before a moment is not."""


class Source(Protocol):
    """Says when: the wall clock, or the others.

    Attributes:
        reason: what is waited for.
        late: why this one does not begin with all others, "" where it does.
    """

    reason: str
    late: str

    def clock(self) -> int:
        """Return the time in [ns] by the clock of its moments."""
        ...

    def ask(self, ready: bool) -> int:
        """Return the moment in [ns], 0 as long as it is not known; called once a tick."""
        ...

    def begun(self) -> None:
        """Take note that the next tick is the flow's."""
        ...

    def close(self) -> None:
        """Let go."""
        ...

    def facts(self) -> dict[str, Any]:
        """Return what the report tells."""
        ...


class Rendezvous:
    """Asks the source, tells what is waited for, and says when the flow's first tick is due.

    Args:
        source: which says when.
        period: of a tick in [s].
        warn: takes what is waited for, one line each.

    Attributes:
        reason: what is waited for, "" where nothing is.
        first_ns: when the flow's first tick is due, on the clock of `time.perf_counter_ns`; 0
            before that is known.
    """

    def __init__(self, source: Source, period: float, warn: Callable[[str], None]) -> None:
        self._source, self._warn = source, warn
        # Left for the change to the flow, between one period and two: on a busy machine it was seen
        # to take 9 ms. Nothing is sent meanwhile, and a child's watchdog is three periods at least.
        self._near_ns = round(2e9 * period)
        self._what, self._since, self._told_at = "", 0.0, 0.0
        self._told_late = False
        self.reason, self.first_ns = "", 0

    def __call__(self, ready: bool) -> bool:
        """Return whether the next tick is the flow's first.

        Args:
            ready: this robot stands where its flow begins; before that the others learn that it is
                there.

        Raises:
            Fault: somebody is late or lacks.
        """
        source = self._source
        moment = source.ask(ready)
        if not ready:
            return False
        if source.late and not self._told_late:
            self._told_late = True
            self._warn(f"start: {source.late}")
        if moment:
            left = moment - source.clock()
            if left <= self._near_ns:
                source.begun()
                self.first_ns = moment + _between(source.clock)
                self.reason = ""
                return True
        self.reason, now = source.reason, time.monotonic()
        if self.reason != self._what:
            self._what, self._since, self._told_at = self.reason, now, 0.0
        elif now - self._since >= GRACE and now - self._told_at > REPEAT:
            self._told_at = now
            self._warn(f"waiting for {self.reason}")
        return False

    def here(self) -> None:
        """Let the others learn that this one is there, and is not ready."""
        self(False)

    def met(self) -> bool:
        """Return the same where there is no way to go first."""
        return self(True)

    def facts(self, first_ns: int) -> dict[str, Any]:
        """Return what the report tells.

        Args:
            first_ns: when the flow's first tick began, on the clock of `time.perf_counter_ns`.
        """
        late = round((first_ns - self.first_ns) * 1e-3, 1) if self.first_ns else None
        return {**self._source.facts(), "first_tick_ns": first_ns, "late_us": late}

    def close(self) -> None:
        """Let go."""
        self._source.close()


def _between(clock: Callable[[], int]) -> int:
    """Return `time.perf_counter_ns` minus another clock in [ns]; of three looks the shortest, since
    a process may be put to sleep between the two."""
    looks = []
    for _ in range(3):
        before, there, after = time.perf_counter_ns(), clock(), time.perf_counter_ns()
        looks.append((after - before, (before + after) // 2 - there))
    return min(looks)[1]


def rendezvous_of(program: Program, speed: str, warn: Callable[[str], None]) -> Rendezvous | None:
    """Return what a run asks before its flow, None where its workflow names no moment.

    Args:
        program: that is to run.
        speed: of the run: at full speed nobody is waited for, which is told.
        warn: takes one line each.

    Raises:
        UniconError: the moment has passed or is too far ahead, or nobody can be met.
    """
    start = program.start
    key = "at" if start.at is not None else "together"
    if (start.at is None and start.together is None) or not program.has_platform:
        return None
    if speed == "max":
        warn(f"start: {key} is not waited for with --speed max")
        return None
    if start.at is not None:
        start.at.refuse(time.time_ns())
        return Rendezvous(WallClock(start.at, start.alone), program.period, warn)
    assert start.together is not None
    if program.silent:  # others would begin because of it
        warn("start: together is not waited for by a run that sends nothing")
        return None
    return Rendezvous(Meeting(start.together, start.alone, program.period), program.period, warn)
