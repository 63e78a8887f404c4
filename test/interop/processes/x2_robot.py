"""A plain rclpy process that is an AgiBot X2: joints follow their commands, states come at 200 Hz.

Nothing of unicon is imported. Usage: x2_robot.py GROUP=JOINT,JOINT… …   One more publisher of leg
commands stands there, as the vendor's own controller, until `{"release": true}` comes on stdin.
Prints what it was commanded as a JSON line, ten times a second.
"""

import json
import sys
import threading

import rclpy
from aimdk_msgs.msg import JointCommandArray, JointState, JointStateArray
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Imu

STATE = QoSProfile(
    depth=10,
    reliability=ReliabilityPolicy.BEST_EFFORT,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)


def main():
    groups = {name: names.split(",") for name, _, names in (a.partition("=") for a in sys.argv[1:])}
    rclpy.init()
    node = rclpy.create_node("x2_robot")
    own = node.create_publisher(JointCommandArray, "/aima/hal/joint/leg/command", 10)
    joints = [joint for group in groups.values() for joint in group]
    position = {joint: 0.001 * k for k, joint in enumerate(joints)}
    begun = dict(position)
    told = {"commands": 0, "first": {}, "gains": {}, "targets": {}}
    release = threading.Event()

    def on_command(message):
        told["commands"] += 1
        for joint in message.joints:
            told["first"].setdefault(joint.name, abs(joint.position - begun[joint.name]))
            told["gains"][joint.name] = [joint.stiffness, joint.damping]
            told["targets"][joint.name] = joint.position
            if joint.stiffness:
                position[joint.name] += 0.2 * (joint.position - position[joint.name])

    states = {}
    for group in groups:
        topic = f"/aima/hal/joint/{group}"
        node.create_subscription(JointCommandArray, f"{topic}/command", on_command, 10)
        states[group] = node.create_publisher(JointStateArray, f"{topic}/state", STATE)
    imus = node.create_publisher(Imu, "/aima/hal/imu/torso/state", STATE)
    ticks = [0]

    def publish():
        ticks[0] += 1
        if release.is_set() and not told.get("released"):
            node.destroy_publisher(own)
            told["released"] = True
        noise = 1e-5 * (ticks[0] % 7)
        for group, names in groups.items():
            message = JointStateArray()
            message.joints = [JointState(name=j, position=position[j] + noise) for j in names]
            states[group].publish(message)
        imu = Imu()
        imu.orientation.w = 1.0
        imu.angular_velocity.x = noise
        imu.linear_acceleration.z = 9.81 + noise
        imus.publish(imu)

    def listen():
        for line in sys.stdin:
            if json.loads(line).get("release"):
                release.set()

    threading.Thread(target=listen, daemon=True).start()
    node.create_timer(0.005, publish)
    node.create_timer(0.1, lambda: print(json.dumps({"kind": "robot", **told}), flush=True))
    rclpy.spin(node)


main()
