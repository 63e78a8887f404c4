"""What an operator holds: control states, block `keyboard`, and the remotes of robots.

Block `keyboard`: w s: forward, back; a d: left, right; q e: turn; space: all zero; 1 to 9: buttons.
A key counts for half a second, which a key that is held down repeats in time: who lets go, or
closes the terminal, drives nothing.

Remotes: the bytes in which robots send their own remote, into sticks and buttons. Those of
Unitree are written, too, for emulated robots.

Unitree: 40 bytes in LowState and in the UDP frames; uint16 at 2, bits 0 to 15 as `BUTTONS`; float32
lx at 4, rx at 8, ry at 12, ly at 20; unitreerobotics/unitree_sdk2 example/g1/low_level/gamepad.hpp.
Dobot Atom: 40 bytes; buttons in bytes 2 and 3, float32 lx at 4, rx at 8, ry at 12, ly at 16.
PND Adam: 19 float32; lx, ly, rx, ry of ±32767, dead zone 5000, lt, rt, then at 8 A B X Y LB RB
select start; pndbotics/pnd_rl_gym deploy/deploy_real/common/remote_controller.py. Of the cross at 6
and 7 the signs are not known: it is left.
Booster T1: 42 bytes, body of RemoteControllerState; uint32 event, 0x606 when the device is gone;
float32 lx, ly, rx, ry, of which ly and ry are negative in front; 21 bytes of buttons and cross;
BoosterRobotics/booster_robotics_sdk_ros2 booster_ros2_interface/msg/RemoteControllerState.msg.
"""

from __future__ import annotations

import math
import os
import select
import struct
import sys
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from typing import Annotated, Any

from unicon_base.arrays import Float32, Int32
from unicon_base.schema.marks import Within
from unicon_core.blocks.postures import ticks_of
from unicon_core.bounds import BUTTONS
from unicon_core.flow import Block, Stage
from unicon_core.states import States, StateSpec
from unicon_core.states.standard import CONTROL_STATES, control_states
from unicon_core.workflow.autowire import BuildContext


class Controls:
    """The views of the control states.

    Args:
        states: of the workflow.

    Attributes:
        sticks: lx, ly, rx, ry, shape (4,).
        buttons: as of `BUTTONS`, shape (16,).
        alive: 1 while the device is heard, shape ().
    """

    def __init__(self, states: States) -> None:
        self.sticks: Float32 = states["sticks"]
        self.buttons: Int32 = states["buttons"]
        self.alive: Int32 = states["controls_alive"]

    def let_go(self) -> None:
        """Release all that is pressed: the device is not heard."""
        self.sticks[...] = 0.0
        self.buttons[...] = 0
        self.alive[...] = 0


def declares_controls(**_: Any) -> Mapping[str, StateSpec]:
    """Return the states of a block that writes, or reads, what an operator holds."""
    return control_states()


def device_block(name: str, tick: Callable[[], None], context: BuildContext) -> Block:
    """Return the block of a device; it is received, so that every record has what it told.

    A robot that tells its own remote has no need of it: the block then does nothing.
    """
    told = () if context.platform is None else context.platform.facts.writes
    if "sticks" in told:
        return Block(name, bool, endless=True, stage=Stage.RECV)
    closing = {end: getattr(tick, end) for end in ("reset", "close")}
    return Block("device", tick, writes=CONTROL_STATES, endless=True, stage=Stage.RECV, **closing)


_UNITREE = struct.Struct("<2xH3f4xf16x")
_DOBOT = struct.Struct("<2xBB4f20x")
_PND = struct.Struct("<19f")
_BOOSTER = struct.Struct("<I4f21Bx")
# The two in between are the sticks, pressed; the cross follows.
_BOOSTER_BUTTONS = ("A", "B", "X", "Y", "L1", "R1", "L2", "R2", "", "", "select", "start")
_BOOSTER_CROSS = (
    "", "up", "down", "left", "right", "up left", "down left", "up right", "down right"
)  # fmt: skip
_BOOSTER_GONE = 0x606
# Bits 0 to 5 of byte 2.
_DOBOT_2 = ("RB", "LB", "start", "select", "RT", "LT")
# Bits 0 to 7 of byte 3.
_DOBOT_3 = ("A", "B", "X", "Y", "up", "right", "down", "left")
_OURS = {"RB": "R1", "LB": "L1", "RT": "R2", "LT": "L2"}
_PND_BUTTONS = ("A", "B", "X", "Y", "L1", "R1", "select", "start")
PND_FULL = 32767.0
PND_DEAD = 5000.0


def _take(controls: Controls, sticks: Iterable[float], pressed: Iterable[str]) -> None:
    for element, value in enumerate(sticks):
        good = math.isfinite(value)
        controls.sticks[element] = min(max(value, -1.0), 1.0) if good else 0.0
    controls.buttons[...] = 0
    for name in pressed:
        controls.buttons[BUTTONS.index(name)] = 1
    controls.alive[...] = 1


