"""What the registers of a hand mean: numbers to angles and back, by facts of its robot file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from unicon_base.arrays import Float32, Float64, Int64
from unicon_hardware.modbus.link import Refused

BEYOND = 0.1
"""A measured angle that is further outside the range, as a share of it, is not a measurement."""


@dataclass(frozen=True)
class Told:
    """A block of registers that tells a state of each joint.

    Attributes:
        start: first register.
        bytes: two joints in each register, the first in the high byte; else one in each.
    """

    start: int
    bytes: bool = False

    def count(self, joints: int) -> int:
        """Return the number of registers."""
        return -(-joints // 2) if self.bytes else joints

    def values(self, registers: NDArray[np.uint16], joints: int) -> Int64:
        """Return the value of each joint, shape (n,)."""
        if self.bytes:
            raw = np.frombuffer(registers.astype(">u2").tobytes(), np.uint8)
            return raw[:joints].astype(np.int64)
        return registers.astype(np.int64)

    def registers(self, values: Int64) -> NDArray[np.uint16]:
        """Return the registers that tell these values; the other way round."""
        if self.bytes:
            raw = np.zeros(2 * self.count(len(values)), np.uint8)
            raw[: len(values)] = values
            return np.frombuffer(raw.tobytes(), ">u2").astype(np.uint16)
        return values.astype(np.uint16)


@dataclass(frozen=True)
class HandRegisters:
    """Where a hand keeps what, and what its numbers mean.

    Attributes:
        unit: number of the device on the line.
        target, angle: first register of the angles that are wanted and measured, int16.
        at_zero, per_rad: register = at_zero + per_rad · angle, for each joint, shape (n,).
        lowest, highest: smallest and largest number of the target's registers, shape (n,).
        slow: state to the block that tells it.
        clear: register and value that clear errors, or None.
    """

    unit: int
    target: int
    angle: int
    at_zero: Float64
    per_rad: Float64
    lowest: Int64
    highest: Int64
    slow: Mapping[str, Told] = field(default_factory=dict)
    clear: tuple[int, int] | None = None

    def raw(self, angles: Float32) -> tuple[NDArray[np.uint16], bool]:
        """Return the registers of angles [rad], shape (n,), and whether one was clamped."""
        wanted = np.rint(self.at_zero + self.per_rad * angles)
        held = np.clip(wanted, self.lowest, self.highest)
        clamped = bool((np.abs(held - wanted) > 1.0).any())
        return held.astype(np.int16).view(np.uint16), clamped

    def angles(self, registers: NDArray[np.uint16]) -> Float64:
        """Return the angles of registers in [rad], shape (n,).

        Raises:
            Refused: a number is far outside the range.
        """
        raw = registers.view(np.int16).astype(np.float64)
        room = BEYOND * (self.highest - self.lowest)
        wrong = (raw < self.lowest - room) | (raw > self.highest + room)
        if wrong.any():
            joint = int(np.argmax(wrong))
            raise Refused("angle out of range", f"{raw[joint]:g} of joint {joint}")
        angles: Float64 = (raw - self.at_zero) / self.per_rad
        return angles
