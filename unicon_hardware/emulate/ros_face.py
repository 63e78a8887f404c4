"""Face `ros`: a robot behind plain topics, those of config/maps/ros_robot.yaml, for platform `ros`.

    unicon emulate go2 --face ros --model fake --posture random

It publishes `joint_states` and `imu/data`, and its joints go to the positions of `joint_commands`.
Where a map sends the stiffness as the effort of `joint_gains`, that acts from the next command on;
else the robot file's. It uses rclpy's own messages and knows nothing of maps, so that it is a
witness of what the bridge sends.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from unicon_base import PlatformError
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_hardware.endpoint import Endpoint
from unicon_ros.bridge.own_node import OwnNode
from unicon_ros.compat.loading import message_class

WATCHDOG = 0.5
"""Its own dead man, [s]."""
FASTEST = 1000.0
"""Of its states, [Hz]."""
MOST = 8
"""Messages that are looked at in a tick."""


class RosEndpoint(Endpoint):
    """A node with two publishers and two subscriptions; see the module.

    Args:
        states: of the emulator.
        robot: its file.
        rate: of the states in [Hz].
        imu_seconds: after so many the IMU is silent; 0 for never there.

    Raises:
        MissingDependencyError: rclpy or its messages are not installed.
        PlatformError: the rate is wrong.
    """

    platform = "ros"
    dead_man = WATCHDOG
    where = "joint_commands"

    def __init__(
        self, states: States, robot: Robot, *, rate: float = 200.0, imu_seconds: float = math.inf
    ) -> None:
        if not 0.0 < rate <= FASTEST:
            raise PlatformError(
                f"face 'ros': rate is {rate} Hz; give more than 0, at most {FASTEST:g}"
            )
        self.rate, self._states = rate, states
        self._names = list(robot.joint_names)
        self._stiffness = np.nan_to_num(robot.joint_stiffness, nan=1.0)
        self._damping = np.nan_to_num(robot.joint_damping)
        self._imu_until = time.monotonic() + imu_seconds
        self._looks = self._came = 0
        self._own = OwnNode("stand_in", None, ())
        node = self._node = self._own.node
        self._joint_state = message_class("sensor_msgs/msg/JointState")
        self._imu = message_class("sensor_msgs/msg/Imu")
        self._to_joints = node.create_publisher(self._joint_state, "joint_states", 10)
        self._to_imu = node.create_publisher(self._imu, "imu/data", 10)
        node.create_subscription(self._joint_state, "joint_commands", self._commanded, 10)
        node.create_subscription(self._joint_state, "joint_gains", self._gained, 10)

    def tell(self) -> None:
        """Publish what is measured."""
        states, stamp = self._states, self._node.get_clock().now().to_msg()
        joints = self._joint_state(name=self._names)
        joints.header.stamp = stamp
        joints.position = states["joint_pos"].tolist()
        joints.velocity = states["joint_vel"].tolist()
        self._to_joints.publish(joints)
        if time.monotonic() > self._imu_until:
            return
        imu = self._imu()
        imu.header.stamp = stamp
        turned = imu.orientation
        turned.w, turned.x, turned.y, turned.z = states["base_quat"].tolist()
        for vector, name in (
            (imu.angular_velocity, "base_ang_vel"),
            (imu.linear_acceleration, "base_lin_acc"),
        ):
            vector.x, vector.y, vector.z = states[name].tolist()
        self._to_imu.publish(imu)

    def hear(self) -> bool:
        """Take what has come; True where a command was among it."""
        self._came = 0
        for _ in range(MOST):
            before = self._looks
            self._own.executor.spin_once(timeout_sec=0.0)
            if self._looks == before:
                break
        return bool(self._came)

    def _commanded(self, message: Any) -> None:
        self._looks += 1
        wanted = self._by_name(message.name, message.position)
        if not wanted:
            return
        states = self._states
        for joint, position in wanted.items():
            states["joint_pos_target"][joint] = position
        states["joint_vel_target"][...] = states["joint_effort_ff"][...] = 0.0
        states["joint_stiffness"][...] = self._stiffness
        states["joint_damping"][...] = self._damping
        self._came += 1

    def _gained(self, message: Any) -> None:
        self._looks += 1
        for joint, gain in self._by_name(message.name, message.effort).items():
            if 0.0 <= gain < math.inf:
                self._stiffness[joint] = gain

    def _by_name(self, names: Sequence[str], values: Sequence[float]) -> dict[int, float]:
        """Return the value of each joint that is named; nothing where one is wrong."""
        known = set(names) <= set(self._names) and len(set(names)) == len(names) == len(values)
        return {self._names.index(n): v for n, v in zip(names, values)} if known else {}

    def close(self) -> None:
        """Let go of the node."""
        self._own.close()


face = RosEndpoint
