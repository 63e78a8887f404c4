"""A plain rclpy process that drives along a square, closed on `odom`, with commands that step.

As Nav2's rotation shim and regulated pure pursuit do: it turns on the spot where the way is not
ahead, and walks towards a point of the way ahead of it; either at one speed, for a policy stands
still under a slow command. At the end it says zero once and falls silent.

Nothing of unicon is imported. Usage: square_driver.py SIDE
"""

import json
import math
import sys

import rclpy
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry

RATE = 20.0
SPEED, TURN = 0.5, 0.8  # m/s, rad/s
AHEAD, NEAR = 0.5, 0.35  # m: the point that is walked to, and where a corner is reached
ASTRAY, ALIGNED = 0.7, 0.2  # rad: from where on it turns on the spot, and until when


def say(kind: str, **values: object) -> None:
    print(json.dumps({"kind": kind, **values}), flush=True)


class Driver:
    def __init__(self, node: object, side: float) -> None:
        self.corners = [(0.0, 0.0), (side, 0.0), (side, side), (0.0, side), (0.0, 0.0)]
        self.pose, self.turning = None, True
        node.create_subscription(Odometry, "odom", self.hear, 1)
        self.out = node.create_publisher(Twist, "cmd_vel_nav", 1)
        node.create_timer(1.0 / RATE, self.drive)

    def hear(self, odometry: Odometry) -> None:
        at, q = odometry.pose.pose.position, odometry.pose.pose.orientation
        yaw = math.atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z))
        variances = odometry.pose.covariance[0], odometry.twist.covariance[0]
        self.pose = at.x, at.y, yaw, *variances

    def drive(self) -> None:
        if self.pose is None or self.done:
            return
        x, y, yaw, of_place, of_velocity = self.pose
        (bx, by), (ex, ey) = self.corners[:2]
        side = math.hypot(ex - bx, ey - by)
        ux, uy = (ex - bx) / side, (ey - by) / side
        along = (x - bx) * ux + (y - by) * uy
        if along > side - NEAR:
            say("corner", at=[x, y], of_place=of_place, of_velocity=of_velocity)
            self.corners.pop(0)
            self.turning = True
            if self.done:
                self.out.publish(Twist())
            return
        ahead = min(max(along, 0.0) + AHEAD, side)
        off = math.atan2(by + ahead * uy - y, bx + ahead * ux - x) - yaw
        off = math.remainder(off, 2.0 * math.pi)
        self.turning = abs(off) > (ALIGNED if self.turning else ASTRAY)
        twist = Twist()
        if self.turning:
            twist.angular.z = math.copysign(TURN, off)
        else:
            twist.linear.x, twist.angular.z = SPEED, max(-TURN, min(TURN, 1.5 * off))
        self.out.publish(twist)

    @property
    def done(self) -> bool:
        return len(self.corners) < 2


def main() -> None:
    rclpy.init()
    node = rclpy.create_node("square_driver")
    driver = Driver(node, float(sys.argv[1]))
    say("ready")
    while not driver.done:
        rclpy.spin_once(node)
    say("done")
    rclpy.spin(node)


main()
