"""Process of plain rclpy nodes, which spin.

`--variant` robot, controller, events, triggered, both, mirror, observer or threads: a controller
with a thread that spins, as UniCon bridges ROS, `spin_once`, then sleep. This is our own baseline
of that style: one message is taken for each pass of the spinning thread, so a queue of depth 10
stays full of old states. The loop runs at its rate beside it and sends.

The nodes are written as a good ROS 2 engineer would: reused messages, no logging, lean QoS. The
robot publishes 500 states a second and notes when commands come; the controller sends the latest
measured positions back as targets, 50 times a second (identity control q_d = q).
"""

from __future__ import annotations

import argparse
import threading
import time
from array import array
from typing import Any

import numpy as np
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Imu, JointState

from unicon_ros.bench.pipelines.log import (
    COMMAND,
    IMU,
    MIRROR,
    STATE,
    Log,
    Stop,
    arguments,
    beside,
    joint_names,
    nanoseconds,
    set_stamp,
)


def qos(best_effort: bool, depth: int = 1) -> QoSProfile:
    """Return the profile of all topics: only the latest value matters."""
    reliability = ReliabilityPolicy.BEST_EFFORT if best_effort else ReliabilityPolicy.RELIABLE
    return QoSProfile(depth=depth, reliability=reliability)


class PlainRobot(Node):
    """Publishes JointState and Imu by a timer and receives commands in a callback."""

    def __init__(self, options: argparse.Namespace, log: Log) -> None:
        super().__init__("robot")
        self.log, joints = log, options.joints
        profile = qos(options.best_effort)
        self.state_out = self.create_publisher(JointState, STATE, profile)
        self.imu_out = self.create_publisher(Imu, IMU, profile)
        zeros = array("d", [0.0] * joints)
        self.state = JointState(position=zeros, velocity=zeros, effort=zeros)
        self.state.name = joint_names(joints)
        self.imu = Imu()
        self.create_subscription(JointState, COMMAND, self.on_command, profile)
        self.create_timer(1.0 / options.state_rate, self.on_timer)

    def on_timer(self) -> None:
        now = time.time_ns()
        self.state.position[0] = now * 1e-9 % 1.0
        set_stamp(self.state.header.stamp, now)
        set_stamp(self.imu.header.stamp, now)
        self.imu_out.publish(self.imu)
        self.state_out.publish(self.state)

    def on_command(self, command: Any) -> None:
        now = time.time_ns()
        self.log.add(nanoseconds(command.header.stamp), now)


class Controller(Node):
    """Keeps the latest state and answers it when `send` is called; `log` gets the commands."""

    def __init__(self, options: argparse.Namespace, log: Log, depth: int = 1) -> None:
        super().__init__("controller")
        self.log = log
        profile = qos(options.best_effort, depth)
        self.command_out = self.create_publisher(JointState, COMMAND, profile)
        self.command = JointState(name=joint_names(options.joints))
        self.state: Any = None
        self.imu: Any = None
        self.seen_ns = 0
        self.create_subscription(JointState, STATE, self.on_state, profile)
        self.create_subscription(Imu, IMU, self.on_imu, profile)

    def on_imu(self, imu: Any) -> None:
        self.imu = imu

    def on_state(self, state: Any) -> None:
        self.seen_ns = time.time_ns()
        self.state = state

    def send(self) -> None:
        state = self.state
        if state is None:
            return
        begin = time.time_ns()
        self.command.header.stamp = state.header.stamp
        self.command.position = state.position
        self.command_out.publish(self.command)
        self.log.add(nanoseconds(state.header.stamp), self.seen_ns, begin, time.time_ns())


