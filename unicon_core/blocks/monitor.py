"""Monitor: watches a run for its report: displacement, fall, hash of the commands."""

from __future__ import annotations

import hashlib
import math
from functools import partial
from typing import Any

import numpy as np

from unicon_core.states import States
from unicon_core.states.stacked import flat
from unicon_core.states.standard import COMMAND_STATES


class Monitor:
    """Watches a run for its report: displacement, fall, hash of the commands; after `send`.

    Args:
        states: of the workflow.
        dry: nothing is sent.
        fixed: the base cannot move, so that it neither falls nor gets anywhere.

    Attributes:
        held: a gantry holds the base, so that it cannot fall; the builder says it.
    """

    FALL_COSINE = 0.5
    """Cosine of the tilt that counts as a fall: 60° from upright."""
    FALL_HEIGHT = 0.5
    """Share of its height at first below which a base has sunk."""
    ODOMETRY = 0.1
    """Height in [m] up to which no base is judged: an odometry may begin at a zero of its own."""

    name = "report"
    reads = ("base_pos_w", "projected_gravity", *COMMAND_STATES)

    def __init__(self, states: States, *, dry: bool = False, fixed: bool = False) -> None:
        self._dry, self._fixed, self.held = dry, fixed, False
        self._pos = states["base_pos_w"].reshape(-1, 3)
        gravity = states["projected_gravity"].reshape(-1, 3)[:, 2]
        # `max` takes 1.3 µs where one number takes 0.1.
        self._least_upright = partial(gravity.item, 0) if len(gravity) == 1 else gravity.max
        self._start = self._pos.copy()
        self._commands = [view.data for view in flat([states[n] for n in COMMAND_STATES])]
        self.begin()

    def begin(self) -> None:
        """Begin a run; that of before does not count any more."""
        self._started = False
        self._hash = hashlib.sha256()
        self._worst = -1.0

    def __call__(self) -> None:
        if not self._started:
            self._start[...] = self._pos
            self._started = True
        for view in self._commands:
            self._hash.update(view)
        upright = self._least_upright()
        if not upright <= self._worst:
            self._worst = upright if upright > self._worst else 1.0  # NaN is the worst

    @property
    def fell(self) -> bool:
        """Whether the base tilted further than a walking robot comes back from."""
        return not self._worst <= -self.FALL_COSINE

    @property
    def sha256(self) -> str:
        """SHA-256 over the command states of every tick so far."""
        return self._hash.hexdigest()

    def finish(self) -> None:
        """Let nothing count that comes from here on."""
        self._pos = self._pos.copy()

    def found(self) -> dict[str, Any]:
        """Return what was seen: fields of a report."""
        seen: dict[str, Any] = {"sha256_commands": self.sha256, "dry": self._dry}
        if self._fixed:
            return seen | dict.fromkeys(("base_displacement_m", "fell", "tilt_deg"))
        moved = self._pos[0] - self._start[0] if self._started else np.zeros(3)
        first = self._start[0, 2]
        known = self._started and first > self.ODOMETRY  # else it may begin at a zero of its own
        tilt = math.degrees(math.acos(max(-1.0, min(-self._worst, 1.0))))
        return seen | {
            "base_displacement_m": [round(float(value), 6) for value in moved],
            "fell": None if self.held else self.fell,
            "sank": bool(known and first + moved[2] < self.FALL_HEIGHT * first),
            "tilt_deg": round(tilt, 1),
        }
