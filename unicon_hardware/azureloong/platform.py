"""Platform `azureloong`: AzureLoong through its joint interface, UDP port 8006.

The robot answers to the sender of commands, so that even a listener has to send: frames whose
state is 0, which the robot does not carry out, until the first command.
"""

from __future__ import annotations

import math
import struct
import time
from typing import Annotated

import numpy as np

from unicon_base import Fault, PlatformError
from unicon_base.schema.marks import Within
from unicon_core.bounds import within
from unicon_core.platforms.kit.base import IMU_STATES, Mounting, quat_of_rpy
from unicon_core.platforms.kit.command import Command
from unicon_core.platforms.platform import Facts
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_core.states.standard import JOINT_STATES
from unicon_hardware.azureloong.codec import COPIED, LoongTransport, part
from unicon_hardware.facts import fact, ipv4
from unicon_hardware.wire import Counts, Udp, Wire
from unicon_hardware.wired_robot import WiredRobot, opened

STAMP = struct.Struct("<d")


class AzureWire(Wire):
    """See the module.

    Args:
        states: of the workflow.
        robot: its file.
        address: of the robot.
        torque_limit_rate: share of the drives' largest current that the robot may use.
        filter_rate: share of a new command that the robot follows in each of its steps; 1 follows
            at once.

    Raises:
        RobotError: the robot file lacks a fact.
    """

    def __init__(
        self,
        states: States,
        robot: Robot,
        address: str,
        torque_limit_rate: float,
        filter_rate: float,
    ) -> None:
        link = self._link = LoongTransport.of(robot)
        self._lower, self._upper = link.limits
        self.counts, self.where = Counts(), f"{address}:{link.port}"
        self._mounting = Mounting.of(robot)
        self._command = Command(states, robot.joint_names, dtype=np.float32)
        command, kind = link.layouts
        frame = self._frame = np.zeros(1, command)
        frame["checker"], frame["size"] = link.checker, frame.nbytes
        frame["torque_limit_rate"], frame["filter_rate"] = torque_limit_rate, filter_rate
        self._bytes = frame.view(np.uint8).data
        block = frame.view(np.uint8)[part(command, "joint_pos_target", "finger_left")]
        self._block = block.view("<f4").reshape(self._lower.shape)
        self._stamp, self._plan = -math.inf, 0
        self._asked, self._commanding = -math.inf, False
        self._floats, self._size = part(kind, "rpy", "temperature"), kind.itemsize
        self._heard = bytearray(self._size)
        heard = np.frombuffer(self._heard, kind)[0:1]
        self._rpy, self._key = heard["rpy"][0], heard["key"][0]
        readings = np.zeros(4), heard["gyro"][0], heard["acc"][0]
        self._imu = dict(zip(IMU_STATES, readings, strict=True))
        self._base = {name: states[name] for name in IMU_STATES}
        self._copied = [
            (states[state], heard[field][0]) for state, field in COPIED.items() if state in states
        ]
        self._fingers = [
            (frame[f"finger_{side}"][0], heard[f"finger_target_{side}"][0])
            for side in ("left", "right")
        ]
        self._stamp_at = part(kind, "timestamp", "key").start
        self._name = heard["plan"]
        self._udp = Udp(
            ("0.0.0.0", 0), (address, link.port), f"azureloong at {address}", self.counts
        )

    def take(self) -> int:
        """See `Wire`.

        Raises:
            Fault: the robot has left the plan in which it takes commands.
        """
        now = time.monotonic()
        if not self._commanding and now - self._asked >= 1.0 / self._link.rate:
            self._asked = now
            self._udp.send(self._bytes)
        good = [data for data in self._udp.received() if self._accepted(data)]
        if good:
            self._tell(good[-1])
        self.counts.good += len(good)
        return len(good)

    def _accepted(self, data: bytes) -> bool:
        """Whether a frame is new and finite."""
        counts = self.counts
        if len(data) != self._size:
            counts.refuse("of another length", f"{len(data)} bytes, {self._size} are right")
            return False
        told = np.frombuffer(data[self._floats], "<f4")
        (stamp,) = STAMP.unpack_from(data, self._stamp_at)
        if not (np.isfinite(told).all() and math.isfinite(stamp)):
            counts.refuse("not finite")
            return False
        if stamp <= self._stamp:
            counts.refuse("old", f"of {stamp:.14g} s behind one of {self._stamp:.14g} s")
            return False
        self._stamp = stamp
        return True

    def _tell(self, frame: bytes) -> None:
        self._heard[:] = frame
        for view, field in self._copied:
            view[...] = field
        for view, field in self._fingers:  # we have no say in them: they keep their targets
            np.copyto(view, field, where=np.isfinite(field))
        self._imu["base_quat"][...] = quat_of_rpy(self._rpy)
        self._mounting.turn(self._imu, self._base)
        self._plan = int(self._key[1])
        if self._commanding and self._plan != self._link.keys["commands"]:
            raise Fault(
                f"azureloong has left plan jntSdk: {self._where_it_is}; somebody has its remote"
            )

    @property
    def _where_it_is(self) -> str:
        name = bytes(self._name[0]).split(b"\0")[0].decode("ascii", "replace")
        return f"it is in plan {name!r} (key {self._plan})"

    def prepare(self) -> str:
        """Return "" once the robot takes commands, else what to press: only its remote does that.

        What a remote sends is documented for its keys alone, and a remote that falls silent is a
        fault to the robot; so we do not pretend to be one.
        """
        keys = self._link.keys
        if self._plan == keys["commands"]:
            return ""
        missing = {keys["walk"]: "jntSdk", keys["idle"]: "rc, rl, then jntSdk"}
        press = missing.get(self._plan, "en, rc, rl, then jntSdk")
        return f"{self._where_it_is}; press {press} on its remote"

    def put(self) -> None:
        """See `Wire`."""
        self._command.take()
        rows = self._command.rows
        np.clip(rows, self._lower, self._upper, out=self._block)
        self.counts.clamped += not np.array_equal(rows, self._block)
        self._frame["state"] = self._link.commanding
        self._commanding = True
        self._udp.send(self._bytes)

    def wait(self, timeout: float) -> bool:
        """See `Wire`."""
        return self._udp.wait(timeout)

    def close(self) -> None:
        """See `Wire`."""
        self._udp.close()


