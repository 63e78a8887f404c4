"""LeggedWire: the datagrams of an A1, Aliengo or Go1 in both directions, for `WiredRobot`.

The robot sends nothing by itself: it answers each command to its sender. So something is sent from
the first moment on: the vendor's own initial command, in which every motor is in servo mode without
position, velocity, gains or torque.
"""

from __future__ import annotations

import numpy as np

from unicon_core.errors import Fault, StateError
from unicon_core.platforms.kit.base import Mounting
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_core.states.standard import COMMAND_STATES
from unicon_ros.hardware.udp import Udp
from unicon_ros.hardware.unitree_legged.codec import (
    CELL_VOLT,
    LAYOUTS,
    TORQUE,
    CommandFrame,
    Frame,
)
from unicon_ros.hardware.unitree_legged.link import NAME, Link
from unicon_ros.hardware.unitree_legged.repeater import Repeater
from unicon_ros.hardware.wire import Counts

__all__ = ["FOOT_FORCE", "LeggedWire"]

FOOT_FORCE = "foot_force"
"""A state of shape (4,) that a workflow may declare: what the feet's sensors tell, in units of
theirs, in the order of the robot's legs."""

_FLOATS = ("quat", "gyro", "acc")
_NUMBERS = {layout.state.itemsize: lengths for lengths, layout in LAYOUTS.items()}


