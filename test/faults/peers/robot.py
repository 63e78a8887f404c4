"""A robot behind topics for platform `ros`, which logs commands. Arguments: LOG RUNS_LOG FAULT AT.

FAULT is one of `nan`, `subset`, `far` (1e30, then silence), `silence`, `imu_nan`, `imu_silence`,
`imu_never`, `quat_zero`, `another` (robot), `killed` (by SIGKILL), `garbage` and `imu_garbage`
(bytes that are not a message), `good`. It comes after AT commands; `imu_never` and `another` from
the beginning.
"""

from __future__ import annotations

import os
import signal
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from rclpy.serialization import serialize_message
from sensor_msgs.msg import Imu, JointState

from faults.command_log import FAULT, SEND, CommandLog
from faults.peers.noise import garbage
from unicon_core.robots import load_robot

FAR_S = 0.2


class Robot:
    """Publishes states at 200 Hz; its joints are where they were told to be."""

    def __init__(self, log: CommandLog, fault: str, at: int) -> None:
        self._log, self._fault, self._at = log, fault, at
        self._rng = np.random.default_rng(at)
        self._since = 0.0
        self._commands = 0
        self._names = list(load_robot("go2").joint_names)
        self._pos = [float(x) for x in load_robot("go2").default_joint_pos]
        self.node = rclpy.create_node("robot")
        self._states = self.node.create_publisher(JointState, "joint_states", 10)
        self._imu = self.node.create_publisher(Imu, "imu/data", 10)
        self.node.create_subscription(JointState, "joint_commands", self._commanded, 100)
        self.node.create_timer(0.005, self._say)

    def _commanded(self, message: Any) -> None:
        target = np.full(len(self._names), np.nan)
        target[: len(message.position)] = message.position[: len(self._names)]
        self._log.add(SEND, self._commands, target=target, stiffness=1.0, damping=1.0)
        self._commands += 1
        if np.isfinite(target).all() and not self._since:
            self._pos = [float(x) for x in target]
        if self._commands == self._at:
            self._since = time.monotonic()
            if self._fault != "good":
                self._log.add(FAULT)
            if self._fault == "killed":
                os.kill(os.getpid(), signal.SIGKILL)

    def _say(self) -> None:
        fault = self._fault if self._since else ""
        another = self._fault == "another"
        states = JointState(name=[f"h1_{x}" for x in self._names] if another else self._names)
        states.header.stamp = self.node.get_clock().now().to_msg()
        states.position = list(self._pos)
        states.velocity = [0.0] * len(self._names)
        if fault == "nan":
            states.position[0] = float("nan")
        elif fault == "subset":
            states.name, states.position = self._names[:5], states.position[:5]
            states.velocity = states.velocity[:5]
        elif fault == "far":
            states.position = [1e30] * len(self._names)
        quiet = fault == "far" and time.monotonic() > self._since + FAR_S
        if fault != "silence" and not quiet:
            self._publish(self._states, states, fault == "garbage")
        if self._fault == "imu_never" or fault == "imu_silence":
            return
        imu = Imu()
        imu.header.stamp = states.header.stamp
        imu.orientation.w = 0.0 if fault == "quat_zero" else 1.0
        imu.linear_acceleration.z = 9.81
        if fault == "imu_nan":
            imu.angular_velocity.x = imu.orientation.w = float("nan")
        self._publish(self._imu, imu, fault == "imu_garbage")

    def _publish(self, publisher: Any, message: Any, spoilt: bool) -> None:
        raw = serialize_message(message) if spoilt else b""
        publisher.publish(garbage(self._rng, raw) if spoilt else message)


def main() -> None:
    """Run until killed."""
    log = CommandLog(Path(sys.argv[1]))
    if sys.argv[3] in ("imu_never", "another"):
        log.add(FAULT)
    rclpy.init()
    rclpy.spin(Robot(log, sys.argv[3], int(sys.argv[4])).node)


main()
