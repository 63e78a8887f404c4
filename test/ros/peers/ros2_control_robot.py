"""A robot that ros2_control runs, in plain rclpy: broadcaster and controllers as they behave.

joint_state_broadcaster tells all joints sorted by name, with one that is not ours, and NaN where
there is no interface. forward_command_controller takes as many numbers as it has joints, in the
order of its parameter, and drops others; JointGroupEffortController the same; each keeps the last
for ever. joint_trajectory_controller goes to a trajectory's point in its time, by name.
Nothing of unicon is imported.
Usage: ros2_control_robot.py position|effort|trajectory RATE SECONDS JOINT=POSITION…
"""

import json
import math
import sys
import time

import rclpy
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory

INERTIA, FRICTION = 0.05, 0.2  # kg·m², N·m·s/rad


class Robot:
    def __init__(self, interface, rate, joints):
        self.names = list(joints)
        self.position = [float(joints[name]) for name in self.names]
        self.velocity = [0.0] * len(joints)
        self.target = list(self.position)
        self.effort = [0.0] * len(joints)
        self.interface, self.period = interface, 1.0 / rate
        self.due, self.began = None, time.time_ns()
        self.counts = {"published": 0, "commands": 0, "dropped": 0}
        self.node = rclpy.create_node("ros2_control")
        topic, kind = {
            "position": ("forward_position_controller/commands", Float64MultiArray),
            "effort": ("forward_effort_controller/commands", Float64MultiArray),
            "trajectory": ("joint_trajectory_controller/joint_trajectory", JointTrajectory),
        }[interface]
        # Theirs have a queue of one, and C++; here each message is counted.
        self.node.create_subscription(kind, topic, getattr(self, f"hear_{interface}"), 10)
        self.out = self.node.create_publisher(JointState, "joint_states", 10)
        self.node.create_timer(self.period, self.update)

    def numbers(self, message):
        self.counts["commands"] += 1
        if len(message.data) != len(self.names):
            self.counts["dropped"] += 1
            return None
        return list(message.data)

    def hear_position(self, message):
        self.target = self.numbers(message) or self.target

    def hear_effort(self, message):
        self.effort = self.numbers(message) or self.effort

    def hear_trajectory(self, message):
        self.counts["commands"] += 1
        if sorted(message.joint_names) != sorted(self.names) or len(message.points) != 1:
            self.counts["dropped"] += 1
            return
        (point,) = message.points
        after = point.time_from_start
        self.due = (time.monotonic() + after.sec + after.nanosec * 1e-9, time.monotonic())
        self.begin = list(self.position)
        wanted = dict(zip(message.joint_names, point.positions))
        self.target = [wanted[name] for name in self.names]

    def update(self):
        for i in range(len(self.names)):
            if self.interface == "effort":
                torque = self.effort[i] - FRICTION * self.velocity[i]
                self.velocity[i] += self.period * torque / INERTIA
                self.position[i] += self.period * self.velocity[i]
            elif self.interface == "position":
                self.velocity[i] = (self.target[i] - self.position[i]) / self.period
                self.position[i] = self.target[i]
            elif self.due is not None:
                end, start = self.due
                share = min((time.monotonic() - start) / (end - start), 1.0)
                self.position[i] = self.begin[i] + share * (self.target[i] - self.begin[i])
        names = sorted([*self.names, "gripper_finger_joint"])
        own = {name: i for i, name in enumerate(self.names)}
        message = JointState(name=names)
        # A period apart to the nanosecond, so that whoever hears can tell what is missing.
        stamp = self.began + self.counts["published"] * round(self.period * 1e9)
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 1_000_000_000)
        message.position = [self.position[own[n]] if n in own else 0.01 for n in names]
        message.velocity = [self.velocity[own[n]] if n in own else 0.0 for n in names]
        message.effort = [math.nan] * len(names)
        self.out.publish(message)
        self.counts["published"] += 1


def main():
    interface, rate, seconds, *joints = sys.argv[1:]
    rclpy.init()
    robot = Robot(interface, float(rate), dict(word.split("=") for word in joints))
    end = time.monotonic() + float(seconds)
    told = 0.0
    while time.monotonic() < end:
        rclpy.spin_once(robot.node, timeout_sec=0.01)
        if time.monotonic() > told + 0.2:
            told = time.monotonic()
            line = {"kind": "robot", "at": dict(zip(robot.names, robot.position))}
            line |= {"speed": max(map(abs, robot.velocity)), "effort": robot.effort}
            print(json.dumps(line | robot.counts), flush=True)
    print(json.dumps({"kind": "done", "effort": robot.effort, **robot.counts}), flush=True)


main()