SHARE = Annotated[float, Within(0.001, 1.0)]
SILENCE = 0.1
"""In [s]: 20 frames at 200 Hz, a fifth of what the robot allows us."""


class AzureLoong(WiredRobot):
    """See the module."""

    facts = Facts(
        "azureloong",
        writes=(
            *JOINT_STATES,
            *IMU_STATES,
            "projected_gravity",
            "motor_temperature",
            "motor_error",
            "stamp_ns",
        ),
        protocols=("azureloong",),
    )


def make(
    states: States,
    robot: Robot,
    period: float,
    *,
    address: str = "",
    connect: float = 5.0,
    silence: float = SILENCE,
    torque_limit_rate: float | None = None,
    filter_rate: float | None = None,
    silent: bool = False,
) -> AzureLoong:
    """Open the robot.

    Args:
        states: of the workflow.
        robot: its file.
        period: of a tick in [s].
        address: of the robot; the vendor documents none.
        connect: how long to wait for the first frame, [s].
        silence: of the robot that is a fault, [s].
        torque_limit_rate: share of the drives' largest current, 0 to 1; the robot file's.
        filter_rate: share of a new command that the robot follows in each step, 0 to 1; the robot
            file's.
        silent: no command is sent; to hear the robot, frames that it does not carry out are.

    Raises:
        PlatformError: an option is wrong, or the robot does not answer.
        RobotError: the robot file lacks a fact.
        WorkflowError: a share is not one.
    """
    if not address:
        raise PlatformError(
            "platform 'azureloong' needs the robot's address, which its vendor does not document; "
            "write platforms: {azureloong: {address: …}}"
        )
    shares = [
        fact(robot, key, SHARE) if given is None else within(given, key, "", 1.0)
        for key, given in (("torque_limit_rate", torque_limit_rate), ("filter_rate", filter_rate))
    ]
    wire = AzureWire(states, robot, ipv4(address, "azureloong"), *shares)
    return opened(AzureLoong(states, robot, period, wire, silence=silence, silent=silent), connect)
