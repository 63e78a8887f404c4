"""A plain rclpy process: prints the frames of a robot's odometry and IMU as JSON lines.

Nothing of unicon is imported. Usage: frame_watcher.py NAMESPACE
"""

import json
import sys

import rclpy
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Imu


def main() -> None:
    rclpy.init()
    node = rclpy.create_node("watcher")

    def say(kind: str, *frames: str) -> None:
        print(json.dumps({"kind": kind, "frames": frames}), flush=True)

    def on_odometry(message: Odometry) -> None:
        say("odom", message.header.frame_id, message.child_frame_id)

    node.create_subscription(Odometry, f"{sys.argv[1]}/odom", on_odometry, 10)
    node.create_subscription(
        Imu, f"{sys.argv[1]}/imu/data", lambda m: say("imu", m.header.frame_id), 10
    )
    rclpy.spin(node)


main()
