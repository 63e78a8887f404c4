"""Block `keyboard`: the keys of the terminal as sticks and buttons.

w s: forward, back; a d: left, right; q e: turn; space: all zero; 1 to 9: buttons. A key counts for
half a second, which a key that is held down repeats in time: who lets go, or closes the terminal,
drives nothing.
"""

from __future__ import annotations

import os
import select
import sys
from contextlib import suppress
from typing import Annotated, Any

from unicon_base.schema.marks import Within
from unicon_core.blocks.controls.device import Controls, declares_controls, device_block
from unicon_core.blocks.joint_command import ticks_of
from unicon_core.bounds import BUTTONS
from unicon_core.flow import Block
from unicon_core.workflow.autowire import BuildContext

STICK_KEYS = {
    "w": (1, 1.0),
    "s": (1, -1.0),
    "a": (0, -1.0),
    "d": (0, 1.0),
    "q": (2, -1.0),
    "e": (2, 1.0),
}
"""Key to element of `sticks` and value."""
BUTTON_KEYS = dict(zip("123456789", ("A", "B", "X", "Y", "start", "select", "L1", "R1", "L2")))
ESCAPE = "\x1b"


def keyboard(
    *,
    context: BuildContext,
    hold: Annotated[float, Within(0.05, 2.0, "s")] = 0.5,
) -> Block:
    """Write sticks and buttons as keys of the terminal say.

    Keys count once commands leave: before that Enter is the operator's go.

    Args:
        hold: for how long a key counts in [s]; terminals repeat one that is held after 0.25 to
            0.5 s, and then 30 times a second.
    """
    ticks = ticks_of(hold, context.period)
    return device_block("keyboard", Keyboard(Controls(context.states), ticks, context), context)


setattr(keyboard, "declares", declares_controls)  # noqa: B010  a function has none to mypy


class Keyboard:
    """The tick of `keyboard`."""

    memory = ("_left",)

    def __init__(self, controls: Controls, ticks: int, context: BuildContext) -> None:
        self._controls, self._ticks, self._context = controls, ticks, context
        self._left = [0] * (4 + len(BUTTONS))
        self._before: list[Any] | None = None
        self._open = not context.dry
        self._told = False

    def __call__(self) -> None:
        if not self._open or not self._context.driving() or not self._entered():
            return
        self._decay()
        if not select.select([0], [], [], 0.0)[0]:
            return
        try:
            pressed = os.read(0, 64).decode("ascii", "replace").lower()
        except OSError:
            pressed = ""
        if not pressed:
            self.close()
            self._context.tell("keyboard: the terminal has gone; nothing is pressed any more")
            return
        if ESCAPE in pressed:  # arrows and the like
            pressed = ""
        for key in pressed:
            self._press(key)

    def _press(self, key: str) -> None:
        controls = self._controls
        if key in STICK_KEYS:
            element, value = STICK_KEYS[key]
            controls.sticks[element] = value
            self._left[element] = self._ticks
        elif key in BUTTON_KEYS:
            element = BUTTONS.index(BUTTON_KEYS[key])
            controls.buttons[element] = 1
            self._left[4 + element] = self._ticks
        elif key == " ":
            controls.sticks[...] = 0.0
            controls.buttons[...] = 0

    def _decay(self) -> None:
        for place, left in enumerate(self._left):
            if not left:
                continue
            self._left[place] = left - 1
            if left == 1:
                if place < 4:
                    self._controls.sticks[place] = 0.0
                else:
                    self._controls.buttons[place - 4] = 0

    def _entered(self) -> bool:
        """Take the terminal, once; Ctrl-C stays a signal."""
        if self._before is not None:
            return True
        import termios
        import tty

        try:
            if not sys.stdin.isatty():
                raise OSError("standard input is not a terminal")
            before = termios.tcgetattr(0)
            tty.setcbreak(0)
        except (AttributeError, ValueError, OSError, termios.error) as error:
            self._open = False
            self._context.tell(f"keyboard: {error}; nothing is pressed")
            return False
        self._before = before
        self._controls.alive[...] = 1
        return True

    def reset(self) -> None:
        """Let go of what was pressed before."""
        self._left = [0] * len(self._left)
        self._controls.sticks[...] = 0.0
        self._controls.buttons[...] = 0

    def close(self) -> None:
        """Give the terminal back as it was."""
        self._open = False
        self._controls.let_go()
        if self._before is not None:
            import termios

            with suppress(OSError, termios.error):
                termios.tcsetattr(0, termios.TCSADRAIN, self._before)
            self._before = None
