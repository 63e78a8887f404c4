"""Platform `arx`: ARX arms of EC and DM motors on a CAN bus (X5), through python-can.

Motors answer to frames that are sent to them, and to nothing else: until the first command EC
motors get empty commands, without gains and torque, and DM motors the frame that enables them, as
the vendor's SDK does to read them. One tick asks, the next one takes.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from unicon_base import Fault, PlatformError, imported
from unicon_core.platforms.kit.command import Command
from unicon_core.platforms.platform import Facts
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_core.states.standard import COMMAND_STATES, JOINT_STATES
from unicon_hardware.arx.codec import (
    DM,
    EC,
    ENABLE,
    ENABLED,
    Motors,
    Packing,
    Reply,
    answer,
    command_of,
    reply_of,
)
from unicon_hardware.endpoint import EmulatedModes, Endpoint
from unicon_hardware.modes import UNDOCUMENTED, ModeGuard
from unicon_hardware.wire import Answers, Counts, Wire, known
from unicon_hardware.wired_robot import WiredRobot, opened

MOST = 256
"""Frames that are looked at in a tick: a flood must not hold it up. More than a bus of 1 Mbit/s
carries in 20 ms (180 of 111 bits), so that answers do not pile up behind others' frames."""
RECENT = 1.0
"""A stranger's command counts for so long, [s]."""
TORQUE = COMMAND_STATES.index("joint_effort_ff")


def import_can() -> Any:
    """Return python-can.

    Raises:
        MissingDependencyError: it is not installed.
    """
    return imported("can", "platform 'arx'", "hw-arx", "python-can")


def open_bus(channel: str, interface: str) -> Any:
    """Return a bus.

    Args:
        channel: such as can0.
        interface: of python-can, such as socketcan.

    Raises:
        MissingDependencyError: python-can is not installed.
        PlatformError: it cannot be opened.
    """
    can = import_can()
    try:
        return can.Bus(channel=channel, interface=interface)
    except (can.CanError, OSError, ValueError) as error:
        raise PlatformError(
            f"platform 'arx': cannot open CAN bus {channel!r} ({interface}): {error}; plug the "
            f"adapter in, then: sudo ip link set {channel} up type can bitrate 1000000"
        ) from error


