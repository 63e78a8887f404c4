"""What ros2_control's controller manager and its topic-based hardware do, in plain rclpy.

Behaves as joint_state_topic_hardware_interface/JointStateTopicSystem with a joint_state_broadcaster
and a forward_command_controller for positions: states are heard with the sensor profile; commands
go out only while they differ from the states by more than 1e-5 in sum; joint_states are sorted by
name. Nothing of unicon is imported. Usage: controller_manager.py RATE SECONDS JOINT…
Prints one JSON line a second, and at the end all that was counted.
"""

import json
import math
import sys
import time

import rclpy
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

THRESHOLD = 1e-5


class Manager:
    def __init__(self, rate, joints):
        self.joints = joints
        self.node = rclpy.create_node("controller_manager")
        self.states = dict.fromkeys(joints, math.nan)
        self.commands = dict(self.states)
        self.counts = {"heard": 0, "gaps": 0, "sent": 0, "silent": 0, "references": 0}
        self.last = 0
        self.active = False
        create = self.node.create_subscription
        # Deep enough for a manager that is held up: what it counts is what the sender lost.
        best_effort = QoSProfile(depth=200, reliability=ReliabilityPolicy.BEST_EFFORT)
        create(JointState, "robot_joint_states", self.hear, best_effort)
        create(Float64MultiArray, "forward_position_controller/commands", self.refer, 10)
        self.out = self.node.create_publisher(
            JointState, "robot_joint_commands", QoSProfile(depth=1)
        )
        self.broadcast = self.node.create_publisher(JointState, "joint_states", 10)
        self.node.create_timer(1.0 / rate, self.update)

    def hear(self, message):
        self.counts["heard"] += 1
        stamp = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
        if self.last:  # a state every tick of 10 ms: what is missing was lost
            self.counts["gaps"] += round((stamp - self.last) / 1e7) - 1
        self.last = stamp
        self.states.update(zip(message.name, message.position))

    def refer(self, message):
        if len(message.data) != len(self.joints):
            return
        self.counts["references"] += 1
        self.active = True
        self.commands = dict(zip(self.joints, message.data))

    def update(self):
        if any(math.isnan(value) for value in self.states.values()):
            return
        names = sorted(self.joints)
        told = JointState(name=names, position=[self.states[name] for name in names])
        told.header.stamp = self.node.get_clock().now().to_msg()
        told.velocity = [math.nan] * len(names)
        told.effort = [math.nan] * len(names)
        self.broadcast.publish(told)
        if not self.active:
            return
        off = sum(abs(self.states[name] - self.commands[name]) for name in self.joints)
        if off <= THRESHOLD:
            self.counts["silent"] += 1
            return
        command = JointState(name=self.joints)
        command.header.stamp = told.header.stamp
        command.position = [self.commands[name] for name in self.joints]
        self.out.publish(command)
        self.counts["sent"] += 1

    def settle(self):
        """Send nothing any more; what is under way arrives."""
        self.active = False


def main():
    rate, seconds, *joints = sys.argv[1:]
    rclpy.init()
    manager = Manager(float(rate), joints)
    end = time.monotonic() + float(seconds)
    told = 0.0
    while time.monotonic() < end:
        rclpy.spin_once(manager.node, timeout_sec=0.01)
        if time.monotonic() > told + 1.0:
            told = time.monotonic()
            print(
                json.dumps({"kind": "manager", "at": manager.states, **manager.counts}), flush=True
            )
    manager.settle()
    print(json.dumps({"kind": "sent", **manager.counts}), flush=True)
    end = time.monotonic() + 1.0
    while time.monotonic() < end:
        rclpy.spin_once(manager.node, timeout_sec=0.01)
    print(json.dumps({"kind": "done", **manager.counts}), flush=True)


main()
