"""Stops for the operator's hand.

`button_stop`: a button is pressed, or the device is gone. `remote_stop`: the buttons of the robot's
own remote that its vendor uses to damp it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

from unicon_core.blocks.controls.device import declares_controls
from unicon_core.blocks.joint_command import end_of
from unicon_core.bounds import Seconds
from unicon_core.buttons import BUTTONS, Button
from unicon_core.errors import EmergencyStopPressed, Fault, WorkflowError
from unicon_core.flow.block import Reads
from unicon_core.robots import Robot
from unicon_core.schema.marks import NotEmpty, Write

Buttons = Annotated[Sequence[Button], NotEmpty, Write("a list of buttons, such as [select]")]
STEADY = 2
"""For how many ticks all buttons of an emergency stop are pressed: one frame may be garbage."""


class ButtonStop:
    """Stop where one of some buttons is pressed, or the device has not been heard for a while.

    Args:
        on: names of buttons, any of them.
        lost: how long the device may be silent in [s], from the first tick on; None for ever, where
            a robot walks on its own.
    """

    memory = ("_silent",)

    endless = True
    declares = staticmethod(declares_controls)

    def __init__(
        self,
        buttons: Reads,
        controls_alive: Reads,
        *,
        period: float,
        on: Buttons = ("select",),
        lost: Seconds | None = None,
    ) -> None:
        self._buttons, self._alive, self._lost = buttons, controls_alive, end_of(lost, period)
        self._places = {BUTTONS.index(name): name for name in on}
        self._silent = 0
        self.buttons_used = tuple(on)

    def __call__(self) -> None:
        for place, name in self._places.items():
            if self._buttons[place]:
                raise Fault(f"the operator pressed {name}")
        self._silent = 0 if self._alive else self._silent + 1
        if self._lost is not None and self._silent > self._lost:
            raise Fault(
                f"the operator's device was not heard for {self._silent} ticks; more than "
                f"{self._lost} are a fault (button_stop)"
            )

    def reset(self) -> None:
        """Count anew."""
        self._silent = 0


class RemoteStop:
    """Stop as by an emergency stop where all of some buttons are held for two ticks.

    A remote that is switched off presses nothing, so it is no fault.

    Args:
        on: names of buttons, all of which are held; None for `transport.stop_buttons` of the robot
            file, the vendor's combination for damping.

    Attributes:
        names: of the buttons.

    Raises:
        WorkflowError: neither the robot file nor the workflow names one.
    """

    memory = ("_ticks",)

    endless = True
    declares = staticmethod(declares_controls)

    def __init__(
        self,
        buttons: Reads,
        *,
        robot: Robot,
        on: Buttons | None = None,
    ) -> None:
        names = robot.transport.get("stop_buttons") if on is None else on
        if not names:
            raise WorkflowError(
                f"{robot.path.name} has no transport.stop_buttons; give on: a list of buttons, "
                "such as [L2, B]"
            )
        self.names = tuple(names)
        self._buttons, self._places, self._ticks = buttons, [*map(BUTTONS.index, names)], 0

    def __call__(self) -> None:
        for place in self._places:
            if not self._buttons[place]:
                self._ticks = 0
                return
        self._ticks += 1
        if self._ticks >= STEADY:
            raise EmergencyStopPressed(
                f"the operator pressed {'+'.join(self.names)} on the remote (remote_stop)"
            )

    def reset(self) -> None:
        """Count anew."""
        self._ticks = 0
