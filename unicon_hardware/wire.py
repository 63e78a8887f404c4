"""Wire: the one thing in which robots differ, for drivers: how frames come in and go out.

class MyWire:
    counts, where = Counts(), "192.168.123.10"

    def take(self): ...             # newest good frame into the states; how many came
    def put(self): ...              # command states to the motors
    def wait(self, timeout): ...    # until a frame is there
    def close(self): ...            # let go of sockets
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any, Protocol, runtime_checkable

import numpy as np

from unicon_core.states import States
from unicon_hardware.modes import ModeGuard

_HALF = 1 << 31


def ahead(number: int, last: int) -> int:
    """Return by how much a number of 32 bits, which may wrap, is ahead of the last one."""
    return (number - last + _HALF) % (2 * _HALF) - _HALF


def newer(number: int, last: int) -> bool:
    """Tell whether a frame number of 32 bits, which may wrap, is behind the last one."""
    return ahead(number, last) > 0


class Counts:
    """What came in and what was clamped, for reports and error messages.

    Attributes:
        good: frames that were taken.
        refused: reason to number of frames that were not.
        last: the newest of these reasons with its figures, "" for none.
        clamped: commands of ours in which a figure was beyond what the robot or the format takes.
    """

    def __init__(self) -> None:
        self.good = 0
        self.refused: Counter[str] = Counter()
        self.last = ""
        self.clamped = 0

    def refuse(self, reason: str, detail: str = "") -> None:
        """Count a frame that is not taken.

        Args:
            reason: a few words, the same for all alike: `wrong CRC`.
            detail: figures of this one.
        """
        self.refused[reason] += 1
        self.last = f"{reason} ({detail})" if detail else reason

    def __str__(self) -> str:
        """Return what was refused: `3 wrong CRC, 1 short`; "" for nothing."""
        return ", ".join(f"{number} {reason}" for reason, number in self.refused.items())


def known(states: States, name: str, unless: Any = None) -> Any:
    """Return a state, or something else where there is none of that name."""
    if name in states:
        return states[name]
    return unless


class Wire(Protocol):
    """The connection to a robot; it is called in the tick and never waits.

    Whatever arrives, `take` raises nothing but `Fault`: a frame of another length, checksum or
    origin is counted and left. An old one is not new: a robot that repeats itself is silent.

    Attributes:
        counts: of what came in.
    """

    counts: Counts

    @property
    def where(self) -> str:
        """Address or topic, for messages; a plain attribute will do."""
        ...

    def take(self) -> int:
        """Bring the newest good frame into the states; return how many good ones have come.

        Raises:
            Fault: the robot says that it will not go on.
        """
        ...

    def put(self) -> None:
        """Send the command states, which are finite; what the format cannot hold is clamped.

        Raises:
            Fault: it cannot be sent.
        """
        ...

    def wait(self, timeout: float) -> bool:
        """Return True once a frame is there, False after `timeout` in [s]."""
        ...

    def close(self) -> None:
        """Let go; the damping command has been sent."""
        ...


@runtime_checkable
class Prepared(Protocol):
    """A wire to a robot that does not take commands at once; see `Prepares` of the platform."""

    def prepare(self) -> str:
        """Do the next step, without waiting; return "" at its end, else what is waited for."""
        ...


@runtime_checkable
class Guarded(Protocol):
    """A wire whose motors report their mode.

    Attributes:
        modes: what they report; None where it is not to be looked at.
    """

    modes: ModeGuard | None


@runtime_checkable
class Clocked(Protocol):
    """A wire to a robot whose frames tell its own time.

    Attributes:
        clock_ms: of the frame that was taken last, 32 bits in [ms]; None where it tells none.
    """

    @property
    def clock_ms(self) -> int | None: ...


@runtime_checkable
class ReportsCommanders(Protocol):
    """A wire that sees who else commands the robot."""

    def commanders(self) -> dict[str, int]:
        """Return where it takes commands, with the number of others that send there."""
        ...


NAMED = 3
"""How many motors that miss `Answers` names."""


class Answers:
    """Which of several motors have answered since all did last, for wires that ask each.

    As text it is those that have not, for `Wire.where`.

    Args:
        labels: of the motors, each with its address.

    Attributes:
        heard: who has, shape (n,).
    """

    def __init__(self, labels: Sequence[str]) -> None:
        self._labels = labels
        self.heard = np.zeros(len(labels), bool)

    def complete(self) -> bool:
        """Return whether all have, and begin anew if so."""
        if not self.heard.all():
            return False
        self.heard[...] = False
        return True

    def __str__(self) -> str:
        missing = [self._labels[i] for i in np.flatnonzero(~self.heard).tolist()]
        if len(missing) in (0, len(self._labels)):
            return f"all {len(self._labels)} motors ({self._labels[0]}, …)"
        more = f" and {len(missing) - NAMED} more" if len(missing) > NAMED else ""
        return f"{', '.join(missing[:NAMED])}{more}"