class ArxWire(Wire):
    """See the module.

    Args:
        states: of the workflow.
        motors: of the arm.
        bus: of python-can, open; closed in `close`.
        rate: of asking, [Hz].

    Attributes:
        modes: of the motors; those of EC motors, which report none, are always 0.
    """

    modes: ModeGuard

    def __init__(self, states: States, motors: Motors, bus: Any, rate: float) -> None:
        self._can, self._bus, self._states, self._motors = import_can(), bus, states, motors
        self.counts, self._rate = Counts(), rate
        labels = map("{} (motor {})".format, motors.names, motors.numbers)
        self._answered = Answers(list(labels))
        damiao = [layout is DM for layout in motors.layouts]
        self._joints = {each: i for i, each in enumerate(zip(damiao, motors.numbers))}
        self._packing = Packing(motors)
        enabled = np.array(damiao) * ENABLED
        self.modes = ModeGuard("arx", motors.names, enabled, settles=UNDOCUMENTED)
        self._command = Command(states, motors.names, dtype=np.float32)
        self._packing(self._command.rows)
        empty = [frame.tobytes() for frame in self._packing.frames]
        self._asking = [ENABLE if each else frame for each, frame in zip(damiao, empty)]
        self._error = known(states, "motor_error")
        self._pending: list[Any] = []
        self._asked, self._commanding, self._foreign = -np.inf, False, -np.inf

    @property
    def where(self) -> str:
        """The motors that have not answered since all did last."""
        return f"{self._answered} on {self._bus.channel_info}"

    def take(self) -> int:
        """See `Wire`."""
        for _ in range(MOST):
            frame = self._pending.pop(0) if self._pending else self._next(0.0)
            if frame is None:
                break
            self._sort(frame)
        if not self._commanding and time.monotonic() - self._asked > 0.9 / self._rate:
            self._asked = time.monotonic()
            self._send(self._asking)
        complete = self._answered.complete()
        self.counts.good += complete
        return int(complete)

    def _next(self, timeout: float) -> Any:
        try:
            return self._bus.recv(timeout)
        except self._can.CanError as error:
            raise Fault(f"arx: CAN bus {self._bus.channel_info}: {error}") from error

    def _sort(self, frame: Any) -> None:
        number, data = frame.arbitration_id, bytes(frame.data)
        if frame.is_error_frame or frame.is_remote_frame or frame.is_extended_id:
            self.counts.refuse("not a data frame", f"number {number:#x}")
            return
        told = reply_of(number, data)
        joint = None if told is None else self._joints.get((number == 0, told.motor))
        if told is None or joint is None:
            if number in self._motors.numbers:
                self._foreign = time.monotonic()  # what is sent to a motor, and not by us
                self.counts.refuse("somebody else's command", f"to motor {number}")
            else:
                self.counts.refuse("not understood", f"number {number:#x}, {data.hex()}")
            return
        states = self._states
        states["joint_pos"][joint], states["joint_vel"][joint] = told.pos, told.vel
        states["joint_effort"][joint] = told.torque * self._motors.state[joint]
        if self._error is not None:
            self._error[joint] = told.error
        self.modes.reported[joint] = told.mode
        self._answered.heard[joint] = True

    def commanders(self) -> dict[str, int]:
        """See `Commanded`: others whose commands were seen on the bus within the last second."""
        return {str(self._bus.channel_info): int(time.monotonic() - self._foreign < RECENT)}

    def put(self) -> None:
        """See `Wire`."""
        self._command.take()
        self._command.rows[TORQUE] *= self._motors.command
        self.counts.clamped += not self._packing(self._command.rows)
        self._commanding = True
        self._send([frame.tobytes() for frame in self._packing.frames])

    def _send(self, frames: list[bytes]) -> None:
        """Give each motor a frame.

        Raises:
            Fault: the bus does not take one: unplugged, off, or nobody acknowledges. All others are
                tried: who damps has to reach the motors that can be reached.
        """
        fault: Fault | None = None
        for number, data in zip(self._motors.numbers, frames):
            message = self._can.Message(arbitration_id=number, data=data, is_extended_id=False)
            try:
                self._bus.send(message)
            except (self._can.CanError, OSError) as error:
                fault = fault or Fault(
                    f"arx: CAN bus {self._bus.channel_info} does not take a frame for motor "
                    f"{number}: {error}; is the arm switched on, and the adapter plugged in?"
                )
        if fault is not None:
            raise fault

    def wait(self, timeout: float) -> bool:
        """See `Wire`."""
        frame = self._next(timeout)
        if frame is not None:
            self._pending.append(frame)
        return frame is not None

    def close(self) -> None:
        """See `Wire`: motors keep the damping command; how to disable them is not known."""
        self._bus.shutdown()


SILENCE = 0.1
"""In [s]: 50 answers at the vendor's 500 Hz, 5 at a tick of 50 Hz."""


class Arx(WiredRobot):
    """See the module."""

    # No temperature: DM motors, half of an arm, do not tell theirs.
    facts = Facts("arx", writes=(*JOINT_STATES, "motor_error", "stamp_ns"), protocols=("arx",))


