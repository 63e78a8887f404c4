"""Block `gamepad`: a game pad on Linux, read without waiting.

    commands: [gamepad, {drive: {speed: [1.0, 0.5, 1.0], hold: L1}}]

Events are `struct input_event` of a device or of a pipe: two int64 of time, uint16 type and code,
int32 value (Linux, include/uapi/linux/input.h and input-event-codes.h, which say the codes too).
"""

from __future__ import annotations

import errno
import fcntl
import os
import struct
import time
from contextlib import suppress
from pathlib import Path

from unicon_core.blocks.controls.device import Controls, declares_controls, device_block
from unicon_core.errors import WorkflowError
from unicon_core.flow import Block
from unicon_core.states.standard import BUTTONS
from unicon_core.workflow.autowire import BuildContext

__all__ = ["Gamepad", "gamepad"]

EVENT = struct.Struct("<qqHHi")
SYN, KEY, ABS = 0, 1, 3
DROPPED = 3
"""SYN_DROPPED: the kernel has thrown events away."""
MOST = 64
"""Events that are looked at in a tick."""
AGAIN = 1.0
"""Between two looks for a device that is not there, in [s]."""
FOLDER = Path("/dev/input/by-id")

KEYS = {
    0x130: "A",
    0x131: "B",
    0x133: "X",
    0x134: "Y",
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
"""BTN_SOUTH … BTN_THUMBR and BTN_DPAD_*; F1 and F2 are the sticks pressed."""
STICKS = {0x00: (0, 1.0), 0x01: (1, -1.0), 0x03: (2, 1.0), 0x04: (3, -1.0)}
"""ABS_X, ABS_Y, ABS_RX, ABS_RY: element of `sticks` and sign; down is positive there."""
TRIGGERS = {0x02: "L2", 0x05: "R2"}
"""ABS_Z, ABS_RZ: pressed from the middle on."""
HATS = {0x10: ("left", "right"), 0x11: ("up", "down")}
"""ABS_HAT0X, ABS_HAT0Y."""
RANGES = dict.fromkeys(STICKS, (-32768, 32767)) | dict.fromkeys(TRIGGERS, (0, 255))
"""Of an Xbox pad; a device tells its own."""


def gamepad(
    *,
    context: BuildContext,
    device: str = "auto",
) -> Block:
    """Write sticks and buttons of a game pad; all zero while it is not there.

    It is looked for once a second, so that it may come and go. Buttons are named as on a Unitree
    remote; F1 and F2 are the pressed sticks.

    Args:
        device: such as /dev/input/event5, or a pipe; auto takes the first joystick.

    Raises:
        WorkflowError: it is a file that is neither.
    """
    if device != "auto" and (Path(device).is_dir() or Path(device).is_file()):
        raise WorkflowError(
            f"device {device!r} is not an input device; give one such as /dev/input/event5, or auto"
        )
    return device_block("gamepad", Gamepad(Controls(context.states), device, context), context)


setattr(gamepad, "declares", declares_controls)  # noqa: B010  a function has none to mypy


class Gamepad:
    """The tick of `gamepad`."""

    def __init__(self, controls: Controls, device: str, context: BuildContext) -> None:
        self._controls, self._device, self._context = controls, device, context
        self._file = -1
        self._rest = b""
        self._look = 0.0
        self._told = ""
        self._ranges = dict(RANGES)

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
        if kind == KEY and code in KEYS:
            controls.buttons[BUTTONS.index(KEYS[code])] = int(value != 0)
        elif kind == ABS and code in STICKS:
            element, sign = STICKS[code]
            low, high = self._ranges[code]
            share = (2.0 * value - low - high) / (high - low)
            controls.sticks[element] = sign * min(max(share, -1.0), 1.0)
        elif kind == ABS and code in TRIGGERS:
            low, high = self._ranges[code]
            controls.buttons[BUTTONS.index(TRIGGERS[code])] = int(2 * value > low + high)
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
        path = self._device if self._device != "auto" else _first()
        try:
            self._file = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
        except OSError as error:
            why = error.strerror if path else f"no joystick in {FOLDER}; plug one in"
            self._tell(f"gamepad {path or 'auto'}: {why}; until it is there nothing is pressed")
            return False
        for code in RANGES:
            low, high = _range(self._file, code) or RANGES[code]
            self._ranges[code] = (low, high)
        return True

    def _lost(self, why: str) -> None:
        self._controls.let_go()
        self._rest = b""
        if why != "nobody writes to it":
            self.close()
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


def _first() -> str:
    found = sorted(FOLDER.glob("*-event-joystick")) if FOLDER.is_dir() else []
    return str(found[0]) if found else ""


def _range(file: int, code: int) -> tuple[int, int] | None:
    """Return the least and the largest value of an axis, as EVIOCGABS tells; None for a pipe."""
    info = bytearray(24)  # struct input_absinfo: value, minimum, maximum, fuzz, flat, resolution
    try:
        fcntl.ioctl(file, 0x80184540 + code, info)
    except OSError as error:
        if error.errno in (errno.ENOTTY, errno.EINVAL, errno.ENODEV):
            return None
        raise
    _, low, high = struct.unpack_from("<3i", info)
    return (low, high) if high > low else None
