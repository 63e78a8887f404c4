"""A plain rclpy process that is a robot whose sensors go wrong, at 1 kHz; prints what it is told.

Nothing of unicon is imported. Usage: lying_robot.py LIE SECONDS JOINT...   It tells the truth for
so many seconds from its first command on, then it lies: see `LIES`. Below 0 s it always lies.
"""

import json
import math
import sys
import time

import rclpy
from sensor_msgs.msg import Imu, JointState

LIES = (
    "nan joints",
    "few joints",
    "far joints",
    "nan imu",
    "no imu",
    "zero quat",
    "no orientation",
)
STAND = {"hip": 0.0, "thigh": 0.8, "calf": -1.6}


def main() -> None:
    lie, seconds, names = sys.argv[1], float(sys.argv[2]), sys.argv[3:]
    assert lie in (*LIES, "none")
    rclpy.init()
    node = rclpy.create_node("lying_robot")
    heard: list[list[list[float]]] = []
    first: list[float] = []

    def on_command(message: JointState) -> None:
        first.append(time.monotonic())
        heard.append([list(message.position), list(message.velocity), list(message.effort)])

    node.create_subscription(JointState, "joint_commands", on_command, 100)
    joints = node.create_publisher(JointState, "joint_states", 10)
    imus = node.create_publisher(Imu, "imu/data", 10)
    pose = [next(v for k, v in STAND.items() if k in name) for name in names]

    def lies() -> bool:
        return seconds < 0 or (bool(first) and time.monotonic() - first[0] > seconds)

    def publish() -> None:
        now = lie if lies() else "none"
        state = JointState(name=names, position=list(pose), velocity=[0.0] * len(names))
        state.header.stamp = node.get_clock().now().to_msg()
        if now == "nan joints":
            state.position[3] = math.nan
        elif now == "few joints":
            state = JointState(name=names[:5], position=pose[:5], velocity=[0.0] * 5)
        elif now == "far joints":
            state.position = [1e30] * len(names)
        joints.publish(state)
        imu = Imu()
        imu.linear_acceleration.z = 9.81
        if now == "nan imu":
            imu.angular_velocity.x = math.nan
        elif now == "zero quat":
            imu.orientation.w = 0.0
        elif now == "no orientation":
            imu.orientation_covariance[0] = -1.0
        if now != "no imu":
            imus.publish(imu)

    def tell() -> None:
        print(
            json.dumps(
                {"kind": "robot", "lies": lies(), "commands": len(heard), "last": heard[-1:]}
            ),
            flush=True,
        )

    node.create_timer(0.001, publish)
    node.create_timer(0.05, tell)
    rclpy.spin(node)


main()
