"""Stop for the operator's hand: a button is pressed, or his device is gone: `button_stop`."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from unicon_core.blocks.controls.device import declares_controls
from unicon_core.blocks.controls.drive import button_named
from unicon_core.blocks.joint_command import ticks_of
from unicon_core.errors import Fault, WorkflowError
from unicon_core.flow.block import Reads

__all__ = ["ButtonStop", "button_stop"]


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
