"""HandWire: a hand behind Modbus registers, for all makers; which ones, says its robot file.

A thread of its own asks, since an exchange takes 0.3 ms over TCP and 5 ms over RTU; the tick takes
the newest answer and leaves the newest target, and waits for neither.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from unicon_base import PlatformError
from unicon_base.arrays import Float32, Float64, Int64
from unicon_core.states import States
from unicon_hardware.modbus.link import ModbusConnection, Refused
from unicon_hardware.wire import Counts, Speed, Wire

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
        return (raw - self.at_zero) / self.per_rad


RATE = 100.0
"""Exchanges a second: the vendors' examples ask so often."""
SLOW = 10
"""Every so many exchanges one of the slow blocks is read: temperatures and errors change slowly."""
OVER = 0.03
"""Velocity is the difference of two angles so far apart, [s]: a step of 1.7 mrad is 0.06 rad/s."""
AGAIN = 0.1
"""Between two attempts to connect anew, [s]."""
END = 1.0
"""How long the last target may take to leave when it closes, [s]."""
TRIES = 3
"""So often the last target is sent where it is not answered."""


class HandWire(Wire):
    """See the module; it is a `Wire` and `Prepared`.

    Args:
        states: of the hand.
        registers: of the hand.
        open_link: connects; an OSError means that it is not there.
        where: address or device, for messages.
        rate: of exchanges, at most, in [Hz]; more of them would take the tick's time.
        silent: it is only read; errors of before are told at once.
        first: asks the hand something once it is connected, or raises.

    Raises:
        PlatformError: it cannot be connected.
    """

    def __init__(
        self,
        states: States,
        registers: HandRegisters,
        open_link: Callable[[], ModbusConnection],
        where: str,
        *,
        silent: bool = False,
        first: Callable[[ModbusConnection], None] | None = None,
    ) -> None:
        self.counts, self.where = Counts(), where
        self._registers, self._open, self._silent = registers, open_link, silent
        self._pos, self._target = states["joint_pos"], states["joint_pos_target"]
        self._vel = states["joint_vel"]
        self._slow = {n: t for n, t in registers.slow.items() if n in states}
        self._views = {name: states[name] for name in self._slow}
        self._lock, self._news = threading.Lock(), threading.Event()
        self._turn = deque(self._slow.items())
        self._refused: deque[tuple[str, str]] = deque(maxlen=1000)
        self._came = self._exchanges = 0
        self._newest: tuple[int, Float64] | None = None
        self._told: dict[str, Int64] = {}
        self._speed = Speed(OVER)
        self._wanted: NDArray[np.uint16] | None = None
        self._ending = threading.Event()
        self._clear = "" if silent or registers.clear is None else "not asked"
        try:
            self._link: ModbusConnection | None = open_link()
            if first is not None:
                first(self._link)
        except (OSError, Refused) as error:
            self._let_go()
            raise PlatformError(
                f"cannot reach a hand at {where}: {getattr(error, 'strerror', None) or error}; "
                "switch it on, and check cable, address and port, and that no other program has it"
            ) from error
        except BaseException:
            self._let_go()
            raise
        self._thread = threading.Thread(target=self._run, name="hand", daemon=True)
        self._thread.start()

    # -- in the tick ------------------------------------------------------------------------------

    def take(self) -> int:
        """Bring the newest answers into the states; return how many have come."""
        while self._refused:
            self.counts.refuse(*self._refused.popleft())
        with self._lock:
            newest, came, told = self._newest, self._came, self._told
            self._newest, self._came, self._told = None, 0, {}
            self._news.clear()
        if newest is None:
            return 0
        stamp, angles = newest
        self._vel[...] = self._speed(stamp, angles)
        self._pos[...] = angles
        for name, values in told.items():
            # Errors of before the start are cleared by `prepare`, behind the gates.
            if name != "motor_error" or not self._clear:
                self._views[name][...] = values
        self.counts.good += came
        return came

    def put(self) -> None:
        """Leave the targets for the next exchange."""
        raw, clamped = self._registers.raw(self._target)
        self.counts.clamped += clamped
        with self._lock:
            if self._clear == "not asked":  # nobody prepares it: errors count from now on
                self._clear = ""
            self._wanted = raw

    def wait(self, timeout: float) -> bool:
        """Return True once an answer is there, False after `timeout` in [s]."""
        return self._news.wait(timeout)

    def prepare(self) -> str:
        """Let errors of before be cleared."""
        with self._lock:
            if self._clear == "not asked":
                self._clear = "asked"
            return "errors of before are being cleared" if self._clear else ""

    def close(self) -> None:
        """Let the last target leave, and let go."""
        self._ending.set()
        self._thread.join(END)

    # -- in the thread ----------------------------------------------------------------------------

    def _run(self) -> None:
        try:
            self._ask()
        finally:
            self._let_go()

    def _ask(self) -> None:
        left = TRIES
        while left:
            ending = self._ending.is_set()
            left -= ending
            due = time.monotonic() + 1.0 / RATE
            try:
                if self._link is None:
                    self._link = self._open()
                self._exchange(self._link, ending)
            except Refused as refused:
                self._refused.append((refused.reason, refused.detail))
            except OSError as error:
                self._refused.append(("connection lost", str(error)))
                self._let_go()
                self._ending.wait(AGAIN)
            if ending and self._wanted is None:
                return
            self._ending.wait(max(due - time.monotonic(), 0.0))

    def _exchange(self, link: ModbusConnection, ending: bool) -> None:
        registers, unit = self._registers, self._registers.unit
        with self._lock:
            wanted, self._wanted = self._wanted, None
            clearing = self._clear == "asked"
        if clearing and registers.clear is not None:
            start, value = registers.clear
            link.write(unit, start, np.array([value], np.uint16))
            with self._lock:
                self._clear, self._told = "", {}
        if wanted is not None and not self._silent:
            try:
                link.write(unit, registers.target, wanted)
            except (OSError, Refused):
                with self._lock:  # again with the next exchange, if there is no newer one
                    self._wanted = wanted if self._wanted is None else self._wanted
                raise
        if ending:
            return
        joints = len(registers.at_zero)
        answer = link.read(unit, registers.angle, joints)
        stamp, angles = time.monotonic_ns(), registers.angles(answer)
        told = {}
        if self._turn and self._exchanges % SLOW < len(self._turn):
            name, block = self._turn[0]
            self._turn.rotate(-1)
            slow = link.read(unit, block.start, block.count(joints))
            told[name] = block.values(slow, joints)
        self._exchanges += 1
        with self._lock:
            self._newest = stamp, angles
            self._told |= told
            self._came += 1
            self._news.set()

    def _let_go(self) -> None:
        link, self._link = getattr(self, "_link", None), None
        if link is not None:
            with suppress(OSError):
                link.close()
