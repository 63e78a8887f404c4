"""Frames of ARX's EC and DM motors on CAN, 8 bytes each; for their wire and their face.

Layouts compared frame by frame with what the vendor's libhardware.so sends and reads
(real-stanford/arx5-sdk lib/x86_64); its ranges stand in include/hardware/arx_can.h. A figure of b
bits is the integer part of (x - lower) (2^b - 1) / (upper - lower).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, NamedTuple

import numpy as np

from unicon_base.arrays import Array, Float64
from unicon_base.schema.marks import Key, Text
from unicon_core.robots import Robot
from unicon_hardware.facts import AskingRate, Transport, each, each_text, fact, facts_of, wrong_fact

ENABLE = bytes(7 * [0xFF]) + b"\xfc"
"""Lets a DM motor take commands; it answers with its state."""
ENABLED = 1
"""What a DM motor that takes commands reports; 0 is disabled, from 5 on it is an error that has
switched it off (jia-xie/python-damiao-driver docs, edometro/DAMIAO_Control_Arduino src/DMMotor.h).
Whether those that ARX builds in do the same is not public."""
REPLY = 0b001
"""Kind of an EC motor's answer to a command: the highest three bits of its first byte."""

POSITION, KP, KD = 12.5, 500.0, 5.0


class Layout(NamedTuple):
    """Of a kind of motor: ranges of a command's figures, their bits, and their order.

    Figures are q*, qd*, tau, kp, kd, as of `COMMAND_STATES`; a range is symmetric but for gains.
    """

    velocity: float
    torque: float
    kd_bits: int
    order: tuple[int, ...]


EC = Layout(18.0, 30.0, 9, (3, 4, 0, 1, 2))
DM = Layout(45.0, 18.0, 12, (0, 1, 3, 4, 2))
LAYOUTS = {"EC": EC, "DM": DM}


class Reply(NamedTuple):
    """What a motor tells.

    Attributes:
        motor: its number.
        pos: in [rad].
        vel: in [rad/s].
        torque: in the motor's own measure.
        temperature: in [°C]; None where its kind does not tell.
        error: code, 0 for none or where its kind does not tell.
        mode: `ENABLED` and others of a DM motor; 0 where its kind does not tell.
    """

    motor: int
    pos: float
    vel: float
    torque: float
    temperature: float | None
    error: int
    mode: int = 0


def _bounds(layout: Layout) -> tuple[tuple[float, ...], tuple[float, ...], tuple[int, ...]]:
    upper = (POSITION, layout.velocity, layout.torque, KP, KD)
    lower = (-POSITION, -layout.velocity, -layout.torque, 0.0, 0.0)
    return lower, upper, (16, 12, 12, 12, layout.kd_bits)


def _figures(layout: Layout, raw: Sequence[int]) -> tuple[float, ...]:
    """Return the first figures, as of `COMMAND_STATES`, of whole numbers on the bus."""
    return tuple(
        lower + number * (upper - lower) / (2**bits - 1)
        for number, lower, upper, bits in zip(raw, *_bounds(layout))
    )


@dataclass(frozen=True)
class Motors(Transport):
    """What the robot file says of the motors; arrays of shape (n,).

    Attributes:
        names: of the joints.
        numbers: on the bus.
        types: of the motors.
        channel: of the bus.
        rate: of asking, [Hz].
        command: the motor's measure for 1 N·m that is commanded.
        state: N·m for one of the motor's measure that is told.
    """

    names: tuple[str, ...]
    numbers: tuple[int, ...]
    types: Annotated[list[str], Key("motor_type"), each_text]
    channel: Annotated[Text, Key("interface")]
    rate: AskingRate
    command: Annotated[Float64, Key("torque_command"), each(1e-6, 1e6)]
    state: Annotated[Float64, Key("torque_state"), each(1e-6, 1e6)]

    @classmethod
    def of(cls, robot: Robot) -> Motors:
        """Return those of a robot file.

        Raises:
            RobotError: a fact is missing or wrong.
        """
        told = fact(robot, "motor_id", Annotated[Float64, each(1.0, 15.0)])
        numbers = tuple(map(int, told))
        if (told % 1.0).any() or len(set(numbers)) < len(numbers):
            raise wrong_fact(robot, "motor_id", "a whole number of its own for each motor")
        found = facts_of(cls, robot, names=robot.joint_names, numbers=numbers)
        if not LAYOUTS.keys() >= {*map(_kind, found.types)}:
            wanted = f"texts that begin with {'_ or '.join(LAYOUTS)}_"
            raise wrong_fact(robot, "motor_type", wanted)
        return found

    @cached_property
    def layouts(self) -> tuple[Layout, ...]:
        """Of their frames."""
        return tuple(LAYOUTS[_kind(each)] for each in self.types)