def unitree(raw: Any, controls: Controls) -> None:
    """Take the 40 bytes of a Unitree robot."""
    bits, lx, rx, ry, ly = _UNITREE.unpack(raw)
    _take(controls, (lx, ly, rx, ry), [n for i, n in enumerate(BUTTONS) if bits >> i & 1])


def unitree_pressed(controls: Controls, raw: bytearray) -> None:
    """Write the 40 bytes that `unitree` takes."""
    lx, ly, rx, ry = map(float, controls.sticks)
    bits = sum(1 << element for element, pressed in enumerate(controls.buttons) if pressed)
    _UNITREE.pack_into(raw, 0, bits, lx, rx, ry, ly)


def dobot(raw: Any, controls: Controls) -> None:
    """Take the 40 bytes of a Dobot Atom."""
    low, high, lx, rx, ry, ly = _DOBOT.unpack(raw)
    named = [*enumerate(_DOBOT_2), *enumerate(_DOBOT_3, 8)]
    pressed = [_OURS.get(name, name) for i, name in named if (low | high << 8) >> i & 1]
    _take(controls, (lx, ly, rx, ry), pressed)


def pnd(raw: Any, controls: Controls) -> None:
    """Take the 19 float32 of a PND Adam."""
    lx, ly, rx, ry, lt, rt, _, _, *pressed = _PND.unpack(raw)
    steady = (0.0 if abs(value) < PND_DEAD else value / PND_FULL for value in (lx, ly, rx, ry))
    told = zip((*_PND_BUTTONS, "L2", "R2"), (*pressed[: len(_PND_BUTTONS)], lt, rt))
    _take(controls, steady, [name for name, value in told if value > 0.5])  # false for NaN


def booster(raw: Any, controls: Controls) -> None:
    """Take the 42 bytes of a Booster robot."""
    event, lx, ly, rx, ry, *pressed = _BOOSTER.unpack(raw)
    if event == _BOOSTER_GONE:
        controls.let_go()
        return
    named = zip(_BOOSTER_BUTTONS + _BOOSTER_CROSS, pressed, strict=True)
    _take(controls, (lx, -ly, rx, -ry), " ".join(n for n, on in named if on).split())


REMOTES: dict[str, tuple[int, Callable[[Any, Controls], None]]] = {
    "unitree": (40, unitree),
    "dobot": (40, dobot),
    "pnd": (76, pnd),
    "booster": (42, booster),
}
"""`transport.remote` of a robot file to the number of bytes, and what takes them."""

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
HELP = (
    "note: keys: w s forward and back, a d left and right, q e turn, space zero, 1 to 9 A B X Y "
    "start select L1 R1 L2, ? these"
)


def keyboard(
    *, context: BuildContext, hold: Annotated[float, Within(0.05, 2.0, "s")] = 0.5
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


def take_terminal() -> Callable[[], object]:
    """Get keys as they are pressed, Ctrl-C stays a signal; return what gives the terminal back.

    Raises:
        OSError: standard input is not a terminal.
    """
    import termios
    import tty

    try:
        if not sys.stdin.isatty():
            raise OSError("standard input is not a terminal")
        before = termios.tcgetattr(0)
        tty.setcbreak(0)
    except (AttributeError, ValueError, termios.error) as error:
        raise OSError(str(error)) from error

    def give_back() -> None:
        with suppress(OSError, termios.error):
            termios.tcsetattr(0, termios.TCSADRAIN, before)

    return give_back


def read_keys(patience: float = 0.0) -> bytes | None:
    """Return what was pressed within a time in [s], b"" for nothing; None: the input has gone."""
    try:
        return os.read(0, 64) or None if select.select([0], [], [], patience)[0] else b""
    except OSError:
        return None


class Keyboard:
    """The tick of `keyboard`."""

    memory = ("_left",)

    def __init__(self, controls: Controls, ticks: int, context: BuildContext) -> None:
        self._controls = controls
        self._ticks = ticks
        self._context = context
        self._left = [0] * (4 + len(BUTTONS))
        self._give_back: Callable[[], object] | None = None
        self._open = not context.dry

    def __call__(self) -> None:
        if not self._open or not self._context.driving() or not self._entered():
            return
        self._decay()
        read = read_keys()
        if read is None:
            self.close()
            self._context.tell("keyboard: the terminal has gone; nothing is pressed any more")
            return
        pressed = read.decode("ascii", "replace").lower()
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
        elif key == "?":
            self._context.tell(HELP)
        elif key == " ":
            self.reset()

    def _decay(self) -> None:
        for place, left in enumerate(self._left):
            if left == 1 and place < 4:
                self._controls.sticks[place] = 0.0
            elif left == 1:
                self._controls.buttons[place - 4] = 0
            self._left[place] = max(left - 1, 0)

    def _entered(self) -> bool:
        """Take the terminal, once; Ctrl-C stays a signal."""
        if self._give_back is not None:
            return True
        try:
            self._give_back = take_terminal()
        except OSError as error:
            self._open = False
            self._context.tell(f"keyboard: {error}; nothing is pressed")
            return False
        self._context.tell(HELP)
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
        if self._give_back is not None:
            self._give_back()
            self._give_back = None
