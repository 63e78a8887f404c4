"""LeggedWire: the datagrams of an A1, Aliengo or Go1 in both directions, for `WiredRobot`.

The robot sends nothing by itself: it answers each command to its sender. So something is sent from
the first moment on: the vendor's own initial command, in which every motor is in servo mode without
position, velocity, gains or torque.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np

from unicon_base import Fault, PlatformError, StateError
from unicon_base.arrays import Float32
from unicon_core.blocks.controls.device import Controls
from unicon_core.blocks.controls.device import unitree as held
from unicon_core.platforms.kit.base import IMU_STATES, Mounting
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_core.states.standard import COMMAND_STATES
from unicon_hardware.modes import ModeGuard
from unicon_hardware.robot_clock import Repeats
from unicon_hardware.unitree_legged.codec import (
    CELL_VOLT,
    LAYOUTS,
    NAME,
    TORQUE,
    CommandFrame,
    Frame,
    LeggedTransport,
)
from unicon_hardware.wire import Counts, Udp, Wire, known, newer


class Repeater(threading.Thread):
    """A thread that repeats what was sent last, until `close`; it computes nothing.

    Args:
        send: takes a datagram.
        rate: of datagrams in [Hz].
        watchdog: so long after the last `put` it sends `damping` instead, [s].
        idle: what is sent before the first `put`; nobody has to renew it.
        damping: see `watchdog`.
    """

    def __init__(
        self,
        send: Callable[[bytes], object],
        rate: float,
        watchdog: float,
        idle: bytes,
        damping: bytes,
    ) -> None:
        super().__init__(name="unitree_legged repeater", daemon=True)
        self._send, self._interval, self._watchdog = send, 1.0 / rate, watchdog
        self._frame, self._damping = idle, damping
        self._put = 0.0
        self._ended = threading.Event()
        self._late = False

    @property
    def late(self) -> bool:
        """Whether a command did not come in time: the robot is damped from then on, for good."""
        # The tick looks too: in a process that was stopped it may go on before this thread does.
        put = self._put
        self._late |= put > 0.0 and time.monotonic() - put > self._watchdog
        return self._late

    def put(self, frame: bytes) -> None:
        """Send a datagram now, and again until the next one.

        Raises:
            Fault: it cannot be sent.
        """
        self._frame = frame
        self._put = time.monotonic()
        self._send(frame)

    def run(self) -> None:
        """Send until closed."""
        interval, due = self._interval, time.monotonic()
        while not self._ended.wait(max(0.0, due - time.monotonic())):
            now, put, late = time.monotonic(), self._put, self.late
            # Half an interval of grace: a tick at this rate sends by itself.
            if now < put + 1.5 * interval and not late:
                due = put + 1.5 * interval
                continue
            with suppress(Fault):  # the tick is told the same by its own sending
                self._send(self._damping if late else self._frame)
            due = max(due + interval, now)

    def close(self) -> None:
        """End."""
        self._ended.set()
        if self.is_alive():
            self.join()


FOOT_FORCE = "foot_force"
"""A state of shape (4,) that a workflow may declare: what the feet's sensors tell, in units of
theirs, in the order of the robot's legs."""

_NM = np.float32(1.0 / TORQUE)
# Fields of a datagram, in the order of `IMU_STATES`.
_IMU = ("quat", "gyro", "acc")
_COMMAND_BYTES = {state: command for command, state in LAYOUTS}


