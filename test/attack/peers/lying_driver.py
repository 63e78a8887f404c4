"""A plain rclpy process that drives by `cmd_vel` for half a second, then sends garbage at 1 kHz.

Nothing of unicon is imported. Usage: lying_driver.py VX
"""

import json
import math
import sys
import time

import rclpy
from geometry_msgs.msg import Twist


def main() -> None:
    rclpy.init()
    node = rclpy.create_node("lying_driver")
    commands = node.create_publisher(Twist, "cmd_vel", 10)
    while commands.get_subscription_count() == 0:
        time.sleep(0.01)
    twist = Twist()
    twist.linear.x = float(sys.argv[1])
    for _ in range(25):
        commands.publish(twist)
        time.sleep(0.02)
    print(json.dumps({"kind": "garbage"}), flush=True)
    twist.linear.y = math.nan
    while True:
        commands.publish(twist)
        time.sleep(0.001)


main()
