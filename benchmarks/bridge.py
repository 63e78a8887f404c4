"""`unicon bench bridge`: what a message costs the tick, ours beside plain rclpy, in one process.

Send: states to a published message, by our compiled layouts and by a new rclpy message each time.
Receive: a message that has arrived to states, raw and typed. Warm, variants in turns. Nobody
listens to what is sent, so that the transport, which is the same for both, is left out; what is
received was published in this process and waits in the readers' queues, ten messages of ten topics
in a row.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from itertools import count
from typing import Any

import numpy as np

from benchmarks.samples import Samples, Step, timed
from unicon_base import UniconError
from unicon_base.arrays import Array, Float32
from unicon_base.resources import find_config
from unicon_core.states import States, standard_states
from unicon_msgs_map import Decoder, Encoder, PublishSpec, SubscribeSpec, load_map
from unicon_ros import compat
from unicon_ros.bench.pipelines.log import joint_names
from unicon_ros.bench.report import Bench, stay_on_loopback
from unicon_ros.bridge.topics import TopicIn, TopicOut

JOINTS = 20
SAMPLES = 200  # of each case in each round
SENDS = 20  # messages in one sample of a send: a clock reading costs 1 % of one then
POLLS = 20  # empty looks in one sample

JOINT_STATE = "sensor_msgs/msg/JointState"
WAIT = 5.0  # s for a reader and a writer of one process to find each other

RECEIVED = 10
"""Topics that are received from in a row: the first evicts what publishing left in the caches."""


def run(rounds: int = 9) -> Bench:
    """Run the comparison.

    Args:
        rounds: interleaved rounds.

    Raises:
        MissingDependencyError: rclpy is not installed.
    """
    stay_on_loopback()
    rclpy = compat.import_rclpy("unicon bench bridge")
    bench = Bench("bridge", rounds)
    context = rclpy.context.Context()
    rclpy.init(context=context, signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
    node = rclpy.node.Node("bench_bridge", context=context)
    # What spin_once(0) costs grows with all that a node has: a node of one subscription is spun.
    other = rclpy.node.Node("bench_plain", context=context)
    executor = rclpy.executors.SingleThreadedExecutor(context=context)
    executor.add_node(other)
    message = compat.message_class(JOINT_STATE)
    other.create_subscription(message, "bench/silent", lambda m: None, 1)
    desk = Desk(node)
    try:
        _measure(bench, desk, partial(executor.spin_once, 0.0))
    finally:
        desk.close()
        executor.shutdown()
        other.destroy_node()
        node.destroy_node()
        rclpy.try_shutdown(context=context)
    return bench


def _measure(bench: Bench, desk: Desk, spin: Step) -> None:
    sends = {
        f"send {name}: {who}": step
        for name, topic in (("JointState", "joint_states"), ("Imu", "imu/data"), ("Odom", "odom"))
        for who, step in desk.senders(topic, JOINTS).items()
    }
    for joints in (12, 64):  # which `send_growth` compares
        sends[f"send JointState, {joints} joints"] = desk.senders("joint_states", joints)["ours"]
    looks = {"empty poll: ours": desk.poller(), "empty poll: spin_once(0)": spin}
    receive = desk.receivers()
    times = Samples()
    for each in (Samples(), *[times] * bench.rounds):  # the first warms up
        each.take(sends, SAMPLES, SENDS)
        each.take(looks, SAMPLES, POLLS)
        _take_received(each, receive)
    times.add_to(bench)
    bench.facts["joints"] = JOINTS


Received = tuple[Step, Step]
"""One way to receive: what makes a message arrive, and what is timed."""


def _take_received(times: Samples, cases: dict[str, Received]) -> None:
    """Time one round of steps that take messages, each after they arrived, in turns."""
    taken = {name: np.zeros(SAMPLES) for name in cases}
    for i in range(SAMPLES):
        for name, (arrive, step) in cases.items():
            arrive()
            taken[name][i] = timed(step) / RECEIVED
    for name, values in taken.items():
        times.add(name, values)


class Desk:
    """Makes the topics that are compared, and takes them down."""

    def __init__(self, node: Any) -> None:
        self._node = node
        self._group = compat.polled_group()
        self._opened = ExitStack()
        self._numbers = count()

    def close(self) -> None:
        """Take all topics down."""
        self._opened.close()

    def senders(self, topic: str, joints: int) -> dict[str, Step]:
        """Return `ours` and `new message` of a topic of the default map."""
        states = bench_states(joints)
        (spec,) = [s for s in load_map(find_config("maps", "default")).publish if s.topic == topic]
        return {
            "ours": self._out(replace(spec, topic=self._name()), states, joints),
            "new message": self._plain(spec.type, self._name(), states, joints),
        }

    def receivers(self) -> dict[str, Received]:
        """Return our and the typed way to receive joint states, from `RECEIVED` topics each."""
        states, source = bench_states(JOINTS), bench_states(JOINTS)
        spec = load_map(find_config("maps", "joint_state_in")).subscribe[0]
        spec = replace(spec, timeout=None)
        cases = {}
        for name in ("ours", "typed"):
            singles = []
            for _ in range(RECEIVED):
                topic = self._name()
                arrive = self._feed(topic, source)
                step = (
                    self._in(replace(spec, topic=topic), states)
                    if name == "ours"
                    else self._typed(topic, states)
                )
                _meet(arrive, step, states, source)
                singles.append((arrive, step))
            arrive, step = map(_all, zip(*singles))
            cases[f"receive JointState: {name}"] = arrive, step
        return cases

    def poller(self) -> Step:
        """Return our look at a topic on which nothing comes."""
        spec = load_map(find_config("maps", "joint_state_in")).subscribe[0]
        return self._in(replace(spec, topic=self._name()), bench_states(JOINTS))

    def _name(self) -> str:
        return f"bench/topic_{next(self._numbers)}"

    def _out(self, spec: PublishSpec, states: States, joints: int) -> Step:
        encoder = Encoder.build(spec, arrays_of(states), None, variables_of(joints))
        message = compat.message_class(spec.type)
        out = TopicOut(self._node, encoder, message, 1, 0, self._group, print)
        self._opened.callback(out.close)
        return out.tick

    def _plain(self, kind: str, topic: str, states: States, joints: int, depth: int = 10) -> Step:
        make = plain_sender(kind, states, joints)
        publisher = self._node.create_publisher(compat.message_class(kind), topic, depth)
        self._opened.callback(self._node.destroy_publisher, publisher)
        return lambda: publisher.publish(make())

    def _in(self, spec: SubscribeSpec, states: States) -> Step:
        decoder = Decoder.build(spec, arrays_of(states), None, variables_of(JOINTS))
        message = compat.message_class(spec.type)
        topic = TopicIn(self._node, decoder, message, False, self._group, print)
        self._opened.callback(topic.close)
        return topic.poll

    def _feed(self, topic: str, source: States) -> Step:
        position = source["joint_pos"]
        publish = self._plain(JOINT_STATE, topic, source, len(position), depth=1)

        def arrive() -> None:
            position[0] += 1.0
            publish()

        return arrive

    def _typed(self, topic: str, states: States) -> Step:
        message = compat.message_class(JOINT_STATE)
        subscription = self._node.create_subscription(
            message, topic, lambda m: None, 1, callback_group=self._group
        )
        self._opened.callback(self._node.destroy_subscription, subscription)
        handle = subscription.handle
        arrays = states["joint_pos"], states["joint_vel"], states["joint_effort"]
        stamp = states["stamp_ns"]

        def receive() -> None:
            with handle:
                taken = handle.take_message(message, False)
            if taken is not None:
                found = taken[0]
                time_ = found.header.stamp
                stamp[...] = time_.sec * 1_000_000_000 + time_.nanosec
                arrays[0][:] = found.position
                arrays[1][:] = found.velocity
                arrays[2][:] = found.effort

        return receive


def _all(steps: Iterable[Step]) -> Step:
    def run() -> None:
        for step in steps:
            step()

    return run


def _meet(arrive: Step, step: Step, states: States, source: States) -> None:
    """Try until a message gets through: reader and writer have found each other then."""
    end = time.monotonic() + WAIT
    while time.monotonic() < end:
        arrive()
        time.sleep(0.01)
        step()
        if states["joint_pos"][0] == source["joint_pos"][0]:
            return
    raise UniconError(f"no message came within {WAIT:g} s in this process; try again")


def bench_states(joints: int) -> States:
    """Return the states that the messages carry, filled."""
    states = States(standard_states(joint_names(joints)))
    generator = np.random.default_rng(0)
    for name in states:
        if states[name].dtype == np.float32:
            states[name][...] = generator.uniform(-1.0, 1.0, states[name].shape)
    states["stamp_ns"][...] = 1_234_567_890
    return states


def arrays_of(states: States) -> dict[str, Array]:
    """Return the states as the message map wants them."""
    return {name: states[name] for name in states}


def variables_of(joints: int) -> dict[str, object]:
    """Return the `$variables` of the maps."""
    frames = {"base_frame": "base_link", "odom_frame": "odom", "imu_frame": "imu_link"}
    return {"joint_names": joint_names(joints), "robot": "bench", **frames}


def plain_sender(kind: str, states: States, joints: int) -> Callable[[], Any]:
    """Return what makes a new message of the states, as plain nodes do in each tick."""
    make = compat.message_class(kind)
    stamp_ns = states["stamp_ns"]
    names = joint_names(joints)
    quat, turn = states["base_quat"], states["base_ang_vel"]
    # The default map's, made once.
    of_orientation, of_turn, of_acceleration = (
        np.diag(variances).ravel() for variances in ([1e-4, 1e-4, 1e-2], [4e-4] * 3, [9e-2] * 3)
    )
    of_truth = np.diag([1e-6] * 6).ravel()

    def stamped() -> Any:
        message = make()
        stamp = message.header.stamp
        stamp.sec, stamp.nanosec = divmod(int(stamp_ns), 1_000_000_000)
        return message

    def joint_state() -> Any:
        message = stamped()
        message.name = names
        message.position = states["joint_pos"].tolist()
        message.velocity = states["joint_vel"].tolist()
        message.effort = states["joint_effort"].tolist()
        return message

    def imu() -> Any:
        message = stamped()
        message.header.frame_id = "imu_link"
        _fill(message.orientation, "wxyz", quat)
        _fill(message.angular_velocity, "xyz", turn)
        _fill(message.linear_acceleration, "xyz", states["base_lin_acc"])
        message.orientation_covariance = of_orientation
        message.angular_velocity_covariance = of_turn
        message.linear_acceleration_covariance = of_acceleration
        return message

    def odometry() -> Any:
        message = stamped()
        message.header.frame_id = "odom"
        message.child_frame_id = "base_link"
        _fill(message.pose.pose.position, "xyz", states["base_pos_w"])
        _fill(message.pose.pose.orientation, "wxyz", quat)
        _fill(message.twist.twist.linear, "xyz", states["base_lin_vel"])
        _fill(message.twist.twist.angular, "xyz", turn)
        message.pose.covariance = message.twist.covariance = of_truth
        return message

    return {"JointState": joint_state, "Imu": imu, "Odometry": odometry}[kind.rpartition("/")[2]]


def _fill(owner: Any, axes: str, values: Float32) -> None:
    for axis, value in zip(axes, values.tolist()):
        setattr(owner, axis, value)