def make(
    states: States,
    robot: Robot,
    period: float,
    *,
    channel: str = "",
    interface: str = "socketcan",
    unverified: bool = False,
    connect: float = 5.0,
    silence: float = SILENCE,
) -> Arx:
    """Open the arm. It cannot be opened to receive only: its motors answer to commands.

    Args:
        states: of the workflow.
        robot: its file.
        period: of a tick in [s].
        channel: of the bus; the robot file's `interface`, such as can0.
        interface: of python-can.
        unverified: drive EC motors too, whose torque is doubtful.
        connect: how long to wait until all motors have answered, [s].
        silence: of any motor that is a fault, [s].

    Raises:
        MissingDependencyError: python-can is not installed.
        PlatformError: an option is wrong, the bus cannot be opened, or a motor does not answer.
        RobotError: the robot file lacks a fact.
    """
    motors = Motors.of(robot)
    if not unverified and EC in motors.layouts:
        raise PlatformError(
            "platform 'arx': EC motors were never driven by this, and what their torque is in N·m "
            "is doubtful, even in the vendor's SDK; write platforms: {arx: {unverified: true}} to "
            "drive them all the same, with the arm clear of people"
        )
    wire = ArxWire(states, motors, open_bus(channel or motors.channel, interface), motors.rate)
    return opened(Arx(states, robot, period, wire, silence=silence), connect)


EMPTY = 0.1
"""[N·m]: torques of 12 bits have no zero."""


class ArxEndpoint(Endpoint):
    """The arm's end of the bus; see `Face`.

    Args:
        states: of the emulator.
        robot: its file.
        channel: of the bus; the robot file's.
        interface: of python-can; `virtual` is seen in this process alone.

    Attributes:
        modes: of the motors.

    Raises:
        PlatformError: the bus cannot be opened.
        RobotError: the robot file lacks a fact.
    """

    def __init__(
        self, states: States, robot: Robot, *, channel: str = "", interface: str = "virtual"
    ) -> None:
        self._states, self._motors = states, Motors.of(robot)
        channel = channel or self._motors.channel
        self._bus = open_bus(channel, interface)
        self.rate, self.where = self._motors.rate, self._bus.channel_info
        if interface != "virtual":
            self.platform = "arx"
            self.reach = {"channel": channel, "interface": interface, "unverified": True}
        self._can = import_can()
        self._joints = {number: joint for joint, number in enumerate(self._motors.numbers)}
        self._on = np.array([ENABLED * (lay is DM) for lay in self._motors.layouts], np.uint8)
        self._entered = np.zeros_like(self._on)
        self.modes = EmulatedModes(np.zeros_like(self._on))
        self._asked: list[int] = []

    @property
    def obeys(self) -> bool:
        """Whether all motors are enabled."""
        return bool((self._entered == self._on).all())

    def hear(self) -> bool:
        """See `Face`; a command without gains and torque only asks."""
        heard = False
        for _ in range(MOST):
            frame = self._bus.recv(0.0)
            if frame is None:
                break
            joint = self._joints.get(frame.arbitration_id)
            if joint is None or frame.is_extended_id or len(frame.data) != 8:
                continue
            self._asked.append(joint)
            if bytes(frame.data) == ENABLE:
                self._entered[joint] = self._on[joint]
            elif self._entered[joint] == self._on[joint]:
                heard |= self._commanded(joint, bytes(frame.data))
        self.modes.command(self._entered, self._states)
        return heard

    def _commanded(self, joint: int, data: bytes) -> bool:
        pos, vel, torque, kp, kd = command_of(self._motors.layouts[joint], data)
        torque /= self._motors.command[joint]
        for name, figure in zip(COMMAND_STATES, (pos, vel, torque, kp, kd)):
            self._states[name][joint] = figure
        return kp > 0.0 or kd > 0.0 or abs(torque) > EMPTY

    def tell(self) -> None:
        """See `Face`: the answers to what was asked."""
        states, motors = self._states, self._motors
        for joint in self._asked:
            told = Reply(
                motors.numbers[joint],
                float(states["joint_pos"][joint]),
                float(states["joint_vel"][joint]),
                float(states["joint_effort"][joint] / motors.state[joint]),
                float(states["motor_temperature"][joint]),
                int(states["motor_error"][joint]),
                int(self.modes.reported[joint]),
            )
            number, data = answer(motors.numbers[joint], motors.layouts[joint], told)
            self._bus.send(
                self._can.Message(arbitration_id=number, data=data, is_extended_id=False)
            )
        self._asked.clear()

    def close(self) -> None:
        """See `Face`."""
        self._bus.shutdown()


face = ArxEndpoint
