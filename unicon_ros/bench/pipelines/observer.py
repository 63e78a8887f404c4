"""Process of a plain rclpy node that watches a mirrored topic and notes when each message comes."""

from __future__ import annotations

import time
from typing import Any

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import JointState

from unicon_ros.bench.pipelines.log import MIRROR, Log, Stop, arguments, nanoseconds
from unicon_ros.bench.pipelines.plain_nodes import qos


def main() -> None:
    """Run until SIGTERM."""
    options = arguments()
    rclpy.init(signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
    stop, log = Stop(), Log(options.out, "stamp", "received")
    node = Node("observer")

    def on_message(message: Any) -> None:
        log.add(nanoseconds(message.header.stamp), time.time_ns())

    node.create_subscription(JointState, MIRROR, on_message, qos(options.best_effort))
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    while not stop:
        executor.spin_once(timeout_sec=0.1)
    log.save()
    node.destroy_node()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
