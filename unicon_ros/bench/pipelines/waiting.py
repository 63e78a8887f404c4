"""Process of the strongest plain controllers: one wait set, made once, and `take_message`.

`--variant` typed or raw. Neither spins an executor: the node waits for a state, takes it, and
answers each n-th. `typed` takes and publishes messages. `raw` takes bytes, reads stamp and
positions of a state that it answers at their places in the CDR stream, and writes both into the
bytes of a command that was serialized once. Both hear states with best effort, as ours do, and no
IMU, which ours take in. Garbage is collected before the loop begins, and what is there then is
frozen.
"""

from __future__ import annotations

import gc
import struct
import time
from collections.abc import Callable
from typing import Any

import rclpy
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState

from unicon_ros.bench.pipelines.log import (
    COMMAND,
    STATE,
    Log,
    Stop,
    arguments,
    beside,
    joint_names,
    nanoseconds,
)
from unicon_ros.bench.pipelines.plain import qos

LONGEST_NS = 100_000_000
"""Longest wait in [ns], so that SIGTERM is heard."""

Answer = Callable[[Any], int]
"""Publishes the answer to a state; returns the state's stamp in [ns]."""

_STAMP = struct.Struct("<iI")
"""Of a serialized message that begins with a header: behind the four bytes of the encapsulation."""


def main() -> None:
    """Run until SIGTERM."""
    options = arguments()
    rclpy.init(signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
    stop, node, raw = Stop(), Node("controller"), options.variant == "raw"
    sent = Log(options.out, "stamp", "seen", "begin", "end")
    heard = Log(beside(options.out, "heard"), "stamp", "received")
    state = node.create_subscription(
        JointState, STATE, lambda message: None, qos(best_effort=True), raw=raw
    )
    publisher = node.create_publisher(JointState, COMMAND, qos(options.best_effort))
    answer = (raw_answer if raw else typed_answer)(publisher.handle, options.joints)
    every, count, now = round(options.state_rate / options.rate), 0, time.time_ns
    with node.context.handle, state.handle, publisher.handle:
        waiting = rclpy_implementation.WaitSet(1, 0, 0, 0, 0, 0, node.context.handle)
        gc.collect()
        gc.freeze()
        while not stop:
            waiting.clear_entities()
            waiting.add_subscription(state.handle)
            waiting.wait(LONGEST_NS)
            taken = state.handle.take_message(JointState, raw)
            if taken is None:
                continue
            seen, message = now(), taken[0]
            count += 1
            if count % every == 0:
                begin = now()
                stamp = answer(message)
                sent.add(stamp, seen, begin, now())
            heard.add(stamp_of(message) if raw else nanoseconds(message.header.stamp), seen)
    sent.save()
    heard.save()
    node.destroy_node()
    rclpy.try_shutdown()


def stamp_of(raw: bytes) -> int:
    """Return the header's stamp of a serialized message in [ns]."""
    seconds, nanosecond = _STAMP.unpack_from(raw, 4)
    return int(seconds) * 1_000_000_000 + int(nanosecond)


def typed_answer(publisher: Any, joints: int) -> Answer:
    """Return what answers a JointState of so many joints by a message that is reused."""
    command = JointState(name=joint_names(joints))
    publish = publisher.publish

    def answer(state: Any) -> int:
        command.header.stamp = state.header.stamp
        command.position = state.position
        publish(command)
        return nanoseconds(state.header.stamp)

    return answer


def raw_answer(publisher: Any, joints: int) -> Answer:
    """Return what answers a serialized JointState by bytes of which stamp and positions change.

    The state's names are `joint_0` and so on, and its frame is empty, as the benchmark's robots
    have them: its positions lie at a place that is known before.
    """
    marks = [float(i) + 0.5 for i in range(joints)]
    positions = struct.Struct(f"<{joints}d")
    made = JointState(name=joint_names(joints), position=marks)
    command = bytearray(serialize_message(made))
    place = command.index(positions.pack(*marks))
    publish = publisher.publish_raw

    def answer(state: bytes) -> int:
        command[4:12] = state[4:12]
        positions.pack_into(command, place, *positions.unpack_from(state, place))
        publish(bytes(command))
        return stamp_of(state)

    return answer


if __name__ == "__main__":
    main()
