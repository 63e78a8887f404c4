"""Process of a robot that speaks ROS 2 in bytes: message map out, one wait set in; no executor.

The peer of our own controllers, and, for comparison, of plain ones: its share of the latency is as
small as rclpy allows, so that what remains is the controller's.

With `--variant observer` it watches a mirrored topic as our bridge does, and notes when it has each
message in states.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
import rclpy
from rclpy.node import Node
from sensor_msgs.msg import Imu, JointState

from unicon_msgs_map import Decoder, Encoder, parse_map
from unicon_ros import compat
from unicon_ros.bench.pipelines.log import COMMAND, IMU, MIRROR, STATE, Log, Stop, arguments
from unicon_ros.bench.pipelines.plain_nodes import qos
from unicon_ros.bench.pipelines.workflows import joint_states_entry
from unicon_ros.bridge.topics_in import TopicIn

LONGEST = 0.1  # s of one wait, so that SIGTERM is heard

MAP = f"""
publish:
{joint_states_entry(STATE, best_effort=False)}
  - topic: {IMU}
    type: sensor_msgs/msg/Imu
    fields: {{header.stamp: stamp_ns, orientation: base_quat, angular_velocity: base_ang_vel,
             linear_acceleration: base_lin_acc}}
subscribe:
  - topic: {COMMAND}
    type: sensor_msgs/msg/JointState
    fields: {{header.stamp: command_stamp_ns, name: $joint_names, position: joint_pos_target}}
"""


def main() -> None:
    """Run until SIGTERM."""
    options = arguments()
    rclpy.init(signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
    stop, log = Stop(), Log(options.out, "stamp", "received")
    node = Node(options.variant or "robot")
    (_observe if options.variant == "observer" else _serve)(options, node, stop, log)
    log.save()
    node.destroy_node()
    rclpy.try_shutdown()


def _names(options: argparse.Namespace) -> list[str]:
    return [f"joint_{i}" for i in range(options.joints)]


def _serve(options: argparse.Namespace, node: Node, stop: Stop, log: Log) -> None:
    """Publish at `--state-rate` and note commands."""
    names = _names(options)
    arrays = {
        name: np.zeros(len(names), np.float32)
        for name in ("joint_pos", "joint_vel", "joint_effort", "joint_pos_target")
    }
    arrays |= {name: np.zeros((), np.int64) for name in ("stamp_ns", "command_stamp_ns")}
    arrays |= {name: np.zeros(3, np.float32) for name in ("base_ang_vel", "base_lin_acc")}
    arrays["base_quat"] = np.array([1, 0, 0, 0], np.float32)
    spec = parse_map(MAP)
    labels = {name: tuple(names) for name in arrays if name.startswith("joint_")}
    variables = {"joint_names": names}
    states, imu = (Encoder.build(s, arrays, labels, variables) for s in spec.publish)
    command = Decoder.build(spec.subscribe[0], arrays, labels, variables)
    profile = qos(options.best_effort)
    publish_state, _ = compat.raw_publish(node.create_publisher(JointState, STATE, profile))
    publish_imu, _ = compat.raw_publish(node.create_publisher(Imu, IMU, profile))
    subscription = node.create_subscription(
        JointState, COMMAND, lambda message: None, profile, raw=True
    )
    take, _ = compat.raw_take(subscription)
    assert take is not None
    waiter = compat.ReusedWaitSet([subscription], node.context)
    now, period = time.time_ns, round(1e9 / options.state_rate)
    stamp, position = arrays["stamp_ns"], arrays["joint_pos"]
    due = now() + period
    while not stop:
        remaining = due - now()
        if remaining > 0 and not waiter.wait(remaining * 1e-9):
            continue
        raw = take()
        if raw is not None:
            received = now()
            if command.decode(raw):
                log.add(int(arrays["command_stamp_ns"]), received)
        present = now()
        if present >= due:
            due += period * ((present - due) // period + 1)
            stamp[...] = present
            position[0] = present * 1e-9 % 1.0
            publish_imu(imu.encode())
            publish_state(states.encode())
    waiter.close()


def _observe(options: argparse.Namespace, node: Node, stop: Stop, log: Log) -> None:
    """Receive the mirror into states, behind one wait set."""
    entry = joint_states_entry(MIRROR, options.best_effort)
    (spec,) = parse_map(f"subscribe:\n{entry}").subscribe
    joints = ("joint_pos", "joint_vel", "joint_effort")
    arrays = {name: np.zeros(options.joints, np.float32) for name in joints}
    stamp = {"stamp_ns": np.zeros((), np.int64)}
    decoder = Decoder.build(spec, arrays | stamp, None, {"joint_names": _names(options)})
    topic = TopicIn(node, decoder, JointState, False, compat.polled_group(), print)
    waiter = compat.ReusedWaitSet([topic.subscription], node.context)
    while not stop:
        waiter.sleep(LONGEST)
        before = topic.received
        topic.poll()
        if topic.received > before:
            received = time.time_ns()
            log.add(decoder.stamp_ns, received)
    waiter.close()
    topic.close()


if __name__ == "__main__":
    main()
