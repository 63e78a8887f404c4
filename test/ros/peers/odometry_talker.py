"""A plain rclpy process: odometry of a camera that moves at 0.5 m/s, for a while, then silence.

Nothing of unicon is imported. Usage: odometry_talker.py SECONDS
"""

import json
import sys
import time

import rclpy
from nav_msgs.msg import Odometry

RATE = 50.0


def main() -> None:
    rclpy.init()
    node = rclpy.create_node("camera")
    out = node.create_publisher(Odometry, "odom", 10)
    print(json.dumps({"kind": "ready"}), flush=True)
    while not out.get_subscription_count():
        time.sleep(0.05)
    begin = time.monotonic()
    message = Odometry()
    message.header.frame_id, message.child_frame_id = "odom", "trunk"
    message.twist.twist.linear.x = 0.5
    while (passed := time.monotonic() - begin) < float(sys.argv[1]):
        message.header.stamp = node.get_clock().now().to_msg()
        message.pose.pose.position.x = 0.5 * passed
        out.publish(message)
        time.sleep(1.0 / RATE)
    print(json.dumps({"kind": "silent"}), flush=True)
    rclpy.spin(node)


main()
