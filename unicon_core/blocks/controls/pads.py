"""Pads: which codes of Linux's input events a game pad has, by what it is, for block `gamepad`.

Buttons are named by place, as on a Unitree remote: A below, B right, X left, Y above. The same code
stands for other places on other pads. Sources: the kernel's drivers (xpad.c, hid-playstation.c,
hid-nintendo.c; Documentation/input/gamepad.rst), and SDL's data base of pads (gamecontrollerdb.txt)
for 8BitDo's and Logitech's own modes, which are plain HID.
"""

from __future__ import annotations

import errno
import fcntl
import os
import struct
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

INPUT = Path("/dev/input")

# BTN_TL … BTN_THUMBR and BTN_DPAD_*; F1 and F2 are the sticks pressed.
_OTHERS = {
    0x136: "L1",
    0x137: "R1",
    0x138: "L2",
    0x139: "R2",
    0x13A: "select",
    0x13B: "start",
    0x13D: "F1",
    0x13E: "F2",
    0x220: "up",
    0x221: "down",
    0x222: "left",
    0x223: "right",
}
# BTN_SOUTH, BTN_EAST, BTN_NORTH, BTN_WEST; xpad has X where others have what is above.
_FACES = {
    "xbox": {0x130: "A", 0x131: "B", 0x133: "X", 0x134: "Y"},
    "playstation": {0x130: "A", 0x131: "B", 0x134: "X", 0x133: "Y"},
    "nintendo": {0x130: "A", 0x131: "B", 0x134: "X", 0x133: "Y"},
    "8bitdo": {0x131: "A", 0x130: "B", 0x134: "X", 0x133: "Y"},
}
# BTN_TRIGGER … BTN_BASE6, in the order of Logitech's pads.
_GENERIC = dict(enumerate(("X", "A", "B", "Y", "L1", "R1", "L2", "R2"), 0x120)) | {
    0x128: "select",
    0x129: "start",
    0x12A: "F1",
    0x12B: "F2",
}
Mapped = Literal["auto", "xbox", "playstation", "nintendo", "8bitdo", "generic"]
"""Kinds of pads; `auto` goes by what the device is."""

# ABS_X, ABS_Y: element of `sticks` and sign; down is positive there.
_LEFT = {0x00: (0, 1.0), 0x01: (1, -1.0)}
# ABS_RX, ABS_RY; without these ABS_Z, ABS_RZ.
_RIGHT = {0x03: (2, 1.0), 0x04: (3, -1.0)}, {0x02: (2, 1.0), 0x05: (3, -1.0)}
# ABS_Z, ABS_RZ; where these are a stick ABS_BRAKE, ABS_GAS. Pressed from the middle on.
_TRIGGERS = {0x02: "L2", 0x05: "R2"}, {0x0A: "L2", 0x09: "R2"}
HATS = {0x10: ("left", "right"), 0x11: ("up", "down")}
"""ABS_HAT0X, ABS_HAT0Y."""

_VENDORS = {0x054C: "playstation", 0x057E: "nintendo", 0x2DC8: "8bitdo"}
# 8BitDo's that have A below, as an Xbox pad; the others have it to the right.
_ULTIMATE = (0x3012, 0x3015, 0x3016, 0x301B, 0x301D, 0x3100)


@dataclass(frozen=True)
class Identity:
    """What the kernel says of a device.

    Attributes:
        vendor: number of its maker.
        product: number of its kind.
        keys: bit for each of its keys.
        axes: bit for each of its axes.
    """

    vendor: int
    product: int
    keys: int
    axes: int

    @property
    def is_pad(self) -> bool:
        """It has a pad's or a joystick's first button, and a stick; no mouse, no touch pad."""
        return bool((self.keys >> 0x130 | self.keys >> 0x120) & 1 and self.axes & 1)


@dataclass(frozen=True)
class Pad:
    """The codes of one.

    Attributes:
        name: one of `Mapped`.
        keys: code to button.
        sticks: code to element of `sticks` and sign.
        triggers: code to button.
        ranges: code to least and largest value, where the device itself does not tell.
    """

    name: str
    keys: Mapping[int, str]
    sticks: Mapping[int, tuple[int, float]]
    triggers: Mapping[int, str]
    ranges: Mapping[int, tuple[int, int]]


def pad_of(identity: Identity | None, mapping: str = "auto") -> Pad:
    """Return the codes of a pad.

    Args:
        identity: what the kernel says; None for a pipe, which is as an Xbox pad unless `mapping`
            says otherwise.
        mapping: one of `Mapped`.
    """
    name = mapping if mapping != "auto" else _name(identity)
    keys = _GENERIC if name == "generic" else _FACES[name]
    plain = name in ("8bitdo", "generic")
    if identity is not None:
        plain = not identity.axes >> 0x03 & 1
    sticks, triggers = {**_LEFT, **_RIGHT[plain]}, _TRIGGERS[plain]
    wide = (-32768, 32767) if name in ("xbox", "nintendo") else (0, 255)
    ranges = dict.fromkeys(sticks, wide) | dict.fromkeys(triggers, (0, 255))
    return Pad(name, {**keys, **_OTHERS}, sticks, triggers, ranges)


def _name(identity: Identity | None) -> str:
    if identity is None:
        return "xbox"
    if not identity.keys >> 0x130 & 1:
        return "generic"
    name = _VENDORS.get(identity.vendor, "xbox")
    as_xbox = identity.product in _ULTIMATE or identity.axes >> 0x03 & 1  # by xpad
    return "xbox" if name == "8bitdo" and as_xbox else name


def ask(file: int) -> Identity | None:
    """Return what the kernel says of an open device (EVIOCGID, EVIOCGBIT); None for a pipe."""
    found = [asked(file, *each) for each in ((0x80084502, 8), (0x80604521, 96), (0x80084523, 8))]
    names, keys, axes = found
    if names is None or keys is None or axes is None:
        return None
    _, vendor, product, _ = struct.unpack("<4H", names)
    bits = int.from_bytes(keys, "little"), int.from_bytes(axes, "little")
    return Identity(vendor, product, *bits)


def asked(file: int, request: int, size: int) -> bytes | None:
    """Return what the kernel answers to a request of `size` bytes (ioctl(2)); None for a pipe."""
    try:
        return fcntl.ioctl(file, request, bytes(size))
    except OSError as error:
        if error.errno in (errno.ENOTTY, errno.EINVAL, errno.ENODEV):
            return None
        raise


class Finder:
    """Finds the first pad, by a cable or by Bluetooth; asks each device once, for it costs 15 us.

    Args:
        folder: where the devices are.
    """

    def __init__(self, folder: Path = INPUT) -> None:
        self._folder = folder
        self._others: set[str] = set()

    def find(self) -> str:
        """Return the file of a pad, empty if there is none."""
        by_id = self._folder / "by-id"
        found = sorted(by_id.glob("*-event-joystick")) if by_id.is_dir() else []
        if found:
            return str(found[0])
        try:
            names = {name for name in os.listdir(self._folder) if name.startswith("event")}
        except OSError:
            return ""
        self._others &= names
        for name in sorted(names - self._others, key=lambda name: (len(name), name)):
            path = self._folder / name
            with suppress(OSError):  # that may not be read (yet), or that has gone
                file = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
                try:
                    told = ask(file)
                finally:
                    os.close(file)
                if told is not None and told.is_pad:
                    return str(path)
                self._others.add(name)
        return ""

    def forget(self) -> None:
        """Ask all again: another device may have come by the same name."""
        self._others.clear()
