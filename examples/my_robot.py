"""A platform for a robot behind its vendor's driver: what a driver of your own has to do.

    platform: my_robot:make
    platforms: {"my_robot:make": {port: can1}}

`my_vendor` stands for the vendor's package. docs/reference/platforms.md has the contract.
"""

from unicon_core.platforms.kit.base import Mounting
from unicon_core.platforms.kit.command import Command, Damping, LastSent, repeated
from unicon_core.platforms.platform import Facts


class MyRobot:
    facts = Facts("my_robot", writes=("joint_pos", "joint_vel", "base_quat", "base_ang_vel"))

    def __init__(self, states, robot, period, port):
        from my_vendor import open_driver  # imported here: others need no driver

        self.states, self.robot, self.period = states, robot, period
        self.driver = open_driver(port)
        self.imu = Mounting.of(robot)  # rotation from sensor to base
        self.command = Command(states, robot.joint_names)
        self.last = LastSent(states)

    def recv(self):
        pos, vel, quat, gyro = self.driver.read()  # joints in the robot file's order
        self.states.joint_pos, self.states.joint_vel = pos, vel
        self.states.base_quat, self.states.base_ang_vel = self.imu.quat(quat), self.imu.vector(gyro)

    def send(self):
        self.command.take()  # a fault if a value is not finite
        self.driver.write(*self.command.rows)  # q*, qd*, tau_ff, kp, kd
        self.last.note()

    def close(self):
        if self.last.any:  # else another program may be driving the robot
            damping = Damping(self.states, self.robot, self.last, self.period)
            repeated(lambda: (damping(), self.send()), self.period)
        self.driver.close()


def make(states, robot, period, *, port="can0", silent=False) -> MyRobot:
    # silent: send nothing (`--dry`), so open no publisher
    return MyRobot(states, robot, period, port)
