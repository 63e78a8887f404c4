"""StateReader: checks a robot's datagrams and brings one into the states, for `LeggedWire`."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.errors import StateError
from unicon_core.platforms.kit.base import IMU_STATES, Mounting
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_ros.hardware.unitree_legged.codec import CELL_VOLT, LAYOUTS, TORQUE, Frame
from unicon_ros.hardware.unitree_legged.link import NAME, Link
from unicon_ros.hardware.wire import Counts, newer

FOOT_FORCE = "foot_force"
"""A state of shape (4,) that a workflow may declare: what the feet's sensors tell, in units of
theirs, in the order of the robot's legs."""

_NM = np.float32(1.0 / TORQUE)
_IMU = ("quat", "gyro", "acc")
"""Fields of a datagram, in the order of `IMU_STATES`."""
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
        self, states: States, robot: Robot, link: Link, counts: Counts, encrypted: bool
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
        self._errors = [states[name] for name in ("motor_error",) if name in states]
        self._errors_of = b""
        self._battery: list[NDArray[np.float32]] = []
        if "bms" in frame and "battery_charge" in states:
            self._battery = [states["battery_charge"], states["battery_voltage"]]

    def good(self, datagram: bytes) -> bool:
        """Return whether it is good and new; it is counted where it is not."""
        frame, link, refuse = self._frame, self._link, self._counts.refuse
        wanted = self.length
        if len(datagram) != wanted:
            what = f"{len(datagram)} bytes instead of {wanted}"
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
            for view in self._errors:
                view[...] = np.where(fine, 0, self.modes)
        if self._battery:
            bms = self._frame["bms"]
            charge, voltage = self._battery
            charge[...] = bms["soc"] / 100.0
            voltage[...] = bms["cells"].sum() * CELL_VOLT
