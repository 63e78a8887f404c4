"""A plain rclpy process that comes, looks on, commands a velocity when it is told to, and leaves.

Nothing of unicon is imported. On standard input it hears lines: `say VX` publishes that velocity
50 times a second (`nan` and `1e30`, too), `silent` stops that, `leave` ends. It answers each with
a JSON line once it is done, with the time of `time.monotonic` and how much it has published.
"""

import json
import sys
import threading
import time

import rclpy
from geometry_msgs.msg import Twist
from rclpy.executors import ExternalShutdownException
from sensor_msgs.msg import JointState


def main() -> None:
    rclpy.init()
    node = rclpy.create_node(f"passer_by_{time.monotonic_ns()}")
    publisher = node.create_publisher(Twist, "cmd_vel", 10)
    node.create_subscription(JointState, "joint_commands", lambda message: None, 10)
    said: list[Twist] = []
    words: list[str] = []
    count = 0

    def tell(kind: str) -> None:
        print(json.dumps({"kind": kind, "at": time.monotonic(), "count": count}), flush=True)

    def tick() -> None:
        nonlocal count
        while words:
            word, *values = words.pop(0).split()
            said.clear()
            if word == "leave":
                tell(word)
                raise ExternalShutdownException
            if word == "say":
                twist = Twist()
                twist.linear.x = float(values[0])
                said.append(twist)
            tell(word)
        for twist in said:
            publisher.publish(twist)
            count += 1

    def listen() -> None:
        while line := sys.stdin.readline():
            words.append(line)

    threading.Thread(target=listen, daemon=True).start()
    node.create_timer(0.02, tick)
    tell("ready")
    try:
        rclpy.spin(node)
    except ExternalShutdownException:
        node.destroy_node()
        rclpy.try_shutdown()


main()
