"""A plain rclpy process: prints what it hears on /tf and /tf_static as JSON lines."""

import json

import rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile
from tf2_msgs.msg import TFMessage


def main() -> None:
    rclpy.init()
    node = rclpy.create_node("tf_listener")

    def say(kind: str, message: TFMessage) -> None:
        for one in message.transforms:
            at, turn = one.transform.translation, one.transform.rotation
            line = {
                "kind": kind,
                "stamp": one.header.stamp.sec * 1_000_000_000 + one.header.stamp.nanosec,
                "parent": one.header.frame_id,
                "child": one.child_frame_id,
                "at": [at.x, at.y, at.z],
                "wxyz": [turn.w, turn.x, turn.y, turn.z],
            }
            print(json.dumps(line), flush=True)

    node.create_subscription(TFMessage, "/tf", lambda m: say("tf", m), 100)
    latched = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    node.create_subscription(TFMessage, "/tf_static", lambda m: say("static", m), latched)
    rclpy.spin(node)


main()
