"""Rendezvous: what a run asks in each tick until the moment comes; for the runner.

A moment is agreed on (`meeting`), or one of the wall clock:

    start: {at: "2026-11-22T21:00:00"}     # of this machine; with Z or +01:00 behind, of that zone
    start: {at: {every: 10}}               # the next whole 10 s of the clock

The clocks of the machines have to agree, by NTP (a millisecond or so on one network) or PTP.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from unicon_base import AnyDict, Fault, TextSink, UniconError, WorkflowError
from unicon_core.bounds import within
from unicon_core.synchronised_start.meeting import Meeting

REPEAT = 5.0
"""How often what is waited for is told again, [s]."""

GRACE = 1.0
"""What is waited for that long is told, [s]; the last second before a moment is not."""


class Rendezvous:
    """Asks the source, tells what is waited for, and says when the flow's first tick is due.

    Args:
        source: which says when, by its clock; 0 as long as it does not know. It tells what is
            waited for, and why this robot does not begin with all others.
        period: of a tick in [s].
        warn: takes what is waited for, one line each.

    Attributes:
        reason: what is waited for, "" where nothing is.
        first_ns: when the flow's first tick is due, on the clock of `time.perf_counter_ns`; 0
            before that is known.
    """

    def __init__(self, source: WallClock | Meeting, period: float, warn: TextSink) -> None:
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

    def facts(self, first_ns: int) -> AnyDict:
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


FARTHEST = 3600.0
"""How far ahead a moment may be in [s]: a robot stands there until then, under torque."""

SHORTEST = 1.0
"""Of `every` in [s]: two robots that are ready a little apart must mean the same moment."""

LEAST = 0.2
"""How far ahead the next whole `every` has to be in [s]; the one behind it is taken else."""

MISSED_NS = 200_000_000
"""Who has waited and looks so long behind the moment has missed it, [ns]: ticks look before it."""


@dataclass(frozen=True)
class Moment:
    """What `at:` says.

    Attributes:
        at_ns: in [ns] since 1970, of `time.time_ns`; 0 where `every` says it.
        every: period of the moments in [s]; 0 where there is one moment.
        words: as it is written.
    """

    at_ns: int = 0
    every: float = 0.0
    words: str = ""

    def refuse(self, now_ns: int) -> None:
        """Refuse a moment that has passed, or is too far ahead; before anything is sent.

        Raises:
            UniconError: it is.
        """
        if self.every:
            return
        ahead = (self.at_ns - now_ns) * 1e-9
        if ahead <= 0.0:
            raise UniconError(
                f"start: at {self.words} has passed {-ahead:.1f} s ago, by the clock of this "
                f"machine ({_told(now_ns)}); give a time to come, or at: {{every: 10}}"
            )
        if ahead > FARTHEST:
            raise UniconError(
                f"start: at {self.words} is {ahead / 3600:.1f} h ahead, by the clock of this "
                f"machine ({_told(now_ns)}); give a time within {FARTHEST / 3600:g} h"
            )

    def next_ns(self, now_ns: int) -> int:
        """Return the moment that is meant by who is ready now, in [ns] since 1970."""
        if not self.every:
            return self.at_ns
        every = round(self.every * 1e9)
        return -(-(now_ns + round(LEAST * 1e9)) // every) * every


class WallClock:
    """Asked in each tick: the moment once this robot is ready; see `Rendezvous`.

    Args:
        moment: what is waited for.
        alone: who is late begins at once, else it is a fault.
    """

    clock = staticmethod(time.time_ns)

    def __init__(self, moment: Moment, alone: bool) -> None:
        self._moment, self._alone = moment, alone
        self._next = 0
        self.reason = self.late = ""

    def ask(self, ready: bool) -> int:
        """Return the moment in [ns], 0 where this robot is not ready.

        Raises:
            Fault: it has passed, or the clock was set to long before it. One that is set while it
                is waited for counts from then on.
        """
        if not ready:
            return 0
        now = self.clock()
        if not self._next:
            self._next = self._moment.next_ns(now)
            if self._next < now:
                self._missed(now, "before gates, go and approach were over")
        elif now - self._next > MISSED_NS:
            self._missed(now, "ago: the clock was set, or this process stood still")
        if self._next - now > FARTHEST * 1e9:
            raise Fault(f"not started: the clock of this machine was set to {_told(now)}")
        self.reason = f"the moment {_told(self._next)}"
        return self._next

    def _missed(self, now: int, why: str) -> None:
        """Begin now, if that is wanted of who is late.

        Raises:
            Fault: it is not.
        """
        passed = (now - self._next) * 1e-9
        self.late = f"it is late: {self._moment.words} passed {passed:.2f} s {why}"
        if not self._alone:
            raise Fault(f"not started, {self.late}")
        self._next = now

    def begun(self) -> None:
        """Nobody has to be told."""

    def close(self) -> None:
        """Nothing is open."""

    def facts(self) -> AnyDict:
        """Return what the report tells."""
        return {"at": _told(self._next)} if self._next else {}


def moment_of(value: Any) -> Moment:
    """Return what `at:` says.

    Raises:
        WorkflowError: it is not a moment.
    """
    if isinstance(value, dict) and list(value) == ["every"]:
        every = within(value["every"], "every", "s", FARTHEST, SHORTEST, above=False)
        return Moment(every=every, words=f"every {every:g} s")
    try:
        if not isinstance(value, str) or ":" not in value:  # a date alone is a midnight
            raise ValueError
        when = datetime.fromisoformat(value.strip().replace("Z", "+00:00")).timestamp()
    except (ValueError, OverflowError, OSError):
        raise WorkflowError(
            f"is {value!r:.60}; give a date with a time, as 2026-11-22T21:00:00 (Z "
            "behind it for UTC), or {every: SECONDS}"
        ) from None
    return Moment(at_ns=round(when * 1e9), words=value)


def _told(ns: int) -> str:
    """Return a time in this machine's zone, to the millisecond."""
    return datetime.fromtimestamp(ns * 1e-9).astimezone().isoformat(timespec="milliseconds")
