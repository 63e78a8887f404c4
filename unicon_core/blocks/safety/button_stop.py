"""Stops for the operator's hand.

`button_stop`: a button is pressed, or the device is gone. `remote_stop`: the buttons of the robot's
own remote that its vendor uses to damp it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from unicon_core.blocks.controls.device import declares_controls
from unicon_core.blocks.controls.drive import button_named
from unicon_core.blocks.joint_command import ticks_of
from unicon_core.errors import EmergencyStopPressed, Fault, WorkflowError
from unicon_core.flow.block import Reads
from unicon_core.robots import Robot

STEADY = 2
"""For how many ticks all buttons of an emergency stop are pressed: one frame may be garbage."""


def button_stop(
    buttons: Reads,
    controls_alive: Reads,
    *,
    period: float,
    on: Sequence[str] = ("select",),
    lost: float | None = None,
) -> ButtonStop:
    """Stop where one of some buttons is pressed, or the device has not been heard for a while.

    Args:
        on: names of buttons, any of them.
        lost: how long the device may be silent in [s], from the first tick on; None for ever, where
            a robot walks on its own.

    Raises:
        WorkflowError: no such button.
    """
    if isinstance(on, str) or not on:
        raise WorkflowError(f"on is {on!r}; give a list of buttons, such as [select]")
    places = {button_named(name, "on"): name for name in on}
    return ButtonStop(buttons, controls_alive, places, ticks_of(lost, period, "lost"))


setattr(button_stop, "declares", declares_controls)  # noqa: B010  a function has none to mypy


class ButtonStop:
    """The tick of `button_stop`."""

    memory = ("_silent",)

    endless = True

    def __init__(
        self,
        buttons: NDArray[np.int32],
        alive: NDArray[np.int32],
        places: dict[int, str],
        lost: int | None,
    ) -> None:
        self._buttons, self._alive, self._places, self._lost = buttons, alive, places, lost
        self._silent = 0
        self.buttons_used = tuple(places.values())

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


def remote_stop(buttons: Reads, *, robot: Robot, on: Sequence[str] | None = None) -> RemoteStop:
    """Stop as by an emergency stop where all of some buttons are held for two ticks.

    A remote that is switched off presses nothing, so it is no fault.

    Args:
        on: names of buttons, all of which are held; None for `transport.stop_buttons` of the robot
            file, the vendor's combination for damping.

    Raises:
        WorkflowError: no such button, or neither the robot file nor the workflow names one.
    """
    names = robot.transport.get("stop_buttons") if on is None else on
    if isinstance(names, str) or not names:
        raise WorkflowError(
            f"{robot.path.name} has no transport.stop_buttons; give on: a list of buttons, such as "
            "[L2, B]"
        )
    return RemoteStop(buttons, {button_named(name, "on"): name for name in names})


setattr(remote_stop, "declares", declares_controls)  # noqa: B010  a function has none to mypy


class RemoteStop:
    """The tick of `remote_stop`.

    Attributes:
        names: of the buttons.
    """

    memory = ("_ticks",)

    endless = True

    def __init__(self, buttons: NDArray[np.int32], places: dict[int, str]) -> None:
        self._buttons, self._places, self._ticks = buttons, tuple(places), 0
        self.names = tuple(places.values())

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
