"""Block `drive`: sticks command the velocity, as long as a button is held where one is named."""

from __future__ import annotations

from typing import Annotated

from unicon_core.blocks.controls.device import declares_controls
from unicon_core.blocks.joint_command import single
from unicon_core.buttons import BUTTONS, Button
from unicon_core.flow.block import Reads, Writes
from unicon_core.schema.marks import Within, Write

Fast = Annotated[float, Within(0.0)]
FASTEST = (0.5, 0.3, 0.8)


class Drive:
    """Command by the left stick where to, by the right one how to turn.

    Nothing is commanded while the device is not heard.

    Args:
        speed: at full deflection, vx and vy in [m/s], wz in [rad/s].
        dead_zone: share of a stick's way that commands nothing.
        hold: button that has to be held, a dead-man switch; None for no such.

    Raises:
        WorkflowError: it is for several robots.
    """

    memory = ()

    endless = True
    declares = staticmethod(declares_controls)

    def __init__(
        self,
        sticks: Reads,
        buttons: Reads,
        controls_alive: Reads,
        velocity_command: Writes,
        *,
        speed: Annotated[tuple[Fast, Fast, Fast], Write("[vx, vy, wz] of 0 or more")] = FASTEST,
        dead_zone: Annotated[float, Within(0.0, 0.9)] = 0.1,
        hold: Button | None = None,
    ) -> None:
        single(sticks)
        self._sticks, self._buttons, self._alive = sticks, buttons, controls_alive
        self.buttons_used = () if hold is None else (hold,)
        self._held = None if hold is None else BUTTONS.index(hold)
        self._out, self._dead_zone = velocity_command, dead_zone
        vx, vy, wz = speed
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
