"""Process of a controller with a thread that spins, as UniCon bridges ROS: `spin_once`, then sleep.

Our own baseline of that style: one message is taken for each pass of the spinning thread, so a
queue of depth 10 stays full of old states. The loop runs at its rate beside it and sends.
"""

from __future__ import annotations

import threading
import time
from typing import Any

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import Imu, JointState

from unicon_ros.bench.pipelines.log import COMMAND, IMU, STATE, Log, Stop, arguments, nanoseconds
from unicon_ros.bench.pipelines.plain_nodes import qos

SPIN_PERIOD = 0.002  # s between two passes of the spinning thread


def main() -> None:
    """Run until SIGTERM."""
    options = arguments()
    rclpy.init(signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
    stop, log = Stop(), Log(options.out, "stamp", "seen", "begin", "end")
    node = Node("controller")
    profile = qos(options.best_effort, depth=10)
    out = node.create_publisher(JointState, COMMAND, profile)
    latest: dict[str, Any] = {}

    def on_state(state: Any) -> None:
        latest["seen"] = time.time_ns()
        latest["state"] = state

    def on_imu(imu: Any) -> None:
        latest["imu"] = imu

    node.create_subscription(JointState, STATE, on_state, profile)
    node.create_subscription(Imu, IMU, on_imu, profile)
    executor = SingleThreadedExecutor()
    executor.add_node(node)

    def spin() -> None:
        while not stop:
            executor.spin_once(timeout_sec=0.0)
            time.sleep(SPIN_PERIOD)

    thread = threading.Thread(target=spin)
    thread.start()
    command = JointState(name=[f"joint_{i}" for i in range(options.joints)])
    period = 1.0 / options.rate
    due = time.monotonic() + period
    while not stop:
        time.sleep(max(0.0, due - time.monotonic()))
        due = max(due + period, time.monotonic())
        state = latest.get("state")
        if state is None:
            continue
        begin = time.time_ns()
        command.header.stamp = state.header.stamp
        command.position = state.position
        out.publish(command)
        stamp = nanoseconds(state.header.stamp)
        log.add(stamp, latest["seen"], begin, time.time_ns())
    thread.join()
    log.save()
    node.destroy_node()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
