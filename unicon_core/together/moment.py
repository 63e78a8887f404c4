"""Moment: a time of the wall clock at which a flow begins, for whoever reads `start: {at: …}`.

    start: {at: "2026-11-22T21:00:00"}     # of this machine; with Z or +01:00 behind, of that zone
    start: {at: {every: 10}}               # the next whole 10 s of the clock

The clocks of the machines have to agree, by NTP (a millisecond or so on one network) or PTP.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from unicon_core.bounds import within
from unicon_core.errors import Fault, UniconError, WorkflowError

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
    """Asked in each tick: the moment once this robot is ready; see `rendezvous.Source`.

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

    def facts(self) -> dict[str, Any]:
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