class PlainController(Controller):
    """Answers by a timer, or, `triggered`, with every n-th state in its callback.

    Args:
        options: of the pipeline.
        log: gets the commands.
        heard: gets all states.
    """

    def __init__(self, options: argparse.Namespace, log: Log, heard: Log) -> None:
        super().__init__(options, log)
        self.heard, self.every, self.states = heard, 0, 0
        if options.variant == "triggered":
            self.every = round(options.state_rate / options.rate)
        else:
            self.create_timer(1.0 / options.rate, self.send)

    def on_state(self, state: Any) -> None:
        super().on_state(state)
        self.heard.add(nanoseconds(state.header.stamp), self.seen_ns)
        self.states += 1
        if self.every and self.states % self.every == 0:
            self.send()


class PlainMirror(Node):
    """Copies the driver's arrays and publishes them, by a timer.

    What our mirror is beside, publisher against publisher: the same arrays and message, no control,
    no second topic, a message that is filled anew.
    """

    def __init__(self, options: argparse.Namespace, log: Log) -> None:
        super().__init__("controller")
        self.log = log
        self.out = self.create_publisher(JointState, MIRROR, qos(options.best_effort))
        self.message = JointState(name=joint_names(options.joints))
        self.driver = np.zeros((3, options.joints), np.float32)
        self.states = np.zeros_like(self.driver)
        self.create_timer(1.0 / options.state_rate, self.on_timer)

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
    """Notes in a callback when each message of the mirrored topic has come.

    Its executor alone takes longer than the message's way to it.
    """

    def __init__(self, options: argparse.Namespace, log: Log) -> None:
        super().__init__("observer")
        self.log = log
        self.create_subscription(JointState, MIRROR, self.on_message, qos(options.best_effort))

    def on_message(self, message: Any) -> None:
        received = time.time_ns()
        self.log.add(nanoseconds(message.header.stamp), received)


SPIN_PERIOD = 0.002  # s between two passes of the spinning thread


def main() -> None:
    """Run until SIGTERM."""
    options = arguments()
    rclpy.init(signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
    stop = Stop()
    nodes, logs = _nodes(options)
    executor: Any = SingleThreadedExecutor()
    if options.variant == "events":
        from rclpy.experimental import EventsExecutor

        executor = EventsExecutor()
    for node in nodes:
        executor.add_node(node)
    if isinstance(nodes[0], Controller) and options.variant == "threads":
        _send_beside(executor, nodes[0], 1.0 / options.rate, stop)
    while not stop:
        executor.spin_once(timeout_sec=0.1)
    for log in logs:
        log.save()
    for node in nodes:
        node.destroy_node()
    rclpy.try_shutdown()


def _send_beside(executor: Any, node: Controller, period: float, stop: Stop) -> None:
    """Send at a rate, beside a thread that spins, until SIGTERM."""

    def spin() -> None:
        while not stop:
            executor.spin_once(timeout_sec=0.0)
            time.sleep(SPIN_PERIOD)

    thread = threading.Thread(target=spin)
    thread.start()
    due = time.monotonic() + period
    while not stop:
        time.sleep(max(0.0, due - time.monotonic()))
        due = max(due + period, time.monotonic())
        node.send()
    thread.join()


def _nodes(options: argparse.Namespace) -> tuple[list[Node], list[Log]]:
    """Return the nodes of a variant, and their logs."""
    received, published = Log(options.out, "stamp", "received"), Log(options.out, "begin", "end")
    if options.variant == "mirror":
        return [PlainMirror(options, published)], [published]
    if options.variant == "observer":
        return [PlainObserver(options, received)], [received]
    nodes: list[Node] = []
    logs: list[Log] = []
    sent_file = options.out
    if options.variant in ("robot", "both"):
        nodes.append(PlainRobot(options, received))
        logs.append(received)
        sent_file = beside(options.out, "controller")
    if options.variant != "robot":
        sent = Log(sent_file, "stamp", "seen", "begin", "end")
        if options.variant == "threads":
            return [Controller(options, sent, depth=10)], [sent]
        heard = Log(beside(sent_file, "heard"), "stamp", "received")
        nodes.append(PlainController(options, sent, heard))
        logs += [sent, heard]
    return nodes, logs


if __name__ == "__main__":
    main()
