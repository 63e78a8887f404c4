"""A plain rclpy process: prints what it hears of a robot as JSON lines, and commands it.

Nothing of unicon is imported. Usage: robot_watcher.py [--command VX VY WZ]
"""

import json
import sys
import time

import rclpy
from geometry_msgs.msg import Twist
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu, JointState


def say(kind: str, **values: object) -> None:
    print(json.dumps({"kind": kind, **values}), flush=True)


def nanoseconds(stamp: object) -> int:
    return stamp.sec * 1_000_000_000 + stamp.nanosec


def on_joints(message: JointState) -> None:
    say(
        "joints",
        stamp=nanoseconds(message.header.stamp),
        names=list(message.name),
        position=list(message.position),
        velocity=list(message.velocity),
    )


def on_imu(message: Imu) -> None:
    q = message.orientation
    say("imu", stamp=nanoseconds(message.header.stamp), xyzw=[q.x, q.y, q.z, q.w])


def main() -> None:
    rclpy.init()
    node = rclpy.create_node("watcher")
    node.create_subscription(JointState, "joint_states", on_joints, 10)
    node.create_subscription(Imu, "imu/data", on_imu, 10)
    best = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
    node.create_subscription(
        Clock, "/clock", lambda m: say("clock", stamp=nanoseconds(m.clock)), best
    )
    if "--command" in sys.argv:
        at = sys.argv.index("--command")
        twist = Twist()
        twist.linear.x, twist.linear.y, twist.angular.z = map(float, sys.argv[at + 1 : at + 4])
        commands = node.create_publisher(Twist, "cmd_vel", 10)
        begin = time.monotonic()

        def command() -> None:
            if time.monotonic() - begin > 1.5:  # the robot is watched at rest first
                commands.publish(twist)

        node.create_timer(0.05, command)
    say("ready")
    rclpy.spin(node)


main()
