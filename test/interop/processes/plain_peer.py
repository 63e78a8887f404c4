"""A plain rclpy process that does what it is told by JSON lines on stdin; nothing of ours in it.

{"subscribe": "/topic", "type": "pkg/msg/Type"}      then prints each message it hears
{"publish": "/topic", "type": "pkg/msg/Type", "message": {…}}
{"raw": "/topic", "type": "pkg/msg/Type", "hex": "00010000…"}   publishes these bytes
"""

import importlib
import json
import queue
import sys
import threading

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.qos import QoSProfile, ReliabilityPolicy


def class_of(name):
    package, kind, short = name.split("/")
    return getattr(importlib.import_module(f"{package}.{kind}"), short)


def plain(value):
    """Return a message as dicts, lists, numbers and texts."""
    if hasattr(value, "get_fields_and_field_types"):
        return {name: plain(getattr(value, name)) for name in value.get_fields_and_field_types()}
    if isinstance(value, bytes):
        return value[0] if len(value) == 1 else list(value)
    if hasattr(value, "tolist"):  # array.array and numpy.ndarray
        return value.tolist()
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    return value


def fill(message, values):
    """Write nested values into a message."""
    kinds = message.get_fields_and_field_types()
    for name, value in values.items():
        kind = kinds[name]
        if isinstance(value, dict):
            fill(getattr(message, name), value)
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            items = getattr(message, name)
            if kind.startswith("sequence<"):
                package, short = kind[9:].rstrip(">").split(",")[0].split("/")
                items = [class_of(f"{package}/msg/{short}")() for _ in value]
            for item, part in zip(items, value):
                fill(item, part)
            setattr(message, name, items)
        elif kind == "octet":
            setattr(message, name, bytes([value]))
        else:
            setattr(message, name, value)
    return message


def main():
    rclpy.init()
    node = rclpy.create_node("plain_peer")
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    publishers = {}
    loose = QoSProfile(depth=50, reliability=ReliabilityPolicy.BEST_EFFORT)

    def say(**values):
        print(json.dumps(values), flush=True)

    def act(order):
        if "subscribe" in order:
            topic = order["subscribe"]
            node.create_subscription(
                class_of(order["type"]),
                topic,
                lambda message: say(kind="heard", topic=topic, message=plain(message)),
                loose,
            )
            return
        topic = order.get("publish") or order["raw"]
        if topic not in publishers:
            publishers[topic] = node.create_publisher(class_of(order["type"]), topic, 10)
        if "hex" in order:
            publishers[topic].publish(bytes.fromhex(order["hex"]))
        else:
            publishers[topic].publish(fill(class_of(order["type"])(), order["message"]))

    orders = queue.SimpleQueue()

    def read():
        for line in sys.stdin:
            orders.put(json.loads(line))
        orders.put(None)

    reader = threading.Thread(target=read, daemon=True)
    reader.start()
    say(kind="ready")
    try:
        while True:
            executor.spin_once(0.01)
            while not orders.empty():
                order = orders.get()
                if order is None:
                    return
                act(order)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        executor.shutdown()
        node.destroy_node()
        rclpy.try_shutdown()


main()
