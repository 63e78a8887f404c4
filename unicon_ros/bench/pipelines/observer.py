"""Process that watches a mirrored topic as our bridge does, and notes when it has each message.

It receives into states, behind one wait set.
"""

from __future__ import annotations

import time

import numpy as np
import rclpy
from rclpy.node import Node
from sensor_msgs.msg import JointState

from unicon_msgs_map import Decoder, parse_map
from unicon_ros import compat
from unicon_ros.bench.pipelines.log import MIRROR, Log, Stop, arguments
from unicon_ros.bench.pipelines.workflows import joint_states_entry
from unicon_ros.bridge.topics_in import TopicIn

LONGEST = 0.1  # s of one wait, so that SIGTERM is heard


def main() -> None:
    """Run until SIGTERM."""
    options = arguments()
    rclpy.init(signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
    stop, log = Stop(), Log(options.out, "stamp", "received")
    node = Node("observer")
    entry = joint_states_entry(MIRROR, options.best_effort)
    (spec,) = parse_map(f"subscribe:\n{entry}").subscribe
    joints = ("joint_pos", "joint_vel", "joint_effort")
    arrays = {name: np.zeros(options.joints, np.float32) for name in joints}
    stamp = {"stamp_ns": np.zeros((), np.int64)}
    names = [f"joint_{i}" for i in range(options.joints)]
    decoder = Decoder.build(spec, arrays | stamp, None, {"joint_names": names})
    topic = TopicIn(node, decoder, JointState, False, compat.polled_group(), print)
    waiter = compat.ReusedWaitSet([topic.subscription], node.context)
    while not stop:
        waiter.sleep(LONGEST)
        before = topic.received
        topic.poll()
        if topic.received > before:
            received = time.time_ns()
            log.add(decoder.stamp_ns, received)
    log.save()
    waiter.close()
    topic.close()
    node.destroy_node()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
