"""Robots as data: joints, limits, gains, poses, IMU and transport facts."""

from unicon_core.robots.load import compose, load_files, load_robot, robot_files, robot_names
from unicon_core.robots.robot import Imu, Robot, joint_index
from unicon_core.robots.table import robot_table, robots_rows, robots_table

__all__ = [
    "Imu",
    "Robot",
    "compose",
    "joint_index",
    "load_files",
    "load_robot",
    "robot_files",
    "robot_names",
    "robot_table",
    "robots_rows",
    "robots_table",
]
