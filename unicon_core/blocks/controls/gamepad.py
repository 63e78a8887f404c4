"""Block `gamepad`: a game pad on Linux, read without waiting.

    commands: [gamepad, {drive: {speed: [1.0, 0.5, 1.0], hold: L1}}]

Which code is which button depends on the pad: pads.yaml. Events are `struct input_event` of a
device or of a pipe: two int64 of time, uint16 type and code, int32 value (Linux,
include/uapi/linux/input.h).

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
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from unicon_base import AnyDict, WorkflowError
from unicon_base.located_yaml import read_yaml
from unicon_core.blocks.controls.device import Controls, declares_controls, device_block
from unicon_core.bounds import BUTTONS
from unicon_core.flow import Block
from unicon_core.workflow.autowire import BuildContext

INPUT = Path("/dev/input")

Mapped = Literal["auto", "xbox", "playstation", "nintendo", "8bitdo", "generic"]
"""Kinds of pads; `auto` goes by what the device is."""

_CODES: AnyDict = read_yaml(Path(__file__).with_name("pads.yaml")).value
HATS: dict[int, tuple[str, str]] = _CODES["hats"]
"""ABS_HAT0X, ABS_HAT0Y."""


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
    plain = name in ("8bitdo", "generic")
    if identity is not None:
        plain = not identity.axes >> 0x03 & 1
    keys = _CODES["keys"][name] | _CODES["keys"]["every"]
    places, triggers = _CODES["left"] | _CODES["right"][plain], _CODES["triggers"][plain]
    sticks = {code: tuple(place) for code, place in places.items()}
    wide = (-32768, 32767) if name in ("xbox", "nintendo") else (0, 255)
    ranges = dict.fromkeys(sticks, wide) | dict.fromkeys(triggers, (0, 255))
    return Pad(name, keys, sticks, triggers, ranges)


def _name(identity: Identity | None) -> str:
    if identity is None:
        return "xbox"
    if not identity.keys >> 0x130 & 1:
        return "generic"
    name: str = _CODES["vendors"].get(identity.vendor, "xbox")
    as_xbox = identity.product in _CODES["ultimate"] or identity.axes >> 0x03 & 1  # by xpad
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


EVENT = struct.Struct("<qqHHi")
SYN = 0
KEY = 1
ABS = 3
DROPPED = 3
"""SYN_DROPPED: the kernel has thrown events away."""
MOST = 64
"""Events that are looked at in a tick."""
AGAIN = 1.0
"""Between two looks for a device that is not there, in [s]."""


def gamepad(*, context: BuildContext, device: str = "auto", mapping: Mapped = "auto") -> Block:
    """Write sticks and buttons of a game pad; all zero while it is not there.

    It is looked for once a second, so that it may come and go. Buttons are named by place, as on a
    Unitree remote: A below, B right, X left, Y above; F1 and F2 are the pressed sticks.

    Args:
        device: such as /dev/input/event5, or a pipe; auto takes the first joystick.
        mapping: xbox, playstation, nintendo, 8bitdo (with A to the right) or generic (Logitech's
            order); auto goes by what the device is.

    Raises:
        WorkflowError: the device is a file that is neither.
    """
    if device != "auto" and (Path(device).is_dir() or Path(device).is_file()):
        raise WorkflowError(
            f"device {device!r} is not an input device; give one such as /dev/input/event5, or auto"
        )
    return device_block(
        "gamepad", Gamepad(Controls(context.states), device, context, mapping), context
    )


setattr(gamepad, "declares", declares_controls)  # noqa: B010  a function has none to mypy


class Gamepad:
    """The tick of `gamepad`."""

    memory = ()

    def __init__(
        self, controls: Controls, device: str, context: BuildContext, mapping: str = "auto"
    ) -> None:
        self._controls = controls
        self._device = device
        self._context = context
        self._mapping = mapping
        self._finder = Finder()
        self._pad = pad_of(None, mapping)
        self._file = -1
        self._rest = b""
        self._look = 0.0
        self._told = ""
        self._ranges = dict(self._pad.ranges)

    def __call__(self) -> None:
        if self._file < 0 and not self._opened():
            return
        try:
            data = os.read(self._file, MOST * EVENT.size)
        except BlockingIOError:
            return
        except OSError as error:
            self._lost(error.strerror or str(error))
            return
        if not data:  # a pipe that nobody writes to
            self._lost("nobody writes to it") if self._controls.alive else None
            return
        self._controls.alive[...] = 1
        data = self._rest + data
        whole = len(data) - len(data) % EVENT.size
        self._rest = data[whole:]
        for _, _, kind, code, value in EVENT.iter_unpack(data[:whole]):
            self._take(kind, code, value)

    def _take(self, kind: int, code: int, value: int) -> None:
        controls = self._controls
        pad = self._pad
        if kind == KEY and code in pad.keys:
            controls.buttons[BUTTONS.index(pad.keys[code])] = int(value != 0)
        elif kind == ABS and code in pad.sticks:
            element, sign = pad.sticks[code]
            low, high = self._ranges[code]
            share = (2.0 * value - low - high) / (high - low)
            controls.sticks[element] = sign * min(max(share, -1.0), 1.0)
        elif kind == ABS and code in pad.triggers:
            low, high = self._ranges[code]
            controls.buttons[BUTTONS.index(pad.triggers[code])] = int(2 * value > low + high)
        elif kind == ABS and code in HATS:
            for name, sign in zip(HATS[code], (-1, 1)):
                controls.buttons[BUTTONS.index(name)] = int(value * sign > 0)
        elif kind == SYN and code == DROPPED:  # what is pressed is not known any more
            controls.let_go()
            controls.alive[...] = 1

    def _opened(self) -> bool:
        now = time.monotonic()
        if self._context.dry or now < self._look:
            return False
        self._look = now + AGAIN
        path = self._device if self._device != "auto" else self._finder.find()
        try:
            self._file = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
        except OSError as error:
            why = error.strerror if path else f"no joystick in {INPUT}; plug one in"
            self._tell(f"gamepad {path or 'auto'}: {why}; until it is there nothing is pressed")
            return False
        told = ask(self._file)
        self._pad = pad_of(told, self._mapping)
        self._ranges = {
            code: _range(self._file, code) or given for code, given in self._pad.ranges.items()
        }
        if told is not None:
            name = f"{told.vendor:04x}:{told.product:04x}"
            self._tell(f"gamepad {path}: {name}, buttons as of {self._pad.name}")
        return True

    def _lost(self, why: str) -> None:
        self._controls.let_go()
        self._rest = b""
        if why != "nobody writes to it":
            self.close()
            self._finder.forget()
        self._tell(f"gamepad {self._device}: {why}; all is let go until it comes back")

    def _tell(self, line: str) -> None:
        if line != self._told:  # once for each
            self._told = line
            self._context.tell(line)

    def reset(self) -> None:
        """Let go of what was pressed before."""
        self._controls.let_go()

    def close(self) -> None:
        """Let go of the device."""
        if self._file >= 0:
            with suppress(OSError):
                os.close(self._file)
        self._file = -1


def _range(file: int, code: int) -> tuple[int, int] | None:
    """Return the least and the largest value of an axis, as EVIOCGABS tells; None for a pipe."""
    # struct input_absinfo: value, minimum, maximum, fuzz, flat, resolution
    info = asked(file, 0x80184540 + code, 24)
    if info is None:
        return None
    _, low, high = struct.unpack_from("<3i", info)
    return (low, high) if high > low else None
