"""A robot of nobody's behind UDP, both ends: packed float32 arrays; for tests of the emulator.

state    u32 magic, frame number, variant, commanders; f32 pos, vel, effort (n), quat, gyro, acc
command  u32 magic; f32 q*, qd*, tau_ff, kp, kd (n)
release  u32 magic alone: asks the robot's own controller to let go
"""

from __future__ import annotations

import socket
import time
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.platforms.platform import Facts
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_core.states.standard import COMMAND_STATES, JOINT_STATES
from unicon_hardware.endpoint import Endpoint
from unicon_hardware.wire import Counts, Udp, Wire
from unicon_hardware.wired_robot import WiredRobot, opened

MAGIC = 0x1C0
PORT = 28017
IMU = ("base_quat", "base_ang_vel", "base_lin_acc")
RELEASE = np.uint32(MAGIC).tobytes()
# Who has not commanded for so long does not any more, [s].
FORGOTTEN = 1.0


def state_type(n: int) -> np.dtype[Any]:
    return np.dtype(
        [("head", "<u4", 4)]
        + [(name, "<f4", n) for name in JOINT_STATES]
        + [(name, "<f4", size) for name, size in zip(IMU, (4, 3, 3))]
    )


def command_type(n: int) -> np.dtype[Any]:
    return np.dtype([("magic", "<u4"), ("rows", "<f4", (len(COMMAND_STATES), n))])


class UdpWire(Wire):
    """The driver's end."""

    def __init__(self, states: States, robot: Robot, address: str, port: int) -> None:
        self.counts, self.where = Counts(), f"{address}:{port}"
        self._states, n = states, robot.num_joints
        self._socket = Udp(("", 0), (address, port), f"udp robot {self.where}")
        self._type, self._command = state_type(n), np.zeros((), command_type(n))
        self._command["magic"] = MAGIC
        self._last = -1
        self._head: NDArray[np.uint32] = np.zeros(4, np.uint32)
        self.variant = int(robot.transport.get("mode_machine", 0))
        self._hello()

    def _hello(self) -> None:
        self._socket.send(b"hello")  # so that it knows where to tell

    def take(self) -> int:
        good = 0
        for data in self._socket.received():
            if len(data) != self._type.itemsize:
                self.counts.refuse("wrong length", f"{len(data)} bytes")
                continue
            frame = np.frombuffer(data, self._type)[0]
            if not all(np.isfinite(frame[name]).all() for name in (*JOINT_STATES, *IMU)):
                self.counts.refuse("not a number")
                continue
            number = int(frame["head"][1])
            if frame["head"][0] != MAGIC or number == self._last:
                self.counts.refuse("wrong head or an old frame")
                continue
            self._last, self._head = number, frame["head"]
            for name in (*JOINT_STATES, *IMU):
                self._states[name][...] = frame[name]
            good += 1
        self.counts.good += good
        if not self.counts.good:
            self._hello()
        return good

    def put(self) -> None:
        for row, name in zip(self._command["rows"], COMMAND_STATES):
            row[...] = self._states[name]
        self._socket.send(self._command.tobytes())

    def wait(self, timeout: float) -> bool:
        return self._socket.wait(timeout)

    def close(self) -> None:
        self._socket.close()

    def prepare(self) -> str:
        if self._head[2] >> 31:
            return ""
        self._socket.send(RELEASE)
        return "its own controller lets go"

    def commanders(self) -> dict[str, int]:
        return {self.where: int(self._head[3])}

    def told(self) -> Mapping[str, Any]:
        return {"mode_machine": int(self._head[2]) & 0xFFFF} if self.counts.good else {}


class UdpRobot(WiredRobot):
    facts = Facts(
        "udp_robot",
        writes=(*JOINT_STATES, *IMU, "projected_gravity", "stamp_ns"),
    )

    def variant(self) -> Mapping[str, Any]:
        assert isinstance(self._wire, UdpWire)
        return self._wire.told()


class PromisedRobot(UdpRobot):
    """One whose frames are as many as the robot file promises, so that preflight counts them."""

    facts = replace(UdpRobot.facts, protocols=("unitree_go",))


def make(
    states: States,
    robot: Robot,
    period: float,
    *,
    address: str = "127.0.0.1",
    port: int = PORT,
    connect: float = 20.0,
    silence: float = 0.05,
    silent: bool = False,
) -> UdpRobot:
    wire = UdpWire(states, robot, address, port)
    return opened(UdpRobot(states, robot, period, wire, silence=silence, silent=silent), connect)


def promised(
    states: States, robot: Robot, period: float, *, port: int = PORT, silent: bool = False
) -> PromisedRobot:
    wire = UdpWire(states, robot, "127.0.0.1", port)
    return opened(PromisedRobot(states, robot, period, wire, silence=5.0, silent=silent), 20.0)


class UdpFace(Endpoint):
    """The robot's end: it publishes to each client that has said hello."""

    def __init__(
        self, states: States, robot: Robot, address: str, port: int, dead_man: float, held: bool
    ) -> None:
        self.rate, self.dead_man, self.obeys = 500.0, dead_man, not held
        self._states, n = states, robot.num_joints
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.bind((address, port))
        self.where = "{}:{}".format(*self._socket.getsockname())
        self._frame, self._command = np.zeros((), state_type(n)), command_type(n)
        self._variant = int(robot.transport.get("mode_machine", 0))
        self._peers: set[Any] = set()
        self._commanders: dict[Any, float] = {}

    def tell(self) -> None:
        frame, now = self._frame, time.monotonic()
        self._commanders = {
            peer: at for peer, at in self._commanders.items() if now - at < FORGOTTEN
        }
        head = frame["head"]
        head[0], head[1] = MAGIC, head[1] + 1
        head[2] = self._variant | self.obeys << 31
        for name in (*JOINT_STATES, *IMU):
            frame[name] = self._states[name]
        for peer in tuple(self._peers):
            head[3] = len(self._commanders.keys() - {peer})
            try:
                self._socket.sendto(frame.tobytes(), peer)
            except OSError:  # it has gone
                self._peers.discard(peer)

    def hear(self) -> bool:
        came = False
        for _ in range(64):
            try:
                data, peer = self._socket.recvfrom(65536)
            except BlockingIOError:
                break
            except OSError:
                continue
            self._peers.add(peer)
            if data == RELEASE:
                self.obeys = True
            if len(data) != self._command.itemsize:
                continue
            command = np.frombuffer(data, self._command)[0]
            self._commanders[peer] = time.monotonic()
            for row, name in zip(command["rows"], COMMAND_STATES):
                self._states[name][...] = row
            came = True
        return came

    def close(self) -> None:
        self._socket.close()


def face(
    states: States,
    robot: Robot,
    *,
    address: str = "127.0.0.1",
    port: int = PORT,
    dead_man: float = 0.5,
    held: bool = False,
) -> UdpFace:
    return UdpFace(states, robot, address, port, dead_man, held)
