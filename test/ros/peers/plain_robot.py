"""A plain rclpy process that is a robot: joints follow `joint_commands`, states come at 200 Hz.

Nothing of unicon is imported. Usage: plain_robot.py [--imu] [--best-effort] JOINT...   The joints
are published in the order given. Prints the last command as a JSON line, ten times a second.
"""

import json
import sys

import rclpy
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import Imu, JointState


def main() -> None:
    names = [word for word in sys.argv[1:] if not word.startswith("--")]
    rclpy.init()
    node = rclpy.create_node("plain_robot")
    position = dict.fromkeys(names, 0.0)
    counts = {"states": 0, "commands": 0}

    def on_command(message: JointState) -> None:
        counts["commands"] += 1
        for name, target in zip(message.name, message.position):
            position[name] += 0.2 * (target - position[name])

    node.create_subscription(JointState, "joint_commands", on_command, 10)
    profile = qos_profile_sensor_data if "--best-effort" in sys.argv else 10
    states = node.create_publisher(JointState, "joint_states", profile)
    imus = node.create_publisher(Imu, "imu/data", 10) if "--imu" in sys.argv else None

    def publish() -> None:
        message = JointState(name=names)
        message.header.stamp = node.get_clock().now().to_msg()
        message.position = [position[name] for name in names]
        message.velocity = [0.0] * len(names)
        states.publish(message)
        counts["states"] += 1
        if imus is not None:
            imu = Imu()
            imu.orientation.x, imu.orientation.w = 0.6, 0.8
            imus.publish(imu)

    node.create_timer(0.005, publish)
    node.create_timer(
        0.1, lambda: print(json.dumps({"kind": "robot", "at": position, **counts}), flush=True)
    )
    rclpy.spin(node)


main()