class LeggedWire:
    """A socket, what was understood last, and a thread that repeats commands.

    Args:
        states: of the workflow.
        robot: its file.
        link: to the robot.
        watchdog: a tick that is later damps the robot, [s].
        encrypted: with the checksum of a Go1 that is not an EDU.
        check_mode: commands begin once every motor tells that it is in servo mode.

    Attributes:
        counts: of what came in.
        where: the robot's address and port.
        remote: the 40 bytes of the wireless remote, as they came last.
        tells_battery: the robot's datagrams have a battery in them.

    Raises:
        PlatformError: the port is taken.
        StateError: `foot_force` is not of four.
    """

    def __init__(
        self,
        states: States,
        robot: Robot,
        link: Link,
        watchdog: float,
        *,
        encrypted: bool = False,
        check_mode: bool = True,
    ) -> None:
        self.counts, self.where = Counts(), f"{link.address}:{link.port}"
        self.remote = bytearray(40)
        self._link, self._encrypted, self._check_mode = link, encrypted, check_mode
        self._names = robot.joint_names
        frame = self._state = Frame(link.layout.state)
        self._motors = frame["motors"][link.motors]
        self._level, self._tick_now = frame["level"], frame["tick"]
        self._tick: int | None = None
        count = robot.num_joints
        # Positions, velocities, orientation, gyroscope, accelerometer: what must be finite.
        self._read = np.zeros(2 * count + 10, np.float32)
        parts = np.split(self._read, np.cumsum((count, count, 4, 3)))
        fields = (self._motors["q"], self._motors["dq"], *(frame[name] for name in _FLOATS))
        self._reads = list(zip(parts, fields))
        self._mounting = Mounting.of(robot)
        self._views = {name: states[name] for name in states}
        self._parts = dict(zip(("joint_pos", "joint_vel", *_FLOATS), parts))
        self.tells_battery = "bms" in frame
        if FOOT_FORCE in states and states[FOOT_FORCE].shape != (4,):
            raise StateError(
                f"state {FOOT_FORCE!r} has shape {list(states[FOOT_FORCE].shape)}, and "
                f"platform {NAME!r} writes four; declare {FOOT_FORCE}: {{shape: [4]}}"
            )
        self._commands = [states[name] for name in COMMAND_STATES]
        self._out = CommandFrame(
            link.layout,
            link.motors,
            link.level_flag,
            link.servo,
            link.pos_stop,
            link.vel_stop,
            encrypted,
        )
        idle = bytes(self._out.buffer)
        nothing = np.zeros(count, np.float32)
        limp = self._out.write(
            nothing, nothing, nothing, nothing, np.nan_to_num(robot.joint_damping)
        )
        self._late = False
        self._udp = Udp(
            ("0.0.0.0", link.local_port), (link.address, link.port), f"platform {NAME!r}"
        )
        self._repeater = Repeater(self._udp.send, link.rate, watchdog, idle, limp)
        self._watchdog = watchdog
        self._repeater.start()

    # -- in ---------------------------------------------------------------------------------------

    def take(self) -> int:
        """Bring the newest good datagram into the states; return how many good ones have come."""
        good, newest = 0, b""
        for datagram in self._udp.received():
            if self._good(datagram):
                good, newest = good + 1, datagram
        if good:
            if self._state.buffer != newest:  # a bad one has come behind it
                self._state.fill(newest)
                self._copy_floats()
            self._tell()
            self.counts.good += good
        return good

    def _good(self, datagram: bytes) -> bool:
        frame, link, refuse = self._state, self._link, self.counts.refuse
        wanted = len(frame.buffer)
        if len(datagram) != wanted:
            other = _NUMBERS.get(len(datagram))
            what = f"{len(datagram)} bytes instead of {wanted}"
            if other:
                what += f": a robot that takes {other[0]} bytes, of another generation"
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
        tick = int(self._tick_now)
        # Serial numbers of 32 bits: in 49 days the milliseconds begin anew.
        ahead = (tick - self._tick) & 0xFFFFFFFF if self._tick is not None else 1
        if not 0 < ahead < 1 << 31:
            why = "its tick stands still" if ahead == 0 else "older than the one before"
            refuse(why, f"tick {tick} behind {self._tick}")
            return False
        self._copy_floats()
        if not np.isfinite(self._read).all():
            refuse("not finite", self._culprit())
            return False
        self._tick = tick
        return True

    def _copy_floats(self) -> None:
        for part, field in self._reads:
            part[...] = field

    def _culprit(self) -> str:
        for name, part in self._parts.items():
            wrong = np.flatnonzero(~np.isfinite(part))
            if len(wrong):
                of = f" of {self._names[wrong[0]]}" if name not in _FLOATS else ""
                return f"{name}{of} is {part[wrong[0]]}"
        return ""

    def _tell(self) -> None:
        views, parts, frame = self._views, self._parts, self._state
        motors, mounting = self._motors, self._mounting
        views["joint_pos"][...] = parts["joint_pos"]
        views["joint_vel"][...] = parts["joint_vel"]
        np.multiply(motors["tau"], np.float32(1.0 / TORQUE), out=views["joint_effort"])
        views["base_quat"][...] = mounting.quat(parts["quat"])
        views["base_ang_vel"][...] = mounting.vector(parts["gyro"])
        views["base_lin_acc"][...] = mounting.vector(parts["acc"])
        self.remote[:] = frame["remote"].tobytes()
        if "motor_temperature" in views:
            views["motor_temperature"][...] = motors["temperature"]
        if "motor_error" in views:
            mode, link = motors["mode"], self._link
            fine = (mode == link.servo) | (mode == link.damping)
            views["motor_error"][...] = np.where(fine, 0, mode)
        if self.tells_battery and "battery_charge" in views:
            bms = frame["bms"]
            views["battery_charge"][...] = bms["soc"] / 100.0
            views["battery_voltage"][...] = bms["cells"].sum() * CELL_VOLT
        if FOOT_FORCE in views:
            views[FOOT_FORCE][...] = frame["foot_force"]

    # -- out --------------------------------------------------------------------------------------

    def put(self) -> None:
        """Send the command states, and again until the next ones come.

        Raises:
            Fault: it cannot be sent, or the one before was too long ago: the robot is limp by now,
                and a stiff command would let it jump. From then on only limp ones leave.
        """
        pos, vel, effort, stiffness, damping = self._commands
        if self._repeater.late:
            stiffness = np.zeros_like(stiffness)
            effort = np.zeros_like(effort)
        self._repeater.put(self._out.write(pos, vel, effort, stiffness, damping))
        if self._repeater.late and not self._late:
            self._late = True
            raise Fault(
                f"platform {NAME!r}: no command came for {self._watchdog:g} s, the robot was "
                "damped (watchdog)"
            )

    def prepare(self) -> str:
        """Return what a person has to do so that the motors take commands, "" once they do."""
        if not self._check_mode:
            return ""
        mode = self._motors["mode"]
        wrong = np.flatnonzero(mode != self._link.servo)
        if not len(wrong):
            return ""
        return (
            f"motor {self._names[wrong[0]]} is in mode {mode[wrong[0]]:#04x}, not in servo mode "
            f"{self._link.servo:#04x}; {self._link.preparation}"
        )

    def wait(self, timeout: float) -> bool:
        """Return True once a datagram is there, False after `timeout` in [s]."""
        return self._udp.wait(timeout)

    def close(self) -> None:
        """End the thread and close the socket."""
        self._repeater.close()
        self._udp.close()

    @property
    def clamped(self) -> int:
        """Figures so far that the datagram could not hold."""
        return self._out.clamped

    @property
    def strangers(self) -> int:
        """Datagrams so far that were another sender's."""
        return self._udp.strangers
