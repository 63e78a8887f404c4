"""What every ready map must say and understand: states, and the message as a ROS user sees it.

Written down by hand from the message definitions, with no code of the map. All numbers are exact in
float32, so that they are compared for equality.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from unicon_core.robots import load_robot

N = 12
NAMES = [f"joint_{k}" for k in range(N)]
STAMP_NS = 1_700_000_000_123_456_789
STAMP = {"sec": 1_700_000_000, "nanosec": 123_456_789}
WXYZ = [0.5, -0.5, 0.5, 0.5]
QUATERNION = {"w": 0.5, "x": -0.5, "y": 0.5, "z": 0.5}


def ramp(start: float, count: int = N) -> list[float]:
    """Return numbers an eighth apart."""
    return [start + k / 8 for k in range(count)]


def vector(values: Sequence[float]) -> dict[str, float]:
    """Return a Vector3 or Point."""
    return dict(zip("xyz", values))


@dataclass(frozen=True)
class Case:
    """One map.

    Attributes:
        states: what our side holds before it publishes.
        says: topic to the parts of the message that the map fills.
        hears: topic to a message, and the states that must follow from it.
        joints: number of joints.
        packages: packages of messages that the wheels lack.
    """

    states: dict[str, Any] = field(default_factory=dict)
    says: dict[str, dict[str, Any]] = field(default_factory=dict)
    hears: dict[str, tuple[dict[str, Any], dict[str, Any]]] = field(default_factory=dict)
    joints: int = N
    packages: tuple[str, ...] = ()


def diagonal(*values: float) -> list[float]:
    """Return a covariance of six by six, row by row."""
    return [values[k // 7] if k % 7 == 0 else 0.0 for k in range(36)]


TWIST = {"linear": vector([0.5, -0.25, 9.0]), "angular": vector([9.0, 9.0, 0.125])}
COMMAND = {"velocity_command": [0.5, -0.25, 0.125]}
SHUFFLED = NAMES[::-1]
MEASURED = {
    "header": {"stamp": STAMP, "frame_id": "somewhere"},
    "name": [*SHUFFLED, "gripper"],
    "position": [*ramp(1.0)[::-1], 99.0],
    "velocity": [*ramp(2.0)[::-1], 99.0],
    "effort": [*ramp(3.0)[::-1], 99.0],
}
ROBOT = {"joint_pos": ramp(1.0), "joint_vel": ramp(2.0), "joint_effort": ramp(3.0)}
TARGETS = {
    "joint_pos_target": ramp(4.0),
    "joint_vel_target": ramp(5.0),
    "joint_effort_ff": ramp(6.0),
}
WANTED = {
    "joint_pos_command": ramp(4.0),
    "joint_vel_command": ramp(5.0),
    "joint_effort_command": ramp(6.0),
}
BASE = {
    "base_quat": WXYZ,
    "base_ang_vel": [0.25, 0.5, 0.75],
    "base_lin_acc": [1.25, 1.5, 9.75],
}
IMU = {
    "orientation": QUATERNION,
    "angular_velocity": vector([0.25, 0.5, 0.75]),
    "linear_acceleration": vector([1.25, 1.5, 9.75]),
}
PLACE = {"base_pos_w": [10.5, -2.25, 0.375], "base_lin_vel": [0.5, 0.125, -0.25]}
TRANSFORM = {
    "header": {"stamp": STAMP, "frame_id": "odom"},
    "child_frame_id": "base_link",
    "transform": {"translation": vector([10.5, -2.25, 0.375]), "rotation": QUATERNION},
}


def motors(count: int, size: int, **parts: list[float]) -> list[dict[str, float]]:
    """Return Unitree's motors, those behind the robot's own all zero."""
    own = [{name: values[k] for name, values in parts.items()} for k in range(count)]
    return own + [dict.fromkeys(parts, 0.0) for _ in range(size - count)]


def unitree(count: int, size: int, hg: bool) -> Case:
    """Return the case of LowCmd and LowState with so many of `size` motors."""
    q, dq, tau = ramp(4.0, count), ramp(5.0, count), ramp(6.0, count)
    kp, kd = ramp(40.0, count), ramp(0.5, count)
    states: dict[str, Any] = {"joint_pos_target": q, "joint_vel_target": dq}
    states |= {"joint_effort_ff": tau, "joint_stiffness": kp, "joint_damping": kd}
    commands = motors(count, size, mode=[1] * count, q=q, dq=dq, tau=tau, kp=kp, kd=kd)
    said: dict[str, Any] = {"motor_cmd": commands}
    after: dict[str, Any] = {
        "joint_pos": ramp(1.0, count),
        "joint_vel": ramp(2.0, count),
        "joint_effort": ramp(3.0, count),
        **BASE,
    }
    heard: dict[str, Any] = {
        "imu_state": {
            "quaternion": WXYZ,  # wxyz on the wire, as in the states
            "gyroscope": BASE["base_ang_vel"],
            "accelerometer": BASE["base_lin_acc"],
        },
        "motor_state": motors(
            count, count, q=ramp(1.0, count), dq=ramp(2.0, count), tau_est=ramp(3.0, count)
        ),
    }
    if hg:
        states |= {"mode_machine": 5, "motor_mode": [1] * count}
        said |= {"mode_pr": 0, "mode_machine": 5}
        heard["mode_machine"] = 6
        after["mode_machine"] = 6
    else:
        said |= {"head": [0xFE, 0xEF], "level_flag": 0xFF}
    package = "unitree_hg" if hg else "unitree_go"
    return Case(
        states, {"/lowcmd": said}, {"/lowstate": (heard, after)}, count, packages=(package,)
    )


def agibot_x2() -> Case:
    """Return the case of a topic for each group, in the robot file's order."""
    robot = load_robot("x2")
    count, names = robot.num_joints, robot.joint_names
    figures = {
        "position": 4.0,
        "velocity": 12.0,
        "effort": 20.0,
        "stiffness": 28.0,
        "damping": 36.0,
    }
    commands = ("joint_pos_target", "joint_vel_target", "joint_effort_ff")
    commands += ("joint_stiffness", "joint_damping")
    measured = {"joint_pos": "position", "joint_vel": "velocity", "joint_effort": "effort"}
    states = {name: ramp(start, count) for name, start in zip(commands, figures.values())}
    says: dict[str, Any] = {}
    hears: dict[str, Any] = {}
    last = 0
    for group, size in robot.transport["groups"].items():
        first, last = last, last + size
        joints = [
            {"name": names[k]} | {field: start + k / 8 for field, start in figures.items()}
            for k in range(first, last)
        ]
        told = [
            {key: joint[key] for key in ("name", "position", "velocity", "effort")}
            for joint in joints
        ]
        says[robot.transport["command_topics"][group]] = {"joints": joints}
        after = {  # of this group and of those before it
            state: [*ramp(figures[field], last), *[0.0] * (count - last)]
            for state, field in measured.items()
        }
        hears[robot.transport["state_topics"][group]] = ({"joints": told}, after)
    joints[-1] |= dict.fromkeys(figures, 0.0)  # head_pitch, which is not commanded
    hears[robot.transport["imu_topic"]] = (IMU, BASE)
    return Case(states, says, hears, count, packages=("aimdk_msgs",))