def _kind(motor_type: str) -> str:
    return motor_type.partition("_")[0]


class Packing:
    """Packs commands of all motors at once.

    Args:
        motors: in the order of joints.

    Attributes:
        frames: of each motor, shape (n, 8), uint8.
    """

    def __init__(self, motors: Motors) -> None:
        lower, upper, bits = (np.array(each).T for each in zip(*map(_bounds, motors.layouts)))
        # In float32 and in the order below, as the vendor's: equal to the last bit.
        self._lower, self._upper = np.float32(lower), np.float32(upper)
        self._most, self._span = np.float32(2.0**bits - 1.0), self._upper - self._lower
        n = len(motors.numbers)
        order = np.array([layout.order for layout in motors.layouts]).T
        self._order, self._columns = order, np.arange(n)
        widths = bits[order, self._columns]
        # A frame is a number of 64 bits, highest first; the last figure ends at bit 0.
        shifts = np.cumsum(widths[::-1], axis=0)[::-1] - widths
        self._shifts = shifts.astype(np.uint64)
        self._words = np.zeros(n, ">u8")
        self.frames = self._words.view(np.uint8).reshape(n, 8)

    def __call__(self, rows: Array) -> bool:
        """Pack rows as of `COMMAND_STATES`, shape (5, n); False where a figure was clamped."""
        rows = rows.astype(np.float32, copy=False)
        clipped = np.clip(rows, self._lower, self._upper)
        whole = ((clipped - self._lower) * self._most / self._span).astype(np.uint64)
        parts = whole[self._order, self._columns] << self._shifts
        self._words[...] = np.bitwise_or.reduce(parts, axis=0)
        return bool((clipped == rows).all())


def reply_of(number: int, data: bytes) -> Reply | None:
    """Return what a frame tells; None where it is not a motor's answer.

    Args:
        number: of the frame on the bus: an EC motor's own; 0 for all DM motors.
        data: of the frame.
    """
    if len(data) != 8:
        return None
    if number == 0:
        layout, motor, temperature, error, mode = DM, data[0] & 0x0F, None, 0, data[0] >> 4
    elif data[0] >> 5 == REPLY:
        layout, motor, error, mode = EC, number, data[0] & 0x1F, 0
        temperature = 0.5 * (data[6] - 50)
    else:
        return None
    raw = data[1] << 8 | data[2], data[3] << 4 | data[4] >> 4, (data[4] & 0x0F) << 8 | data[5]
    pos, vel, torque = _figures(layout, raw)
    return Reply(motor, pos, vel, torque, temperature, error, mode)


def answer(motor: int, layout: Layout, told: Reply) -> tuple[int, bytes]:
    """Return number and data of the frame that a motor answers with; for its emulation."""
    figures = zip((told.pos, told.vel, told.torque), *_bounds(layout))
    pos, vel, torque = (
        int((min(max(value, lower), upper) - lower) * (2**bits - 1) / (upper - lower))
        for value, lower, upper, bits in figures
    )
    head = told.mode << 4 | motor if layout is DM else REPLY << 5 | told.error & 0x1F
    warm = 0 if told.temperature is None else min(max(int(2 * told.temperature + 50), 0), 255)
    word = head << 56 | pos << 40 | vel << 28 | torque << 16 | warm << 8
    return (0 if layout is DM else motor), word.to_bytes(8, "big")


def command_of(layout: Layout, data: bytes) -> tuple[float, ...]:
    """Return the figures of a command, as of `COMMAND_STATES`; for emulated motors."""
    word, raw, bits = int.from_bytes(data, "big"), [0] * 5, _bounds(layout)[2]
    for figure in reversed(layout.order):
        raw[figure] = word & (1 << bits[figure]) - 1
        word >>= bits[figure]
    return _figures(layout, raw)
