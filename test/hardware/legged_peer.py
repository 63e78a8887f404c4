"""What the tests of `unitree_legged` share: ports, slow codecs with struct, an emulated robot."""

from __future__ import annotations

import socket
import struct
import time
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np

from unicon_core.platforms.fake import make as make_fake
from unicon_core.robots import Robot, load_robot
from unicon_core.states import States, standard_states
from unicon_core.states.standard import hardware_states
from unicon_hardware.unitree_legged.codec import LAYOUTS
from unicon_hardware.unitree_legged.platform import LeggedEndpoint, face

LENGTHS = {"a1": (610, 771), "aliengo": (610, 771), "go1": (614, 807)}
ALIENGO = ("legged_sdk_3.3.1", "legged_sdk_3.8.4")
RATE = 500.0


def free_port() -> int:
    """Return a UDP port that nobody has on any address."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("0.0.0.0", 0))
        return int(probe.getsockname()[1])


def robot_of(name: str) -> Robot:
    """Return a robot that can be driven: the Aliengo with the gains of the vendor's examples."""
    robot = load_robot(name)
    if name != "aliengo":
        return robot
    gains = {"joint_stiffness": 20.0, "joint_damping": 2.0}
    arrays = {key: np.full(robot.num_joints, value, np.float32) for key, value in gains.items()}
    return replace(robot, **arrays)


def states_of(robot: Robot) -> States:
    """Return the states that a workflow on this platform has."""
    return States(standard_states(robot.joint_names) | hardware_states(robot.joint_names))


def servo_link(name: str, motors: int) -> Any:
    """Return what a command frame takes of a link to a robot of so many joints."""
    layout = LAYOUTS[LENGTHS[name]]
    stops = {"pos_stop": 2.146e9, "vel_stop": 16000.0}
    return SimpleNamespace(
        layout=layout, motors=slice(0, motors), level_flag=255, servo=10, **stops
    )


def slow_crc(words: bytes) -> int:
    """Return the checksum bit by bit: polynomial 0x04c11db7, each word's highest bit first."""
    crc = 0xFFFFFFFF
    for (word,) in struct.iter_unpack("<I", words):
        for bit in range(31, -1, -1):
            high = crc >> 31 ^ (word >> bit & 1)
            crc = crc << 1 & 0xFFFFFFFF
            crc ^= 0x04C11DB7 if high else 0
    return crc


def sealed(frame: bytes) -> bytes:
    """Return a datagram with its checksum in place of its last four bytes."""
    words = (len(frame) >> 2) - 1
    return frame[:-4] + struct.pack("<I", slow_crc(frame[: 4 * words]))


def slow_command(name: str, motors: list[tuple[float, ...]], servo: int = 10) -> bytes:
    """Return a command, motor by motor: mode, q, dq, then tau, kp, kd held to 16 bits."""
    head = b"\xff" + bytes(9) if name != "go1" else b"\xfe\xef\xff" + bytes(19)
    body = b""
    for i in range(20):
        q, dq, tau, kp, kd = motors[i] if i < len(motors) else (2.146e9, 16000.0, 0.0, 0.0, 0.0)
        whole = [int(kp * 32), int(kd * 16)]
        kp, kd = (min(max(value, 0), 65535) for value in whole)
        torque = min(max(int(tau * 256), -32768), 32767)
        q, dq = q if kp else 2.146e9, dq if kd else 16000.0
        body += struct.pack("<BffhHH12x", servo, q, dq, torque, kp, kd)
    return sealed(head + body + bytes(LENGTHS[name][0] - len(head) - len(body)))


def slow_state(
    name: str,
    motors: list[tuple[Any, ...]],
    imu: tuple[float, ...],
    tick: int,
    *,
    level: int = 255,
    soc: int = 77,
) -> bytes:
    """Return a state: motors are mode, q, dq, tau (wire), °C; the IMU is quat, gyro, acc."""
    head = bytes([level]) + bytes(9) if name != "go1" else b"\xfe\xef" + bytes([level]) + bytes(19)
    body = struct.pack("<10f12xb", *imu, 40)
    for mode, q, dq, tau, temperature in [*motors, *[(0, 0.0, 0.0, 0, 0)] * (20 - len(motors))]:
        body += struct.pack("<Bffhh10xb8x", mode, q, dq, 0, tau, temperature)
    if name == "go1":
        body += struct.pack("<4Bi6x10B", 1, 2, 1, soc, -1234, *[100] * 10)
    body += struct.pack("<8hI", 11, 12, 13, 14, 0, 0, 0, 0, tick) + bytes(range(40)) + bytes(8)
    return sealed(head + body)


class Emulated:
    """A robot of stub physics behind its endpoint, stepped at 500 Hz of its own time.

    Attributes:
        face: its end of the protocol.
        states: what it measures and is commanded.
        first: distance in [rad] of the first position target with stiffness from the joints.

    Args:
        robot: the robot.
        port: where it takes commands.
        options: of the endpoint.
    """

    def __init__(self, robot: Robot, port: int, **options: Any) -> None:
        self.states = states_of(robot)
        self.physics = make_fake(self.states, robot, 1.0 / RATE, time_constant=0.05)
        self.face: LeggedEndpoint = face(self.states, robot, port=port, **options)
        self.first: float | None = None
        self._rng = np.random.default_rng(0)
        self._due = time.monotonic()
        self.physics.recv()

    def step(self) -> None:
        """One period of the robot: hear, simulate, send."""
        states = self.states
        if self.face.hear() and self.first is None and states["joint_stiffness"].any():
            away = np.abs(states["joint_pos_target"] - states["joint_pos"])
            self.first = float(away[states["joint_stiffness"] > 0.0].max())
        self.physics.send()
        self.physics.recv()
        # Noise of MEMS sensors and encoders: what has none counts as frozen.
        for name, scale in (("base_ang_vel", 1e-3), ("base_lin_acc", 1e-2), ("joint_vel", 1e-4)):
            states[name] += self._rng.normal(0.0, scale, states[name].shape).astype(np.float32)
        self.face.now = time.monotonic()  # its clock goes on where steps are missed
        self.face.tell()

    def run(self, seconds: float) -> None:
        """Step in real time; what a busy machine missed is not caught up."""
        end = time.monotonic() + seconds
        while (now := time.monotonic()) < end:
            self._due = max(self._due + 1.0 / RATE, now - 0.01)
            time.sleep(max(0.0, self._due - now))
            self.step()

    def close(self) -> None:
        """Let go."""
        self.face.close()
        self.physics.close()
