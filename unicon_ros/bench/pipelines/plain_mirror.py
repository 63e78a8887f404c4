"""Plain rclpy nodes of a mirror: one publishes a driver's joint states by a timer, one watches.

What our mirror is beside, publisher against publisher: the same arrays and message, no control,
no second topic, a message that is filled anew. The watching node's executor alone takes longer than
the message's way to it.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import JointState

from unicon_ros.bench.pipelines.log import MIRROR, Log, nanoseconds, set_stamp
from unicon_ros.bench.pipelines.plain_nodes import qos


class PlainMirror(Node):
    """Copies the driver's arrays and publishes them."""

    def __init__(self, joints: int, state_rate: float, best_effort: bool, log: Log) -> None:
        super().__init__("controller")
        self.log = log
        self.out = self.create_publisher(JointState, MIRROR, qos(best_effort))
        self.message = JointState(name=[f"joint_{i}" for i in range(joints)])
        self.driver = np.zeros((3, joints), np.float32)
        self.states = np.zeros_like(self.driver)
        self.create_timer(1.0 / state_rate, self.on_timer)

    def on_timer(self) -> None:
        now = time.time_ns()
        self.states[:] = self.driver
        message = self.message
        set_stamp(message.header.stamp, now)
        message.position, message.velocity, message.effort = self.states.tolist()
        begin = time.time_ns()
        self.out.publish(message)
        self.log.add(begin, time.time_ns())


class PlainObserver(Node):
    """Notes in a callback when each message of the mirrored topic has come."""

    def __init__(self, best_effort: bool, log: Log) -> None:
        super().__init__("observer")
        self.log = log
        self.create_subscription(JointState, MIRROR, self.on_message, qos(best_effort))

    def on_message(self, message: Any) -> None:
        received = time.time_ns()
        self.log.add(nanoseconds(message.header.stamp), received)
