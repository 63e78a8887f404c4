"""Process of a plain rclpy node that mirrors a driver's joint states to a topic, by a timer.

What our mirror is beside, publisher against publisher: the same arrays and message, no control,
no second topic, a message that is filled anew.
"""

from __future__ import annotations

import time

import numpy as np
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import JointState

from unicon_ros.bench.pipelines.log import MIRROR, Log, Stop, arguments, set_stamp
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


def main() -> None:
    """Run until SIGTERM."""
    options = arguments()
    rclpy.init(signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
    stop, log = Stop(), Log(options.out, "begin", "end")
    node = PlainMirror(options.joints, options.state_rate, options.best_effort, log)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    while not stop:
        executor.spin_once(timeout_sec=0.1)
    log.save()
    node.destroy_node()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
