"""Prints what bytes it takes from a topic, by a class made of the definition: TOPIC TYPE [latched].

Beside each: the hash that the publisher told, and that of the subscription.
"""

import json
import sys

import rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile

from unicon_msgs_map import Messages
from unicon_ros import compat


def main() -> None:
    topic, kind, *latched = sys.argv[1:]
    rclpy.init()
    node = rclpy.create_node("raw_listener")
    durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
    profile = QoSProfile(depth=100, durability=durability)

    def say(raw: bytes) -> None:
        told = node.get_publishers_info_by_topic(topic)
        heard = node.get_subscriptions_info_by_topic(topic)
        hashes = [str(info.topic_type_hash) for info in (*told, *heard)]
        types = [info.topic_type for info in (*told, *heard)]
        line = {"kind": topic, "raw": raw.hex(), "hashes": hashes, "types": types}
        print(json.dumps(line), flush=True)

    made = compat.bytes_class(kind, Messages())
    node.create_subscription(made, topic, say, profile, raw=True)
    print(json.dumps({"kind": "ready"}), flush=True)
    rclpy.spin(node)


main()
