"""A plain rclpy process: drives two robots for a minute, stops one of them, and notes all it hears.

Nothing of unicon is imported. Usage: drives_two.py OUT.json SECONDS ESTOP_AFTER NODE NODE, each
`/namespace/name`. Every command has a number of its own in `linear.z`, which no robot heeds.
Numbers of the first robot are even, those of the second odd. SECONDS count from the moment in which
both robots hear.
"""

import json
import sys
import time

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

SPEEDS = ((0.4, 0.0), (0.0, 0.6))  # forward in [m/s], turning in [rad/s]


def nanoseconds(stamp: object) -> int:
    return stamp.sec * 10**9 + stamp.nanosec


class Robot:
    def __init__(self, node: Node, number: int, name: str) -> None:
        space = name.rsplit("/", 1)[0]
        self.number, self.name, self.space = number, name, space
        self.sent: list[int] = []
        self.joint_stamps: list[int] = []
        self.clock: list[int] = []
        self.frames: set[tuple[str, str]] = set()
        self.path: list[tuple[float, float, float]] = []
        self.commands = node.create_publisher(Twist, f"{space}/cmd_vel", 10)
        self.estop = node.create_client(Trigger, f"{name}/estop")
        node.create_subscription(JointState, f"{space}/joint_states", self.on_joints, 100)
        node.create_subscription(Odometry, f"{space}/odom", self.on_odometry, 100)
        topic = "/clock" if number == 0 else f"{space}/clock"
        node.create_subscription(Clock, topic, self.on_clock, qos_profile_sensor_data)

    def on_joints(self, message: JointState) -> None:
        self.joint_stamps.append(nanoseconds(message.header.stamp))

    def on_odometry(self, message: Odometry) -> None:
        self.frames.add((message.header.frame_id, message.child_frame_id))
        position = message.pose.pose.position
        self.path.append((time.monotonic(), position.x, position.y))

    def on_clock(self, message: Clock) -> None:
        self.clock.append(nanoseconds(message.clock))

    def command(self) -> None:
        message = Twist()
        message.linear.x, message.angular.z = SPEEDS[self.number]
        self.sent.append(2 * len(self.sent) + self.number)
        message.linear.z = float(self.sent[-1])
        self.commands.publish(message)

    def told(self) -> dict:
        return {
            "sent": self.sent,
            "joint_stamps": self.joint_stamps,
            "clock": self.clock,
            "frames": sorted(self.frames),
            "path": self.path,
        }


def main() -> None:
    out, seconds, estop_after = sys.argv[1], float(sys.argv[2]), float(sys.argv[3])
    rclpy.init()
    node = rclpy.create_node("operator")
    robots = [Robot(node, number, name) for number, name in enumerate(sys.argv[4:])]
    statuses: list[tuple[float, str, str, dict]] = []

    def on_diagnostics(message: DiagnosticArray) -> None:
        for status in message.status:
            values = {each.key: each.value for each in status.values}
            statuses.append((time.monotonic(), status.name, status.message, values))

    node.create_subscription(DiagnosticArray, "/diagnostics", on_diagnostics, 100)

    def spin(until: float) -> None:
        while time.monotonic() < until:
            rclpy.spin_once(node, timeout_sec=0.01)

    patience = time.monotonic() + 60.0
    while not all(robot.path and robot.estop.service_is_ready() for robot in robots):
        if time.monotonic() > patience:
            raise SystemExit("the robots are not there")
        spin(time.monotonic() + 0.1)
    spin(time.monotonic() + 4.0)  # all know each other, and the robots stand
    begun = time.monotonic()
    pressed = answered = 0.0
    asked = None
    graph: dict[str, list[str]] = {}
    while (now := time.monotonic()) < begun + seconds:
        for robot in robots:
            robot.command()
        if asked is None and now > begun + estop_after:
            graph = dict(node.get_topic_names_and_types())
            counts = {topic: node.count_publishers(topic) for topic in graph}
            pressed, asked = now, robots[0].estop.call_async(Trigger.Request())
        if asked is not None and asked.done() and not answered:
            answered = time.monotonic()
        spin(now + 0.05)
    told = {
        "begun": begun,
        "ended": time.monotonic(),
        "pressed": pressed,
        "answered": answered,
        "answer": asked.result().message if asked is not None and asked.done() else "",
        "publishers": counts,
        "nodes": sorted(node.get_node_names_and_namespaces()),
        "statuses": statuses,
        "robots": [robot.told() for robot in robots],
    }
    with open(out, "w", encoding="utf-8") as file:
        json.dump(told, file)
    node.destroy_node()
    rclpy.try_shutdown()


main()
