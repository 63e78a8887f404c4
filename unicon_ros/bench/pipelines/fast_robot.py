"""Process of a robot that speaks ROS 2 in bytes: message map out, one wait set in; no executor.

The peer of our own controllers, and, for comparison, of plain ones: its share of the latency is as
small as rclpy allows, so that what remains is the controller's.

With `--variant observer` it watches a mirrored topic as our bridge does, and notes when it has each
message in states. `--variant ROBOT`, such as h1, is our emulator endpoint behind Unitree's DDS, the
peer of the official SDK and of ours: the state carries when it was made in the first 8 bytes of the
wireless remote. Commands have no room for it, but identity control hands the first joint's position
on, which numbers the states.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable

import numpy as np
import rclpy
from rclpy.node import Node
from sensor_msgs.msg import Imu, JointState

from unicon_base import UniconError
from unicon_core.robots import load_robot
from unicon_core.states import States, standard_states
from unicon_core.workflow.registry import find_factory
from unicon_msgs_map import Decoder, Encoder, parse_map
from unicon_ros import compat
from unicon_ros.bench.pipelines.log import (
    COMMAND,
    IMU,
    MIRROR,
    STATE,
    Log,
    Stop,
    arguments,
    joint_names,
)
from unicon_ros.bench.pipelines.plain import qos
from unicon_ros.bench.pipelines.unicon import joint_states_entry
from unicon_ros.bridge.topics import TopicIn

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


WINDOW = 4096
"""So many states have a number of their own: 8 s at 500 Hz. A power of two, exact in float32."""


def main() -> None:
    """Run until SIGTERM."""
    options = arguments()
    stop, log = Stop(), Log(options.out, "stamp", "received")
    if options.variant in ("", "observer"):
        rclpy.init(signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
        node = Node(options.variant or "robot")
        (_observe if options.variant else _serve)(options, node, stop, log)
        node.destroy_node()
        rclpy.try_shutdown()
    else:
        _serve_unitree(options, stop, log)
    log.save()


def _beat(
    rate: float,
    stop: Stop,
    wait: Callable[[float], bool],
    receive: Callable[[int], object],
    send: Callable[[int], object],
) -> None:
    """Send at a rate, and receive what comes between; both get the present time in [ns]."""
    now, period = time.time_ns, round(1e9 / rate)
    due = now() + period
    while not stop:
        remaining = due - now()
        if remaining > 0 and not wait(remaining * 1e-9):
            continue
        receive(now())
        present = now()
        if present >= due:
            due += period * ((present - due) // period + 1)
            send(present)


def _serve(options: argparse.Namespace, node: Node, stop: Stop, log: Log) -> None:
    """Publish at `--state-rate` and note commands."""
    names = joint_names(options.joints)
    joints = ("joint_pos", "joint_vel", "joint_effort", "joint_pos_target")
    arrays = {name: np.zeros(len(names), np.float32) for name in joints}
    arrays |= {name: np.zeros((), np.int64) for name in ("stamp_ns", "command_stamp_ns")}
    arrays |= {name: np.zeros(3, np.float32) for name in ("base_ang_vel", "base_lin_acc")}
    arrays["base_quat"] = np.array([1, 0, 0, 0], np.float32)
    spec = parse_map(MAP)
    labels, variables = dict.fromkeys(joints, tuple(names)), {"joint_names": names}
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

    def receive(received: int) -> None:
        raw = take()
        if raw is not None and command.decode(raw):
            log.add(int(arrays["command_stamp_ns"]), received)

    def send(present: int) -> None:
        arrays["stamp_ns"][...] = present
        arrays["joint_pos"][0] = present * 1e-9 % 1.0
        publish_imu(imu.encode())
        publish_state(states.encode())

    _beat(options.state_rate, stop, waiter.wait, receive, send)
    waiter.close()


def _observe(options: argparse.Namespace, node: Node, stop: Stop, log: Log) -> None:
    """Receive the mirror into states, behind one wait set."""
    entry = joint_states_entry(MIRROR, options.best_effort)
    (spec,) = parse_map(f"subscribe:\n{entry}").subscribe
    joints = ("joint_pos", "joint_vel", "joint_effort")
    arrays = {name: np.zeros(options.joints, np.float32) for name in joints}
    stamp = {"stamp_ns": np.zeros((), np.int64)}
    decoder = Decoder.build(
        spec, arrays | stamp, None, {"joint_names": joint_names(options.joints)}
    )
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


class Made:
    """When the latest states were made, by the position that tells their number in [rad]."""

    def __init__(self) -> None:
        self._stamps = np.zeros(WINDOW, np.int64)
        self._number = 0

    def add(self, stamp: int) -> float:
        """Note when a state is made, in [ns]; return the position that it has to tell."""
        self._number = (self._number + 1) % WINDOW
        self._stamps[self._number] = stamp
        return self._number / WINDOW

    def when(self, position: float) -> int:
        """Return when the state was made that told this position; 0 where it is of no state."""
        number = position * WINDOW
        if not (0.0 <= number < WINDOW and number == int(number)):
            return 0
        return int(self._stamps[int(number)])


def _serve_unitree(options: argparse.Namespace, stop: Stop, log: Log) -> None:
    """Send states at `--state-rate` and note commands; the variant is the robot."""
    robot = load_robot(options.variant)
    states = States(standard_states(robot.joint_names))
    states["base_quat"][...] = (1, 0, 0, 0)
    states["base_lin_acc"][...] = (0, 0, 9.81)
    made = Made()
    served = find_factory("faces", "unitree_go", UniconError)(
        states, robot, address="127.0.0.1", domain=int(os.environ["ROS_DOMAIN_ID"]), mode=""
    )
    stamp = np.frombuffer(served.remote, np.int64)
    position, target = states["joint_pos"], states["joint_pos_target"]

    def receive(received: int) -> None:
        if served.hear() and (answered := made.when(float(target[0]))):
            log.add(answered, received)

    def send(present: int) -> None:
        stamp[0] = present
        position[0] = made.add(present)
        served.tell()

    _beat(options.state_rate, stop, served.wait, receive, send)
    served.close()


if __name__ == "__main__":
    main()
