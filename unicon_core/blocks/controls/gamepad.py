"""Block `gamepad`: a game pad on Linux, read without waiting.

    commands: [gamepad, {drive: {speed: [1.0, 0.5, 1.0], hold: L1}}]

Which code is which button depends on the pad, see `pads`. Events are `struct input_event` of a
device or of a pipe: two int64 of time, uint16 type and code, int32 value (Linux,
include/uapi/linux/input.h and input-event-codes.h, which say the codes too).
"""

from __future__ import annotations

import os
import struct
import time
from contextlib import suppress
from pathlib import Path

from unicon_base.errors import WorkflowError
from unicon_core.blocks.controls.device import Controls, declares_controls, device_block
from unicon_core.blocks.controls.pads import HATS, INPUT, Finder, Mapped, ask, asked, pad_of
from unicon_core.bounds import BUTTONS
from unicon_core.flow import Block
from unicon_core.workflow.autowire import BuildContext

EVENT = struct.Struct("<qqHHi")
SYN, KEY, ABS = 0, 1, 3
DROPPED = 3
"""SYN_DROPPED: the kernel has thrown events away."""
MOST = 64
"""Events that are looked at in a tick."""
AGAIN = 1.0
"""Between two looks for a device that is not there, in [s]."""


def gamepad(
    *,
    context: BuildContext,
    device: str = "auto",
    mapping: Mapped = "auto",
) -> Block:
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
        self._controls, self._device, self._context = controls, device, context
        self._mapping, self._finder = mapping, Finder()
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
        controls, pad = self._controls, self._pad
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
