"""Block `headset_controls`: a headset's controllers as sticks and buttons, as a game pad has them.

    commands: [webxr, headset_controls, {drive: {speed: [0.5, 0.3, 0.8]}}]

Buttons are named by place, as on a Unitree remote: A and B of the right controller, X and Y of the
left one; L1 and R1 are squeezed, L2 and R2 the triggers, F1 and F2 the sticks that are pressed.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from unicon_core.blocks.controls.device import declares_controls
from unicon_core.bounds import BUTTONS
from unicon_core.flow.block import Writes
from unicon_core.states import States
from unicon_manipulation.teleop.operator import Headset

PRESSED = 0.5
"""How far a button is pressed that counts, 0 to 1."""

# Side to the controller's button and ours.
_BUTTONS: Mapping[str, Mapping[str, str]] = {
    "left": {"squeeze": "L1", "trigger": "L2", "thumbstick": "F1", "a": "X", "b": "Y"},
    "right": {"squeeze": "R1", "trigger": "R2", "thumbstick": "F2", "a": "A", "b": "B"},
}
# Side to the elements of `sticks`: thumbstick x and y, of which y is positive to the back.
_STICKS = {"left": (0, 1), "right": (2, 3)}


class HeadsetControls:
    """Write sticks and buttons of a headset's controllers; all zero while none is tracked.

    A robot that tells its own remote writes these states itself: rename them here and in the blocks
    that read them (`states: {sticks: headset_sticks}`).

    Args:
        device: prefix of the headset's states.

    Raises:
        WorkflowError: there is no such device.
    """

    memory = ()

    endless = True
    declares = staticmethod(declares_controls)

    def __init__(
        self,
        sticks: Writes,
        buttons: Writes,
        controls_alive: Writes,
        *,
        states: States,
        device: str = "webxr",
    ) -> None:
        headset = Headset(states, device)
        self._sticks, self._buttons, self._heard = sticks, buttons, controls_alive
        self._alive, self._valid = headset.alive, headset.valid
        self._sides = [
            (
                headset.part(f"{side}_controller"),
                headset.view(f"{side}_axes"),
                [headset.named(f"{side}_axes", f"thumbstick_{axis}") for axis in "xy"],
                _STICKS[side],
                headset.view(f"{side}_buttons"),
                [headset.named(f"{side}_buttons", name) for name in named],
                [BUTTONS.index(name) for name in named.values()],
            )
            for side, named in _BUTTONS.items()
        ]
        self.reads = tuple(headset.reads)

    def __call__(self) -> None:
        self._sticks[...] = 0.0
        self._buttons[...] = 0
        self._heard[...] = self._alive
        if not self._alive:
            return
        for part, axes, (across, along), (x, y), pressed, theirs, ours in self._sides:
            if not self._valid[part]:
                continue
            self._sticks[x], self._sticks[y] = _share(axes[across]), -_share(axes[along])
            for button, element in zip(theirs, ours):
                self._buttons[element] = pressed[button] > PRESSED

    def reset(self) -> None:
        """Let go of what was pressed before."""
        self._sticks[...] = 0.0
        self._buttons[...] = 0
        self._heard[...] = 0


def _share(value: Any) -> float:
    return max(-1.0, min(float(value), 1.0)) if value == value else 0.0
