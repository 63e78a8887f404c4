"""Process that watches a mirrored topic and notes when it has each message.

`--variant bridge` receives as our bridge does, into states, behind one wait set; `--variant rclpy`
is a node with a callback, whose executor alone takes longer than the message's way to it.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import JointState

from unicon_msgs_map import Decoder, parse_map
from unicon_ros import compat
from unicon_ros.bench.pipelines.log import MIRROR, Log, Stop, arguments, nanoseconds
from unicon_ros.bench.pipelines.plain_nodes import qos
from unicon_ros.bench.pipelines.workflows import joint_states_entry
from unicon_ros.bridge.topics_in import TopicIn

LONGEST = 0.1  # s of one wait, so that SIGTERM is heard

Step = Callable[[], object]


def main() -> None:
    """Run until SIGTERM."""
    options = arguments()
    rclpy.init(signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
    stop, log = Stop(), Log(options.out, "stamp", "received")
    node = Node("observer")
    make = {"bridge": _bridge, "rclpy": _rclpy}[options.variant]
    step, close = make(node, log, options.joints, options.best_effort)
    while not stop:
        step()
    log.save()
    close()
    node.destroy_node()
    rclpy.try_shutdown()


def _bridge(node: Node, log: Log, joints: int, best_effort: bool) -> tuple[Step, Step]:
    (spec,) = parse_map(f"subscribe:\n{joint_states_entry(MIRROR, best_effort)}").subscribe
    arrays: dict[str, Any] = {
        name: np.zeros(joints, np.float32) for name in ("joint_pos", "joint_vel", "joint_effort")
    }
    arrays["stamp_ns"] = np.zeros((), np.int64)
    names = [f"joint_{i}" for i in range(joints)]
    decoder = Decoder.build(spec, arrays, None, {"joint_names": names})
    topic = TopicIn(node, decoder, JointState, False, compat.polled_group(), print)
    waiter = compat.ReusedWaitSet([topic.subscription], node.context)

    def step() -> None:
        waiter.sleep(LONGEST)
        before = topic.received
        topic.poll()
        if topic.received > before:
            received = time.time_ns()
            log.add(decoder.stamp_ns, received)

    def close() -> None:
        waiter.close()
        topic.close()

    return step, close


def _rclpy(node: Node, log: Log, joints: int, best_effort: bool) -> tuple[Step, Step]:
    def on_message(message: Any) -> None:
        received = time.time_ns()
        log.add(nanoseconds(message.header.stamp), received)

    node.create_subscription(JointState, MIRROR, on_message, qos(best_effort))
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    return lambda: executor.spin_once(timeout_sec=LONGEST), executor.shutdown


if __name__ == "__main__":
    main()
