"""Another process of the workspace: tells the head where to look, prints where it looks.

PAN TILT in [rad]. The type is the installed package's, without generated code.
"""

from __future__ import annotations

import json
import sys

import rclpy

from unicon_msgs_map import Messages
from unicon_ros import compat

KIND = "pan_tilt/msg/Gaze"


def main() -> None:
    pan, tilt = map(float, sys.argv[1:])
    messages = Messages()
    messages.struct(KIND)  # finds it on the ament path
    store = messages.store
    rclpy.init()
    node = rclpy.create_node("gaze_peer")
    made = compat.bytes_class(KIND, messages)
    types = store.types
    stamp = types["builtin_interfaces/msg/Time"](sec=0, nanosec=0)
    header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="base_link")
    wanted = bytes(store.serialize_cdr(types[KIND](header=header, pan=pan, tilt=tilt), KIND))
    publisher = node.create_publisher(made, "look_at", 1)
    node.create_timer(0.1, lambda: publisher.publish(wanted))

    def say(raw: bytes) -> None:
        gaze = store.deserialize_cdr(raw, KIND)
        line = {"kind": "gaze", "frame": gaze.header.frame_id, "pan": gaze.pan, "tilt": gaze.tilt}
        print(json.dumps(line), flush=True)

    node.create_subscription(made, "gaze", say, 10, raw=True)
    rclpy.spin(node)


main()
