"""A plain rclpy process: takes each message typed and publishes it again, typed.

Nothing of unicon is imported. Usage: echo.py TYPE...   The n-th type comes on `there_n` and goes
back on `back_n`.
"""

import importlib
import sys

import rclpy
from rclpy.qos import QoSProfile


def main() -> None:
    rclpy.init()
    node = rclpy.create_node("echo")
    deep = QoSProfile(depth=50)
    for number, name in enumerate(sys.argv[1:]):
        package, kind, short = name.split("/")
        message = getattr(importlib.import_module(f"{package}.{kind}"), short)
        back = node.create_publisher(message, f"back_{number}", deep)
        node.create_subscription(message, f"there_{number}", back.publish, deep)
    rclpy.spin(node)


main()
