"""Block `drive`: sticks command the velocity, as long as a button is held where one is named."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from unicon_core.blocks.controls.device import declares_controls
from unicon_core.bounds import within
from unicon_core.errors import WorkflowError, alternatives
from unicon_core.flow.block import Reads, Writes
from unicon_core.states.standard import BUTTONS


def drive(
    sticks: Reads,
    buttons: Reads,
    controls_alive: Reads,
    velocity_command: Writes,
    *,
    speed: Sequence[float] = (0.5, 0.3, 0.8),
    dead_zone: float = 0.1,
    hold: str | None = None,
) -> Drive:
    """Command by the left stick where to, by the right one how to turn.

    Nothing is commanded while the device is not heard.

    Args:
        speed: at full deflection, vx and vy in [m/s], wz in [rad/s].
        dead_zone: share of a stick's way that commands nothing.
        hold: button that has to be held, a dead-man switch; None for no such.

    Raises:
        WorkflowError: an option is not plausible, or it is for several robots.
    """
    if sticks.ndim != 1:
        raise WorkflowError("one operator drives one robot; leave num_robots out")
    within(dead_zone, "dead_zone", "", 0.9, above=False)
    speeds = np.array(speed, np.float64)
    if speeds.shape != (3,) or not np.isfinite(speeds).all() or (speeds < 0.0).any():
        raise WorkflowError(f"speed is {speed}; give [vx, vy, wz] of 0 or more")
    held = None if hold is None else button_named(hold, "hold")
    return Drive((sticks, buttons, controls_alive), velocity_command, speeds, dead_zone, held)


setattr(drive, "declares", declares_controls)  # noqa: B010  a function has none to mypy


def button_named(name: str, option: str) -> int:
    """Return the element of `buttons` of a name.

    Raises:
        WorkflowError: there is none.
    """
    if name not in BUTTONS:
        raise WorkflowError(f"{option}: no button {name!r}; {alternatives(name, BUTTONS)}")
    return BUTTONS.index(name)


class Drive:
    """The tick of `drive`."""

    memory = ()

    endless = True

    def __init__(
        self,
        controls: tuple[NDArray[np.float32], NDArray[np.int32], NDArray[np.int32]],
        out: NDArray[np.float32],
        speed: NDArray[np.float64],
        dead_zone: float,
        held: int | None,
    ) -> None:
        self._sticks, self._buttons, self._alive = controls
        self.buttons_used = () if held is None else (BUTTONS[held],)
        self._out, self._held, self._dead_zone = out, held, dead_zone
        vx, vy, wz = speed.tolist()
        # Right is positive on a stick, and left on the ground.
        self._axes = ((1, vx), (0, -vy), (2, -wz))

    def __call__(self) -> None:
        held = self._held is None or self._buttons[self._held]
        if not (held and self._alive):
            self._out[...] = 0.0
            return
        sticks = self._sticks.tolist()
        for element, (axis, factor) in enumerate(self._axes):
            self._out[..., element] = factor * self._steady(sticks[axis])

    def _steady(self, value: float) -> float:
        beyond = abs(value) - self._dead_zone
        if not beyond > 0.0:  # true for NaN
            return 0.0
        share = min(beyond / (1.0 - self._dead_zone), 1.0)
        return share if value > 0.0 else -share
