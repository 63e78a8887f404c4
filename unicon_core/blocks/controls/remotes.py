"""Remotes: the bytes in which robots tell their own remote, into sticks and buttons; for drivers.

Those of Unitree are written, too, for emulated robots.

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
import struct
from collections.abc import Callable, Iterable
from typing import Any

from unicon_core.blocks.controls.device import Controls
from unicon_core.bounds import BUTTONS

_UNITREE = struct.Struct("<2xH3f4xf16x")
_DOBOT = struct.Struct("<2xBB4f20x")
_PND = struct.Struct("<19f")
_BOOSTER = struct.Struct("<I4f21Bx")
# The two in between are the sticks, pressed; the cross follows.
_BOOSTER_BUTTONS = ("A", "B", "X", "Y", "L1", "R1", "L2", "R2", "", "", "select", "start")
_BOOSTER_CROSS = (
    *("", "up", "down", "left", "right"),
    *("up left", "down left", "up right", "down right"),
)
_BOOSTER_GONE = 0x606
# Bits 0 to 5 of byte 2.
_DOBOT_2 = ("RB", "LB", "start", "select", "RT", "LT")
# Bits 0 to 7 of byte 3.
_DOBOT_3 = ("A", "B", "X", "Y", "up", "right", "down", "left")
_OURS = {"RB": "R1", "LB": "L1", "RT": "R2", "LT": "L2"}
_PND_BUTTONS = ("A", "B", "X", "Y", "L1", "R1", "select", "start")
PND_FULL, PND_DEAD = 32767.0, 5000.0


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
