"""A robot in Gazebo with gz_ros2_control and ros_gz_bridge, in plain rclpy, MuJoCo as its physics.

The controller manager runs at each physics step. Two forward_command_controllers feed a
pid_controller (gains of its own, reference position and velocity), or one takes torques; each drops
lists of another length and keeps the last for ever. joint_state_broadcaster tells the joints sorted
by name, stamped with simulated time, beside /clock, imu/data and odom, as gz has them: orientation
in the world (ENU), twist in the frame of the base. Nothing of unicon is imported.
Usage: gz_ros2_control.py MODEL.mjb SAID.json SECONDS
SAID: joints, position, base, kp, kd, limit and, as `interface`, position or effort.
"""

import json
import sys
import time

import mujoco
import numpy as np
import rclpy
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu, JointState
from std_msgs.msg import Float64MultiArray

PUBLISHED = 0.005  # s


class Gazebo:
    def __init__(self, path, said):
        self.model = mujoco.MjModel.from_binary_path(path)
        self.data = mujoco.MjData(self.model)
        self.names, self.interface = said["joints"], said["interface"]
        ids = [self.model.joint(name).id for name in self.names]
        self.qpos, self.dofs = self.model.jnt_qposadr[ids], self.model.jnt_dofadr[ids]
        self.kp, self.kd, self.limit = (np.array(said[word]) for word in ("kp", "kd", "limit"))
        self.data.qpos[:7], self.data.qpos[self.qpos] = said["base"], said["position"]
        mujoco.mj_forward(self.model, self.data)
        self.before = np.zeros(3)
        self.heard = {}
        self.counts = {"commands": 0, "dropped": 0}
        self.node = rclpy.create_node("gz_ros_control")
        topics = ["effort"] if self.interface == "effort" else ["position", "velocity"]
        for word in topics:
            topic = f"forward_{word}_controller/commands"
            self.node.create_subscription(Float64MultiArray, topic, self.hear(word), 1)
        publisher = self.node.create_publisher
        self.clock = publisher(Clock, "/clock", 1)
        self.joints = publisher(JointState, "joint_states", 10)
        self.imu = publisher(Imu, "imu/data", 10)
        self.odom = publisher(Odometry, "odom", 10)

    def hear(self, word):
        def heard(message):
            self.counts["commands"] += 1
            if len(message.data) == len(self.names):
                self.heard[word] = np.array(message.data)
            else:
                self.counts["dropped"] += 1

        return heard

    def step(self):
        data = self.data
        if self.interface == "effort":
            torque = self.heard.get("effort", np.zeros(len(self.names)))
        elif len(self.heard) == 2:
            off = self.heard["position"] - data.qpos[self.qpos]
            torque = self.kp * off + self.kd * (self.heard["velocity"] - data.qvel[self.dofs])
        else:
            torque = np.zeros(len(self.names))  # nothing acts before there are references
        self.before = data.qvel[:3].copy()
        data.ctrl[:] = 0.0
        data.qfrc_applied[self.dofs] = np.clip(torque, -self.limit, self.limit)
        mujoco.mj_step(self.model, data)

    def publish(self):
        data = self.data
        sec, part = divmod(round(data.time * 1e9), 1_000_000_000)
        clock = Clock()
        clock.clock.sec, clock.clock.nanosec = sec, part
        order = sorted(range(len(self.names)), key=lambda i: self.names[i])
        joints = JointState(name=[self.names[i] for i in order])
        joints.position = [float(data.qpos[self.qpos[i]]) for i in order]
        joints.velocity = [float(data.qvel[self.dofs[i]]) for i in order]
        joints.effort = [float(data.qfrc_applied[self.dofs[i]]) for i in order]
        imu, odom = Imu(), Odometry()
        w, x, y, z = map(float, data.qpos[3:7])
        turned = np.zeros(9)
        mujoco.mju_quat2Mat(turned, data.qpos[3:7])
        turned = turned.reshape(3, 3)
        change = (data.qvel[:3] - self.before) / self.model.opt.timestep
        gyro = imu.angular_velocity
        gyro.x, gyro.y, gyro.z = map(float, data.qvel[3:6])
        felt = imu.linear_acceleration
        felt.x, felt.y, felt.z = map(float, turned.T @ (change - self.model.opt.gravity))
        place, move = odom.pose.pose.position, odom.twist.twist.linear
        place.x, place.y, place.z = map(float, data.qpos[:3])
        move.x, move.y, move.z = map(float, turned.T @ data.qvel[:3])
        for quat in (imu.orientation, odom.pose.pose.orientation):
            quat.w, quat.x, quat.y, quat.z = w, x, y, z
        for message in (joints, imu, odom):
            message.header.stamp = clock.clock
        for out, message in zip(
            (self.clock, self.joints, self.imu, self.odom), (clock, joints, imu, odom)
        ):
            out.publish(message)


def main():
    path, said, seconds = sys.argv[1:]
    with open(said) as file:
        said = json.load(file)
    rclpy.init()
    gazebo = Gazebo(path, said)
    every = round(PUBLISHED / gazebo.model.opt.timestep)
    told, steps, began = 0.0, 0, time.monotonic()
    while gazebo.data.time < float(seconds):
        rclpy.spin_once(gazebo.node, timeout_sec=0.0)
        if gazebo.heard:  # gz begins paused until its controllers are there
            gazebo.step()
            steps += 1
        if not gazebo.heard or steps % every == 0:
            gazebo.publish()
            while gazebo.heard and time.monotonic() < began + gazebo.data.time:
                rclpy.spin_once(gazebo.node, timeout_sec=0.0005)
        if not gazebo.heard:
            began = time.monotonic()
            time.sleep(PUBLISHED)
        if time.monotonic() > told + 0.2:
            told = time.monotonic()
            place = dict(zip(gazebo.names, gazebo.data.qpos[gazebo.qpos].tolist()))
            line = {"kind": "gazebo", "time": gazebo.data.time, "at": place}
            line |= {"base": gazebo.data.qpos[:7].tolist(), "interface": gazebo.interface}
            line["last"] = {word: values.tolist() for word, values in gazebo.heard.items()}
            print(json.dumps(line | gazebo.counts), flush=True)


main()