class StateReader:
    """One datagram at a time: `good` checks it, and `tell` brings it into the states.

    Args:
        states: of the workflow.
        robot: its file.
        link: to the robot.
        counts: of what is refused.
        encrypted: the checksum of a Go1 that is not an EDU is right too.

    Attributes:
        modes: of the robot's motors in the datagram that was told last, shape (n,).
        newest: its tick in the last good datagram, [ms].
        measured: the bytes of a datagram in which it measures, of so many.
        length: so many.

    Raises:
        StateError: `foot_force` is not of four.
    """

    def __init__(
        self, states: States, robot: Robot, link: LeggedTransport, counts: Counts, encrypted: bool
    ) -> None:
        frame = self._frame = Frame(link.layout.state)
        motors, count = frame["motors"][link.motors], robot.num_joints
        self._link, self._counts, self._encrypted = link, counts, encrypted
        self._level, self._tick, self._remote = frame["level"], frame["tick"], frame["remote"]
        at: Any = link.layout.state.fields
        self.measured, self.length = slice(at["quat"][1], at["tick"][1]), len(frame.buffer)
        self._modes, self.modes = motors["mode"], np.zeros(count, np.uint8)
        self.newest: int | None = None
        # What must be finite, side by side: one check for all.
        self._floats = np.zeros(2 * count + 10, np.float32)
        pos, vel, *imu = np.split(self._floats, np.cumsum((count, count, 4, 3)))
        fields = (motors["q"], motors["dq"], *(frame[field] for field in _IMU))
        self._reads = list(zip((pos, vel, *imu), fields))
        self._labels = [
            *(f"{of} of {joint}" for of in ("position", "velocity") for joint in robot.joint_names),
            *(f"{field}[{i}]" for field in _IMU for i in range(frame[field].size)),
        ]
        if FOOT_FORCE in states and states[FOOT_FORCE].shape != (4,):
            raise StateError(
                f"state {FOOT_FORCE!r} has shape {list(states[FOOT_FORCE].shape)}, and "
                f"platform {NAME!r} writes four; declare {FOOT_FORCE}: {{shape: [4]}}"
            )
        told = {
            "joint_pos": pos,
            "joint_vel": vel,
            "motor_temperature": motors["temperature"],
            FOOT_FORCE: frame["foot_force"],
        }
        self._copies = [(states[name], source) for name, source in told.items() if name in states]
        self._effort, self._torque = states["joint_effort"], motors["tau"]
        self._mounting, self._imu = Mounting.of(robot), dict(zip(IMU_STATES, imu, strict=True))
        self._base = {name: states[name] for name in IMU_STATES}
        self._errors, self._errors_of = known(states, "motor_error"), b""
        self._battery: list[Float32] = []
        if "bms" in frame and "battery_charge" in states:
            self._battery = [states["battery_charge"], states["battery_voltage"]]

    def good(self, datagram: bytes) -> bool:
        """Return whether it is good and new; it is counted where it is not."""
        frame, link, refuse = self._frame, self._link, self._counts.refuse
        if len(datagram) != self.length:
            what = f"{len(datagram)} bytes instead of {self.length}"
            if other := _COMMAND_BYTES.get(len(datagram)):
                what += f": a robot that takes {other} bytes, of another generation"
            refuse("wrong length", what)
            return False
        frame.fill(datagram)
        if not frame.sound(self._encrypted):
            refuse("wrong CRC", f"{int(frame['crc']):08x}")
            return False
        level = int(self._level)
        if not datagram.startswith(link.layout.head) or level != link.level_flag:
            refuse("wrong head", f"{datagram[:3].hex()}, of level {level:#x}")
            return False
        tick, newest = int(self._tick), self.newest
        if newest is not None and not newer(tick, newest):  # in 49 days they begin anew
            why = "tick that stands still" if tick == newest else "older than the one before"
            refuse(why, f"tick {tick} behind {newest}")
            return False
        for part, field in self._reads:
            part[...] = field
        finite = np.isfinite(self._floats)
        if not finite.all():
            wrong = int(np.argmin(finite))
            refuse("not finite", f"{self._labels[wrong]} is {self._floats[wrong]}")
            return False
        self.newest = tick
        return True

    def tell(self, remote: bytearray) -> None:
        """Bring the datagram that was good into the states, and its remote's 40 bytes."""
        for view, source in self._copies:
            view[...] = source
        self._mounting.turn(self._imu, self._base)
        np.multiply(self._torque, _NM, out=self._effort)
        remote[:] = self._remote.data
        self.modes[...] = self._modes
        modes = self.modes.tobytes()
        if modes != self._errors_of:
            self._errors_of, link = modes, self._link
            fine = (self.modes == link.servo) | (self.modes == link.damping)
            if self._errors is not None:
                self._errors[...] = np.where(fine, 0, self.modes)
        if self._battery:
            bms = self._frame["bms"]
            charge, voltage = self._battery
            charge[...] = bms["soc"] / 100.0
            voltage[...] = bms["cells"].sum() * CELL_VOLT


HELD = 3.0
"""A motor that tells as much obeys somebody else, while our commands ask for nothing, [N·m]."""
LATELY = 2.0
"""For so long it counts, [s]: of two who send as often, one may be heard last for a while."""


