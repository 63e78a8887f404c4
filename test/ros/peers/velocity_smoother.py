"""A plain rclpy process that behaves as Nav2's velocity smoother does, open loop.

After nav2_velocity_smoother's documentation: `cmd_vel` comes in (here `cmd_vel_nav`), at a rate of
its own a command goes out that nears it by at most `max_accel`, or `max_decel` where it slows down,
all axes by the same share so that the direction stays; below the deadband it is zero. After
`velocity_timeout` without a command it slows down to zero, and then falls silent.

Nothing of unicon is imported. Usage: velocity_smoother.py
"""

import json
import time

import rclpy
from geometry_msgs.msg import Twist

RATE = 20.0
MAX_VELOCITY, MIN_VELOCITY = (0.5, 0.2, 0.8), (-0.5, -0.2, -0.8)
MAX_ACCEL, MAX_DECEL = (1.0, 0.5, 2.0), (-1.5, -0.8, -3.0)
DEADBAND = (0.02, 0.02, 0.02)
TIMEOUT = 1.0


class Smoother:
    def __init__(self, node: object) -> None:
        self.wanted = self.last = (0.0, 0.0, 0.0)
        self.heard, self.stopped, self.sent = 0.0, True, 0
        node.create_subscription(Twist, "cmd_vel_nav", self.hear, 1)
        self.out = node.create_publisher(Twist, "cmd_vel", 1)
        node.create_timer(1.0 / RATE, self.tell)

    def hear(self, twist: Twist) -> None:
        self.wanted = (twist.linear.x, twist.linear.y, twist.angular.z)
        self.heard, self.stopped = time.monotonic(), False

    def tell(self) -> None:
        if self.stopped:
            return
        if time.monotonic() - self.heard > TIMEOUT:
            if not any(self.last):
                self.stopped = True
                return
            self.wanted = (0.0, 0.0, 0.0)
        limits = zip(self.wanted, MIN_VELOCITY, MAX_VELOCITY)
        wanted = [min(max(v, low), high) for v, low, high in limits]
        steps, share = [], 1.0
        for v, now, up, down in zip(wanted, self.last, MAX_ACCEL, MAX_DECEL):
            faster = abs(v) >= abs(now) and v * now >= 0.0
            most, least = (up, -up) if faster else (-down, down)
            most, least = most / RATE, least / RATE
            steps.append((v - now, least, most))
            if v - now > most:
                share = min(share, most / (v - now))
            elif v - now < least:
                share = min(share, least / (v - now))
        self.last = tuple(
            now + min(max(share * step, least), most)
            for now, (step, least, most) in zip(self.last, steps)
        )
        twist = Twist()
        values = [0.0 if abs(v) < d else v for v, d in zip(self.last, DEADBAND)]
        if not any(values) and not any(wanted):
            self.last = (0.0, 0.0, 0.0)
        twist.linear.x, twist.linear.y, twist.angular.z = values
        self.out.publish(twist)
        self.sent += 1


def main() -> None:
    rclpy.init()
    node = rclpy.create_node("velocity_smoother")
    Smoother(node)
    print(json.dumps({"kind": "ready"}), flush=True)
    rclpy.spin(node)


main()
