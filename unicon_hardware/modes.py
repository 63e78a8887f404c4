"""Modes of motors: what they report is held against what is commanded; for wires.

A motor that leaves its mode does not follow, and jumps to its target when it comes back:

    self.modes = ModeGuard(LABEL, robot.joint_names, commanded)
    self.modes.reported[...] = …              # of each frame
    why = self.modes(stiffness, torque)       # before each command, as `WiredRobot` does
"""

from __future__ import annotations

import math
import time

import numpy as np
from numpy.typing import ArrayLike

from unicon_base.arrays import Float32

SETTLES = 0.2
"""A motor may reach its mode so much later than the one before, [s]: 100 frames at 500 Hz."""
UNDOCUMENTED = math.inf
"""`settles` where no public source says what a robot reports as a motor's mode."""


class ModeGuard:
    """Finds a motor that is in another mode than the commanded one while commands push.

    A motor is guarded from the first frame on in which it reports the commanded mode while commands
    have stiffness or torque. One that never does is not: some firmware reports something else
    there. But where others that are commanded the same mode report it, it has to within `settles`.

    Args:
        label: in front of the reason.
        names: of the joints.
        commanded: mode of every motor, or of each, shape (n,).
        settles: see above, [s].
        called: what the commanded mode is called in messages.

    Attributes:
        commanded: mode of each motor, shape (n,), uint8.
        reported: mode that each motor reported last, shape (n,), uint8; the wire writes it.
        left: which motor has left its mode, once one has; "" before. It stays.
    """

    def __init__(
        self,
        label: str,
        names: tuple[str, ...],
        commanded: ArrayLike,
        *,
        settles: float = SETTLES,
        called: str = "the commanded mode",
    ) -> None:
        n = len(names)
        self.commanded = np.array(np.broadcast_to(np.asarray(commanded, np.uint8), (n,)))
        self.reported = np.zeros(n, np.uint8)
        self.left = ""
        self._label, self._names, self._called, self._settles = label, names, called, settles
        self._right, self._guarded = self.commanded.tobytes(), np.zeros(n, bool)
        self._behind = np.zeros(n, bool)  # others that are commanded the same mode report it
        self._all, self._since = False, math.inf

    def __call__(self, *pushing: Float32) -> str:
        """Let go once a motor has left its mode; return which, the first time, else "".

        Args:
            pushing: stiffness and torques of the command that is to be sent; zero from then on.
        """
        if self._all and not self.left and self.reported.tobytes() == self._right:
            return ""
        before = self.left
        if not before:
            self._look(pushing)
        if self.left:
            for values in pushing:
                values[...] = 0.0
        return "" if before else self.left

    def _look(self, pushing: tuple[Float32, ...]) -> None:
        right = self.reported == self.commanded
        out = self._guarded & ~right
        if not out.any() and any(values.any() for values in pushing):
            if (right & ~self._guarded).any():
                self._since = time.monotonic()
                self._guarded |= right
                self._all = bool(self._guarded.all())
                others = np.isin(self.commanded, self.commanded[self._guarded])
                self._behind = others & ~self._guarded
            if self._behind.any() and time.monotonic() - self._since >= self._settles:
                out = self._behind
        if out.any():
            motor = self._of(int(np.argmax(out)))
            self.left = f"{self._label}: {motor} since it takes commands; the robot was damped"

    def other(self) -> str:
        """Return the first motor that is not in the commanded mode, "" where all are."""
        wrong = np.flatnonzero(self.reported != self.commanded)
        return self._of(int(wrong[0])) if len(wrong) else ""

    @property
    def note(self) -> str:
        """What motors report now, beside what commands name, for preflight."""
        pairs = zip(self.commanded.tolist(), self.reported.tolist())
        told = (f"{reported:#04x} (commanded {mode:#04x})" for mode, reported in sorted({*pairs}))
        return f"motors report mode {', '.join(told)}"

    @property
    def unguarded(self) -> list[str]:
        """Joints whose motors have never reported the commanded mode while commands pushed."""
        return [name for name, guarded in zip(self._names, self._guarded) if not guarded]

    def _of(self, joint: int) -> str:
        mode, wanted = self.reported[joint], self.commanded[joint]
        return (
            f"motor {self._names[joint]} is in mode {mode:#04x}, not in {self._called} "
            f"{wanted:#04x}"
        )