CASES: dict[str, Case] = {
    "agibot_x2": agibot_x2(),
    "battery_state": Case(
        {
            "stamp_ns": STAMP_NS,
            "battery_voltage": 28.5,
            "battery_current": -3.25,
            "battery_percentage": 0.75,
        },
        {
            "battery_state": {
                "header": {"stamp": STAMP},
                "voltage": 28.5,
                "current": -3.25,
                "percentage": 0.75,
                "power_supply_status": 2,
                "power_supply_technology": 2,
                "present": True,
            }
        },
        {
            "battery_state": (
                {"voltage": 27.25, "current": -4.5, "percentage": 0.5, "cell_voltage": [3.5] * 7},
                {"battery_voltage": 27.25, "battery_current": -4.5, "battery_percentage": 0.5},
            )
        },
    ),
    "clock_in": Case(hears={"/clock": ({"clock": STAMP}, {"stamp_ns": STAMP_NS})}),
    "default": Case(
        {"stamp_ns": STAMP_NS, **ROBOT, **BASE, **PLACE},
        {
            "joint_states": {
                "header": {"stamp": STAMP},
                "name": NAMES,
                "position": ramp(1.0),
                "velocity": ramp(2.0),
                "effort": ramp(3.0),
            },
            "imu/data": {"header": {"stamp": STAMP, "frame_id": "imu_link"}, **IMU},
            "odom": {
                "header": {"stamp": STAMP, "frame_id": "odom"},
                "child_frame_id": "base_link",
                "pose": {
                    "pose": {
                        "position": vector([10.5, -2.25, 0.375]),
                        "orientation": QUATERNION,
                    }
                },
                "twist": {
                    "twist": {
                        "linear": vector([0.5, 0.125, -0.25]),
                        "angular": vector([0.25, 0.5, 0.75]),
                    }
                },
            },
            "/clock": {"clock": STAMP},
        },
        {"cmd_vel": (TWIST, COMMAND)},
    ),
    "diagnostics": Case(
        {
            "stamp_ns": STAMP_NS,
            "battery_level": 1,
            "battery_voltage": 28.5,
            "battery_current": -3.25,
            "battery_percentage": 0.75,
        },
        {
            "/diagnostics": {
                "header": {"stamp": STAMP},
                "status": [
                    {
                        "level": 1,
                        "name": "unicon: battery",
                        "hardware_id": "go2",
                        "values": [
                            {"key": "voltage [V]", "value": "   28.50"},
                            {"key": "current [A]", "value": "   -3.25"},
                            {"key": "charge [%]", "value": "  75.0"},
                        ],
                    }
                ],
            }
        },
        {
            "/diagnostics": (
                {
                    "status": [
                        {"level": 1, "name": "somebody: else"},
                        {"level": 2, "name": "unicon: driver", "message": "hot"},
                    ]
                },
                {"driver_level": 2},
            )
        },
    ),
    "forward_command_in": Case(
        hears={
            "forward_position_controller/commands": (
                {"data": ramp(4.0)},
                {"joint_pos_command": ramp(4.0)},
            )
        }
    ),
    "forward_command_out": Case(
        {"joint_pos_target": ramp(4.0)},
        {"forward_position_controller/commands": {"data": ramp(4.0)}},
    ),
    "imu_odometry_in": Case(
        hears={
            "imu/data": (IMU, BASE),
            "odom": (
                {
                    "pose": {"pose": {"position": vector([10.5, -2.25, 0.375])}},
                    "twist": {"twist": {"linear": vector([0.5, 0.125, -0.25])}},
                },
                PLACE,
            ),
        }
    ),
    "joint_command_in": Case(
        hears={
            "joint_command": (
                {
                    "name": SHUFFLED,
                    "position": ramp(4.0)[::-1],
                    "velocity": ramp(5.0)[::-1],
                    "effort": ramp(6.0)[::-1],
                },
                WANTED,
            )
        }
    ),
    "joint_state_in": Case(hears={"joint_states": (MEASURED, {**ROBOT, "stamp_ns": STAMP_NS})}),
    "joint_trajectory_out": Case(
        {"joint_pos_target": ramp(4.0), "joint_vel_target": ramp(5.0)},
        {
            "joint_trajectory_controller/joint_trajectory": {
                "header": {"stamp": {"sec": 0, "nanosec": 0}},
                "joint_names": NAMES,
                "points": [
                    {
                        "positions": ramp(4.0),
                        "velocities": ramp(5.0),
                        "time_from_start": {"sec": 0, "nanosec": 20_000_000},
                    }
                ],
            }
        },
    ),
    "joy": Case(
        hears={
            "joy": (
                {"axes": [0.5, 0.25, 9.0, -1.0], "buttons": [1]},
                {"velocity_command": [0.25, 0.25, -1.0]},
            )
        }
    ),
    "navigation": Case(
        {
            "stamp_ns": STAMP_NS,
            **ROBOT,
            **BASE,
            **PLACE,
            "base_pos_w_variance": 0.25,
            "base_lin_vel_variance": 0.125,
        },
        {
            "joint_states": {"header": {"stamp": STAMP}, "name": NAMES, "position": ramp(1.0)},
            "imu/data": {"header": {"stamp": STAMP, "frame_id": "imu_link"}, **IMU},
            "odom": {
                "header": {"stamp": STAMP, "frame_id": "odom"},
                "child_frame_id": "base_link",
                "pose": {
                    "pose": {
                        "position": vector([10.5, -2.25, 0.375]),
                        "orientation": QUATERNION,
                    },
                    "covariance": diagonal(0.25, 0.25, 1e-4, 1e-4, 1e-4, 1e-2),
                },
                "twist": {
                    "twist": {
                        "linear": vector([0.5, 0.125, -0.25]),
                        "angular": vector([0.25, 0.5, 0.75]),
                    },
                    "covariance": diagonal(0.125, 0.125, 0.125, 4e-4, 4e-4, 4e-4),
                },
            },
            "/clock": {"clock": STAMP},
        },
        {"cmd_vel": (TWIST, COMMAND)},
    ),
    "odometry_in": Case(
        {"stamp_ns": STAMP_NS, **ROBOT, **BASE},
        {
            "joint_states": {"header": {"stamp": STAMP}, "name": NAMES, "position": ramp(1.0)},
            "imu/data": {"header": {"stamp": STAMP, "frame_id": "imu_link"}, **IMU},
        },
        {
            "odom": (
                {
                    "header": {"stamp": STAMP, "frame_id": "odom"},
                    "pose": {"pose": {"position": vector([10.5, -2.25, 0.375])}},
                    "twist": {"twist": {"linear": vector([0.5, 0.125, -0.25])}},
                },
                {**PLACE, "odometry_stamp_ns": STAMP_NS},
            ),
            "cmd_vel": (TWIST, COMMAND),
        },
    ),
    "pose_stamped": Case(
        {"stamp_ns": STAMP_NS, "base_pos_w": PLACE["base_pos_w"], "base_quat": WXYZ},
        {
            "pose": {
                "header": {"stamp": STAMP, "frame_id": "map"},
                "pose": {"position": vector([10.5, -2.25, 0.375]), "orientation": QUATERNION},
            }
        },
        {
            "mocap/pose": (
                {"pose": {"position": vector([1.5, 2.5, 3.5]), "orientation": QUATERNION}},
                {"mocap_pos_w": [1.5, 2.5, 3.5], "mocap_quat": WXYZ},
            )
        },
    ),
    "ros_robot": Case(
        {"stamp_ns": STAMP_NS, **TARGETS},
        {
            "joint_commands": {
                "header": {"stamp": STAMP},
                "name": NAMES,
                "position": ramp(4.0),
                "velocity": ramp(5.0),
                "effort": ramp(6.0),
            }
        },
        {
            "joint_states": (
                MEASURED,
                {"stamp_ns": STAMP_NS, "joint_pos": ramp(1.0), "joint_vel": ramp(2.0)},
            ),
            "imu/data": (IMU, BASE),
        },
    ),
    "temperature": Case(
        {"stamp_ns": STAMP_NS, "temperature": 41.5},
        {
            "temperature": {
                "header": {"stamp": STAMP, "frame_id": "base_link"},
                "temperature": 41.5,
                "variance": 0.0,
            }
        },
        {"ambient_temperature": ({"temperature": 21.25}, {"ambient_temperature": 21.25})},
    ),
    "transform_in": Case(
        hears={
            "/tf": (
                {
                    "transforms": [
                        {"header": {"frame_id": "odom"}, "child_frame_id": "camera"},
                        TRANSFORM,
                    ]
                },
                {"base_pos_w": PLACE["base_pos_w"], "base_quat": WXYZ},
            )
        },
        packages=("tf2_msgs",),
    ),
    "twist_stamped": Case(hears={"cmd_vel": ({"twist": TWIST}, COMMAND)}),
    "unitree_go": unitree(12, 20, hg=False),
    "unitree_hg": unitree(29, 35, hg=True),
    "wrench_stamped": Case(
        {"stamp_ns": STAMP_NS, "wrench": ramp(1.0, 6)},
        {
            "wrench": {
                "header": {"stamp": STAMP, "frame_id": "wrench_link"},
                "wrench": {"force": vector(ramp(1.0, 3)), "torque": vector(ramp(1.375, 3))},
            }
        },
        {
            "wrench_command": (
                {"wrench": {"force": vector(ramp(7.0, 3)), "torque": vector(ramp(8.0, 3))}},
                {"wrench_command": [*ramp(7.0, 3), *ramp(8.0, 3)]},
            )
        },
    ),
}
# /tf of the default map is left out without tf2_msgs; with it, it is one more case.
TF_OUT = {"transforms": [TRANSFORM]}


def holds(message: Any, expected: Any) -> bool:
    """Tell whether a message has everything expected; lists are whole."""
    if isinstance(expected, dict):
        return all(holds(message[name], value) for name, value in expected.items())
    if isinstance(expected, list):
        return len(message) == len(expected) and all(
            holds(one, other) for one, other in zip(message, expected)
        )
    return bool(message == expected)
