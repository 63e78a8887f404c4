"""The bridge's topics of some message maps, on arrays: our side of the interoperability tests.

Usage: map_host.py MAP=JOINTS …  Each map lives in a namespace of its name; absolute topics are
remapped there. `{"map": …, "states": {…}}` on stdin writes states. Prints, for each topic that it
has, one line at the start, and one line with all states whenever a message was taken.
"""

from __future__ import annotations

import json
import queue
import sys
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np

from unicon_base.resources import find_config
from unicon_msgs_map import Decoder, Encoder, load_map
from unicon_ros import compat
from unicon_ros.bridge.topics import TopicIn, TopicOut

RATE = 100.0  # Hz
INTEGERS = {"stamp_ns": np.int64, "mode_machine": np.uint8, "motor_mode": np.uint8}
INTEGERS |= {"battery_level": np.int32, "driver_level": np.int32}
INTEGERS |= {"odometry_stamp_ns": np.int64}
SCALARS = ("battery_voltage", "battery_current", "battery_percentage", "temperature")
SCALARS += ("base_pos_w_variance", "base_lin_vel_variance", "odometry_stamp_ns")
SCALARS += ("ambient_temperature", "stamp_ns", "mode_machine", "battery_level", "driver_level")
SIZES = {"base_quat": 4, "mocap_quat": 4, "velocity_command": 3, "base_ang_vel": 3}
SIZES |= {"base_lin_acc": 3, "base_pos_w": 3, "base_lin_vel": 3, "mocap_pos_w": 3}
SIZES |= {"wrench": 6, "wrench_command": 6}


def say(**values: Any) -> None:
    print(json.dumps(values), flush=True)


class Map:
    """One map, its node and its arrays."""

    def __init__(self, name: str, joints: int, rclpy: Any, context: Any, group: Any) -> None:
        self.name = Path(name).stem
        mapping = load_map(find_config("maps", name))
        entries = [*mapping.publish, *mapping.subscribe]
        remaps = []
        for spec in entries:
            if spec.topic.startswith("/"):
                remaps += ["-r", f"{spec.topic}:=/{self.name}{spec.topic}"]
        node = self.node = rclpy.node.Node(
            f"host_{self.name}",
            context=context,
            namespace=f"/{self.name}",
            cli_args=["--ros-args", *remaps] if remaps else None,
            start_parameter_services=False,
        )
        self.warnings: list[str] = []
        self.arrays = {
            state: np.zeros(
                () if state in SCALARS else SIZES.get(state, joints),
                INTEGERS.get(state, np.float32),
            )
            for spec in entries
            for state in spec.states
        }
        variables: dict[str, object] = {"robot": "go2", "robot_name": "go2", "odom_frame": "odom"}
        variables |= {"base_frame": "base_link", "imu_frame": "imu_link"}
        variables["joint_names"] = [f"joint_{k}" for k in range(joints)]
        self.out: list[TopicOut] = []
        self.into: list[TopicIn] = []
        for number, spec in enumerate(entries):
            message = compat.message_class(spec.type)
            if message is None:
                say(kind="skipped", map=self.name, topic=spec.topic, type=spec.type)
                continue
            direction = "out" if number < len(mapping.publish) else "in"
            topic: Any
            if direction == "out":
                encoder = Encoder.build(mapping.publish[number], self.arrays, None, variables)
                # 10 Hz each: a state written here is soon heard, and no queue fills.
                topic = TopicOut(node, encoder, message, 10, number, group, self.warnings.append)
                self.out.append(topic)
            else:
                entry = mapping.subscribe[number - len(mapping.publish)]
                decoder = Decoder.build(entry, self.arrays, None, variables)
                topic = TopicIn(node, decoder, message, False, group, self.warnings.append)
                self.into.append(topic)
            say(kind=direction, map=self.name, name=spec.topic, topic=topic.topic, type=spec.type)
        self._seen: dict[str, tuple[Any, ...]] = {}

    def tick(self) -> None:
        for out in self.out:
            out.tick()
        for topic in self.into:
            topic.poll()
            now = (topic.received, topic.decoder.rejected, topic.stale)
            if now != self._seen.get(topic.topic, (0, 0, False)):
                self._seen[topic.topic] = now
                say(
                    kind="took",
                    topic=topic.topic,
                    received=topic.received,
                    rejected=topic.decoder.rejected,
                    stale=topic.stale,
                    error=topic.decoder.last_error,
                    warnings=list(self.warnings),
                    states={name: array.tolist() for name, array in self.arrays.items()},
                )

    def close(self) -> None:
        for topic in (*self.out, *self.into):
            topic.close()
        self.node.destroy_node()


def main() -> None:
    rclpy = compat.import_rclpy()
    context = rclpy.context.Context()
    rclpy.init(context=context, signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
    group = compat.polled_group()
    pairs = [word.partition("=") for word in sys.argv[1:]]
    maps = {
        (made := Map(name, int(joints), rclpy, context, group)).name: made
        for name, _, joints in pairs
    }
    orders: queue.SimpleQueue[dict[str, Any] | None] = queue.SimpleQueue()

    def read() -> None:
        for line in sys.stdin:
            orders.put(json.loads(line))
        orders.put(None)

    threading.Thread(target=read, daemon=True).start()
    say(kind="ready")
    while True:
        time.sleep(1.0 / RATE)
        while not orders.empty():
            order = orders.get()
            if order is None:
                for each in maps.values():
                    each.close()
                rclpy.try_shutdown(context=context)
                return
            for state, value in order["states"].items():
                maps[order["map"]].arrays[state][...] = value
        for each in maps.values():
            each.tick()


main()
