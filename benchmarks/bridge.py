"""`unicon bench bridge`: what a message costs the tick, ours beside plain rclpy, in one process.

Send: states to a published message, by our compiled layouts and by a new rclpy message each time.
Receive: a message that has arrived to states, raw and typed. Warm, variants in turns. Nobody
listens to what is sent, so that the transport, which is the same for both, is left out; what is
received was published in this process and waits in the readers' queues, ten messages of ten topics
in a row.
"""

from __future__ import annotations

import numpy as np

from benchmarks.bridge_topics import RECEIVED, Desk, Received
from benchmarks.samples import Samples, timed
from unicon_ros import compat
from unicon_ros.bench.domains import stay_on_loopback
from unicon_ros.bench.report import Bench

JOINTS = 20
FEW, MANY = 12, 64  # joints that `send_growth` compares
SAMPLES = 200  # of each case in each round
SENDS = 20  # messages in one sample of a send: a clock reading costs 1 % of one then
POLLS = 20  # empty looks in one sample


def run(rounds: int | None = None) -> Bench:
    """Run the comparison.

    Args:
        rounds: interleaved rounds, 9 unless told.

    Raises:
        MissingDependencyError: rclpy is not installed.
    """
    stay_on_loopback()
    rclpy = compat.import_rclpy("unicon bench bridge")
    bench = Bench("bridge", rounds or 9)
    context = rclpy.context.Context()
    rclpy.init(context=context, signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
    node = rclpy.node.Node("bench_bridge", context=context)
    # What spin_once(0) costs grows with all that a node has: a node of one subscription is spun.
    other = rclpy.node.Node("bench_plain", context=context)
    executor = rclpy.executors.SingleThreadedExecutor(context=context)
    executor.add_node(other)
    message = compat.message_class("sensor_msgs/msg/JointState")
    other.create_subscription(message, "bench/silent", lambda m: None, 1)
    desk = Desk(node, executor)
    try:
        _measure(bench, desk)
    finally:
        desk.close()
        executor.shutdown()
        other.destroy_node()
        node.destroy_node()
        rclpy.try_shutdown(context=context)
    return bench


def _measure(bench: Bench, desk: Desk) -> None:
    sends = {
        f"send {name}: {who}": step
        for name, topic in (("JointState", "joint_states"), ("Imu", "imu/data"), ("Odom", "odom"))
        for who, step in desk.senders(topic, JOINTS).items()
    }
    for joints in (FEW, MANY):
        sends[f"send JointState, {joints} joints"] = desk.senders("joint_states", joints)["ours"]
    looks = {"empty poll: ours": desk.poller(), "empty poll: spin_once(0)": desk.spin}
    receive = desk.receivers(JOINTS)
    times = Samples()
    for each in (Samples(), *[times] * bench.rounds):  # the first warms up
        each.take(sends, SAMPLES, SENDS)
        each.take(looks, SAMPLES, POLLS)
        _take_received(each, receive)
    times.add_to(bench)
    ratio = times.ratio
    bench.ratio("send", ratio("send JointState: ours", "send JointState: new message"), 0.3)
    bench.ratio("receive", ratio("receive JointState: ours", "receive JointState: typed"), 0.3)
    bench.ratio("imu_send", ratio("send Imu: ours", "send Imu: new message"), 0.5)
    bench.ratio("odometry_send", ratio("send Odom: ours", "send Odom: new message"), 0.5)
    few, many = (f"send JointState, {joints} joints" for joints in (FEW, MANY))
    bench.ratio("send_growth", ratio(many, few), 1.15)
    bench.ratio("empty_poll", ratio("empty poll: ours", "empty poll: spin_once(0)"), 0.1)
    bench.facts["joints"] = JOINTS


def _take_received(times: Samples, cases: dict[str, Received]) -> None:
    """Time one round of steps that take messages, each after they arrived, in turns."""
    taken = {name: np.zeros(SAMPLES) for name in cases}
    for i in range(SAMPLES):
        for name, case in cases.items():
            case.arrive()
            taken[name][i] = timed(case.step) / RECEIVED
    for name, values in taken.items():
        times.add(name, values)
