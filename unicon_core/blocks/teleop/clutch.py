"""Clutch: whether the operator's hand has hold of the robot's.

It must be seen open before it closes: whoever comes back with a closed hand moves nothing.
"""

from __future__ import annotations

from typing import Literal, TypeAlias

Mode: TypeAlias = Literal["hold", "toggle", "always"]


class Clutch:
    """The clutch of one hand.

    Args:
        mode: `hold`, engaged while it is closed; `toggle`, each closing turns it over; `always`,
            engaged while the hand is tracked.
        sure: ticks for which it has to be closed; for `always`, ticks for which the hand has to be
            tracked.

    Attributes:
        engaged: it is, just now.
    """

    memory = ("engaged", "_open", "_ticks")

    def __init__(self, mode: Mode, sure: int) -> None:
        self._mode, self._sure = mode, max(1, sure)
        self.engaged = False
        self._open = mode == "always"
        self._ticks = 0

    def __call__(self, closed: bool) -> bool:
        """Take what the operator does in this tick; return whether it is engaged.

        Args:
            closed: button or fingers are; of no matter for `always`.
        """
        if self._mode == "always":
            closed = True
        if not closed:
            self._ticks, self._open = 0, True
            if self._mode == "hold":
                self.engaged = False
            return self.engaged
        self._ticks += 1
        if self._open and self._ticks >= self._sure:
            self._open = False
            self.engaged = not self.engaged if self._mode == "toggle" else True
        return self.engaged

    def drop(self) -> None:
        """Let go, until it is closed anew: the hand is not tracked, or another thing is."""
        self.engaged, self._ticks, self._open = False, 0, self._mode == "always"