class LeggedWire(Wire):
    """A socket, what was understood last, and a thread that repeats commands.

    Args:
        states: of the workflow.
        robot: its file.
        link: to the robot.
        watchdog: a tick that is later damps the robot, [s].
        encrypted: with the checksum of a Go1 that is not an EDU.
        check_mode: commands begin once every motor reports servo mode, and one that leaves it is a
            fault.

    Attributes:
        link: as given.
        counts: of what came in.
        where: the robot's address and port, and from where they are reached.
        remote: the 40 bytes of the wireless remote, as they came last.
        modes: of the motors; None where they are not to be looked at.

    Raises:
        PlatformError: the port is taken, or there is no way to the robot.
        StateError: `foot_force` is not of four.
    """

    def __init__(
        self,
        states: States,
        robot: Robot,
        link: LeggedTransport,
        watchdog: float,
        *,
        encrypted: bool = False,
        check_mode: bool = True,
    ) -> None:
        self.counts, self.where = Counts(), f"{link.address}:{link.port}"
        self.remote = bytearray(40)
        self._controls = Controls(states) if "sticks" in states else None
        self._reader = StateReader(states, robot, link, self.counts, encrypted)
        self._repeats = Repeats(f"platform {NAME!r}", self._reader.measured)
        self.link = link
        if check_mode:
            names, called = robot.joint_names, "servo mode"
            self.modes = ModeGuard(f"platform {NAME!r}", names, link.servo, called=called)
            self.modes.reported = self._reader.modes
        self._commands = [states[name] for name in COMMAND_STATES]
        self._nothing = np.zeros(robot.num_joints, np.float32)
        self._out = CommandFrame(link, encrypted)
        idle, zero = bytes(self._out.buffer), self._nothing
        limp = self._out.write(zero, zero, zero, zero, np.nan_to_num(robot.joint_damping))
        self._watchdog, self._damped = watchdog, False
        self._effort, self._asks, self._held = states["joint_effort"], True, -math.inf
        local, peer = ("0.0.0.0", link.local_port), (link.address, link.port)
        self._udp = Udp(local, peer, f"platform {NAME!r}")
        try:
            source = self._udp.source
        except PlatformError:
            self._udp.close()
            raise
        if source != link.address:  # another network's shows a wrong interface
            self.where += f" (from {source})"
        self._repeater = Repeater(self._udp.send, link.rate, watchdog, idle, limp)
        self._repeater.start()

    def take(self) -> int:
        """Bring the newest good datagram into the states; return 1 where one has come, else 0.

        Those before it are counted with it, and not looked at: at 50 Hz there are ten in a tick,
        and each check takes 15 µs.
        """
        datagrams = self._udp.received()
        for datagram in datagrams:
            if len(datagram) == self._reader.length:
                self._repeats(datagram)
        while datagrams:
            if self._reader.good(datagrams[-1]):
                self._reader.tell(self.remote)
                if self._controls is not None:
                    held(self.remote, self._controls)
                if self._asks and np.abs(self._effort).max() >= HELD:
                    self._held = time.monotonic()
                self.counts.good += len(datagrams)
                return 1
            datagrams.pop()
        return 0

    @property
    def clock_ms(self) -> int | None:
        """The robot's tick."""
        return self._reader.newest

    def put(self) -> None:
        """Send the command states, and again until the next ones come.

        Raises:
            Fault: it cannot be sent; or the one before was too long ago, and the robot is limp by
                now. A stiff command would let its joints jump: from then on only limp ones leave.
        """
        self._asks = False
        pos, vel, effort, stiffness, damping = self._commands
        late = self._damped or self._repeater.late
        if late:
            effort = stiffness = self._nothing
        self._repeater.put(self._out.write(pos, vel, effort, stiffness, damping))
        self.counts.clamped = self._out.clamped
        if late and not self._damped:
            self._damped = True
            raise Fault(
                f"platform {NAME!r}: no command came for {self._watchdog:g} s, the robot was "
                "damped (watchdog)"
            )

    def prepare(self) -> str:
        """Return what a person has to do so that the motors take commands, "" once they do."""
        wrong = "" if self.modes is None else self.modes.other()
        return f"{wrong}; {self.link.preparation}" if wrong else ""

    def commanders(self) -> dict[str, int]:
        """Return where the robot takes commands, and 1 where somebody else seems to command it.

        Others cannot be seen on the wire; but until the first command ours ask for no torque, and
        motors that tell some have it of another program, or of the robot's own controller.
        """
        return {self.where: int(time.monotonic() - self._held < LATELY)}

    def wait(self, timeout: float) -> bool:
        """Return True once a datagram is there, False after `timeout` in [s]."""
        return self._udp.wait(timeout)

    def close(self) -> None:
        """End the thread and close the socket."""
        self._repeater.close()
        self._udp.close()

    @property
    def strangers(self) -> int:
        """Datagrams so far that were another sender's."""
        return self._udp.strangers
