"""What drivers read of a robot file's `transport` is what the vendors' SDKs say.

Each row is one fact with the file that it stands in. A driver has none of these in its code.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from unicon_core.robots import load_robot, robot_names

FACTS: dict[str, list[tuple[str, dict[str, Any]]]] = {
    "unitree_sdk2_python example/go2/low_level; idl unitree_go: 20 slots": [
        ("go2", {"domain": 0, "state_topic": "rt/lowstate", "command_topic": "rt/lowcmd"}),
        ("go2", {"head": [0xFE, 0xEF], "level_flag": 0xFF, "motor_mode": 1}),
        ("go2", {"num_motor_slots": 20, "rate_hz": 500}),
    ],
    "unitree_sdk2_python example/b2/low_level/b2_stand_example.py": [
        ("b2", {"domain": 0, "state_topic": "rt/lowstate", "command_topic": "rt/lowcmd"}),
        ("b2", {"head": [0xFE, 0xEF], "level_flag": 0xFF, "motor_mode": 1, "num_motor_slots": 20}),
        ("b2", {"rate_hz": 500, "release": {"before": ["sport", 1005], "wait": 1.0}}),
    ],
    "unitree_sdk2 example/h1/low_level/humanoid.hpp; unitree_rl_gym h1.yaml: weak_motor": [
        ("h1", {"head": [0xFE, 0xEF], "level_flag": 0xFF, "num_motor_slots": 20}),
        ("h1", {"motors": [*range(9), *range(10, 20)], "motor_mode": [10] * 9 + [1] * 10}),
        ("h1", {"unused_slots": {9: 10}, "imu_parent": "torso_link"}),
    ],
    "unitree_sdk2 example/g1/low_level/g1_ankle_swing_example.cpp": [
        ("g1_29dof", {"mode_pr": 0, "mode_machine": 5, "motors": list(range(29))}),
        ("g1_23dof", {"mode_pr": 0, "mode_machine": 4}),
        ("g1_23dof", {"motors": [*range(13), *range(15, 20), *range(22, 27)]}),
        ("h1_2", {"mode_pr": 0, "motors": list(range(27)), "imu_parent": "torso_link"}),
    ],
    "unitree_legged_sdk include/unitree_legged_sdk/udp.h, comm.h, quadruped.h": [
        ("go1", {"address": "192.168.123.10", "port": 8007, "level_flag": 0xFF, "motor_mode": 10}),
        ("aliengo", {"address": "192.168.123.10", "port": 8007, "motor_mode": 10}),
        ("a1", {"address": "192.168.123.10", "port": 8007, "motor_mode": 10}),
    ],
    "unitree_sdk2 example/g1/dex3/g1_dex3_example.cpp": [
        ("dex3_left", {"command_topic": "rt/dex3/left/cmd", "status": 1}),
        ("dex3_left", {"slow_state_topic": "rt/lf/dex3/left/state"}),
        ("dex3_left", {"num_motor_slots": 7, "num_press_sensors": 9}),
        ("dex3_right", {"command_topic": "rt/dex3/right/cmd", "num_motor_slots": 7}),
        ("dex3_right", {"stop": {"status": 1, "timeout": 1, "stiffness": 0.0, "damping": 0.0}}),
    ],
    "inspire_hand_ws inspire_hand_sdk/inspire_sdkpy/inspire_sdk.py": [
        ("inspire_rh56_left", {"address": "192.168.11.210", "port": 6000, "device_id": 1}),
        ("inspire_rh56_left", {"register_angle_set": 1486, "register_angle_actual": 1546}),
        ("inspire_rh56_right", {"baudrate": 115200, "raw_lower": 1000, "raw_upper": 0}),
        ("inspire_rh56_ftp_left", {"command_topic": "rt/inspire_hand/ctrl/l", "domain": 0}),
        ("inspire_rh56_ftp_right", {"state_topic": "rt/inspire_hand/state/r", "raw_lower": 1000}),
    ],
    "roh_firmware protocol/OHandModBusRTUProtocol_EN.md": [
        ("rohand", {"node_id": 2, "baudrate": 115200, "parity": "none"}),
        ("rohand", {"register_angle_target": 1155, "register_angle": 1165, "angle_scale": 0.01}),
        ("rohand", {"register_position_target": 1135, "register_position": 1145}),
    ],
    "fi_fsa/v1, v2: ports of an actuator": [
        ("gr1t2", {"port_control": 2333, "port_comm": 2334, "port_fast": 2335, "unit": "deg"}),
        ("n1", {"port_control": 2333, "port_comm": 2334, "port_fast": 2335, "unit": "deg"}),
        ("n1", {"aurora_domain": 123}),
    ],
    "loong_sim_sdk_release config/interface.ini, tools/py_ui.py": [
        ("azureloong", {"port": 8006, "port_keys": 8000, "checker": 3480, "state": 5}),
        ("azureloong", {"fingers_left": 6, "fingers_right": 6}),
    ],
    "booster_robotics_sdk include/booster/robot/b1, idl/b1; booster_gym deploy/deploy.py": [
        ("t1", {"domain": 0, "state_topic": "rt/low_state", "command_topic": "rt/joint_ctrl"}),
        ("t1", {"command_types": {"PARALLEL": 0, "SERIAL": 1}, "command_type": "SERIAL"}),
        ("t1", {"robot_modes": {"damping": 0, "prepare": 1, "walking": 2, "custom": 3}}),
        ("t1", {"rpc": {"change_mode": 2000, "move": 2001, "get_mode": 2017}}),
        ("t1", {"start_up": ["damping", "prepare", "first_command", "custom"]}),
        ("t1", {"largest_tilt": 1.0, "rate_hz": 500, "imu_orientation": "rpy"}),
        ("t1", {"parallel_motors": [15, 16, 21, 22]}),
    ],
    "pnd_sdk_python idl; pnd_rl_gym deploy/deploy_real": [
        ("adam_lite", {"domain": 1, "state_topic": "rt/lowstate", "command_topic": "rt/lowcmd"}),
        ("adam_lite", {"hand_command_topic": "rt/handcmd", "num_motor_slots": 23}),
        ("adam_lite", {"mode_pr": 0, "motor_mode": 1, "damping_gain": 8.0}),
        ("adam_lite", {"remote": {"floats": 19, "full": 32767.0, "dead_zone": 5000.0}}),
    ],
    "dobot_atom_sdk config/dds_parameter.json, idl, rpc; dobot_atom_ros2 DDS接口整理.md": [
        ("atom", {"domain": 0, "address": "192.168.8.234", "motor_mode": 1}),
        ("atom", {"lower_command_topic": "rt/lower/cmd", "upper_command_topic": "rt/upper/cmd"}),
        ("atom", {"fsm_topic": "rt/set/fsm/id", "emergency_state_topic": "rt/emergency/state"}),
        ("atom", {"switch_topic": "rt/switch/upper/control"}),
        ("atom", {"lower_motors": list(range(12)), "upper_motors": list(range(12, 29))}),
        ("atom", {"gyro_unit": "deg/s", "rpy_unit": "deg"}),
        ("atom", {"rpc_ports": {"algorithms": 51234, "control": 51235}}),
    ],
    "x2-aimdk.agibot.com: joint control": [
        ("x2", {"groups": {"leg": 12, "waist": 3, "arm": 14, "head": 2}, "rate_hz": 500}),
        ("x2", {"not_commanded": ["head_pitch_joint"], "state_durability": "transient_local"}),
        ("x2", {"state_qos": "best_effort", "command_qos": "reliable"}),
    ],
    "arx5-sdk include/app/config.h": [
        ("arx_x5", {"motor_id": [1, 2, 4, 5, 6, 7], "gripper_motor_id": 8}),
        ("arx_x5", {"motor_type": ["EC_A4310"] * 3 + ["DM_J4310"] * 3}),
    ],
    "XhandControl xhandlib/xhand.py": [
        ("xhand1_left", {"baudrate": 3_000_000, "kp": 100, "ki": 0, "kd": 0, "max_torque": 300}),
        ("xhand1_right", {"mode": 3, "modes": {"powerless": 0, "position": 3, "powerful": 5}}),
        ("xhand1_right", {"module": "xhand_controller", "unit": "rad"}),
    ],
}
ROWS = [
    pytest.param(robot, facts, source, id=f"{robot}-{next(iter(facts))}")
    for source, rows in FACTS.items()
    for robot, facts in rows
]


@pytest.mark.parametrize(("robot", "facts", "source"), ROWS)
def test_transport_is_what_the_sdk_says(robot: str, facts: dict[str, Any], source: str) -> None:
    transport = load_robot(robot).transport
    assert {key: transport.get(key) for key in facts} == facts, source


def test_both_sides_of_a_hand_differ_in_nothing_but_the_side() -> None:
    for pair in ("dex3", "xhand1", "inspire_rh56", "inspire_rh56_ftp", "inspire_rh56_dfx"):
        left, right = (dict(load_robot(f"{pair}_{side}").transport) for side in ("left", "right"))
        assert set(left) == set(right), pair
        for key in set(left) - {"side", "motors", "address"}:
            same = str(right[key]).replace("right", "left")
            same = same.removesuffix("/r") + "/l" if same.endswith("/r") else same
            assert same == str(left[key]), f"{pair}: {key}"


def test_every_robot_has_a_row() -> None:
    have = {robot for rows in FACTS.values() for robot, _ in rows}
    same_as = {"inspire_rh56_dfx_left", "inspire_rh56_dfx_right"}  # in their own test of attacks
    assert have | same_as == set(robot_names())


def test_azureloongs_gains_and_efforts_are_within_its_drivers_clamps() -> None:
    """What is beyond them would be cut on the robot unseen (config/driver.ini)."""
    robot = load_robot("azureloong")
    arm, rest = [80, 80, 58, 58, 11.5, 11.5, 11.5], [26, 26, 315, 315, 121]
    effort = np.array([*arm, *arm, *rest, *([320, 192, 396, 396, 104, 104] * 2)])
    stiffness, damping = np.repeat([20.0, 1000.0], [19, 12]), np.repeat([0.1, 10.0], [19, 12])
    assert (robot.effort_limit <= effort + 1e-6).all()
    assert (robot.joint_stiffness <= stiffness).all()
    assert (robot.joint_damping <= damping + 1e-6).all()


def test_t1s_ankles_are_a_torque_servo_with_no_gains_of_the_motors() -> None:
    robot = load_robot("t1")
    servo = robot.transport["torque_servo"]
    names = [robot.joint_names[k] for k in servo["motors"]]
    assert all("Ankle" in name for name in names)
    assert sum("Ankle" in name for name in robot.joint_names) == len(names)
    assert (servo["stiffness"], servo["motor_stiffness"], servo["motor_damping"]) == (50, 0, 3)


def test_transport_keys_that_name_joints_are_the_robots_own() -> None:
    assert set(load_robot("x2").transport["not_commanded"]) < set(load_robot("x2").joint_names)
    groups = load_robot("x2").transport["groups"]
    assert sum(groups.values()) == load_robot("x2").num_joints
