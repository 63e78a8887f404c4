"""Remote: a game pad, or a pipe, held as the remote of an emulated robot; for faces."""

from __future__ import annotations

import sys
from collections.abc import Callable

from unicon_core.blocks.controls.device import Controls
from unicon_core.blocks.controls.gamepad import gamepad
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_core.states.standard import control_states
from unicon_core.workflow.autowire import BuildContext


class Remote:
    """Brings what is held into the bytes that the robot tells.

    Args:
        device: as of block `gamepad`.
        robot: whose remote it is.
        raw: those bytes.
        pressed: writes sticks and buttons into them, as of `unicon_core.blocks.controls.remotes`.

    Raises:
        WorkflowError: the device is a file that is neither device nor pipe.
    """

    def __init__(
        self,
        device: str,
        robot: Robot,
        raw: bytearray,
        pressed: Callable[[Controls, bytearray], None],
    ) -> None:
        states = States(control_states())
        context = BuildContext(states, robot, 1.0, tell=_say)
        self._pad = gamepad(context=context, device=device)
        self._controls, self._raw, self._pressed = Controls(states), raw, pressed

    def __call__(self) -> None:
        """Look at what is held now; it never waits."""
        self._pad()
        self._pressed(self._controls, self._raw)

    def close(self) -> None:
        """Let go of the device."""
        if self._pad.close is not None:
            self._pad.close()


def _say(line: str) -> None:
    print(f"unicon: {line}", file=sys.stderr)  # standard output has the robot's own lines
