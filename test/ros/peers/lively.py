"""A plain rclpy process: publishes velocity commands and offers a liveliness lease.

Nothing of unicon is imported. Usage: lively.py LEASE   with the lease in [s].
"""

import sys

import rclpy
from geometry_msgs.msg import Twist
from rclpy.duration import Duration
from rclpy.qos import QoSProfile


def main() -> None:
    rclpy.init()
    node = rclpy.create_node("lively")
    lease = Duration(nanoseconds=round(float(sys.argv[1]) * 1e9))
    publisher = node.create_publisher(
        Twist, "cmd_vel", QoSProfile(depth=1, liveliness_lease_duration=lease)
    )
    node.create_timer(0.05, lambda: publisher.publish(Twist()))
    rclpy.spin(node)


main()
