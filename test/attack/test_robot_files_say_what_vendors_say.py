"""Robot files hold the vendors' figures, the narrower where two of a vendor's files differ."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from unicon_core.robots import Robot, load_robot


def fact(robot: Robot, field: str, *joints: str) -> list[float]:
    values = robot.joint_fact(field)
    return [round(float(values[robot.joint_names.index(name)]), 4) for name in joints]


def test_adam_lites_waist_is_damped_by_name() -> None:
    robot = load_robot("adam_lite")
    waist = ("waistRoll", "waistPitch", "waistYaw")
    assert fact(robot, "damping", *waist) == [6.1, 6.1, 4.1]
    assert [robot.joint_names.index(name) for name in waist] == [12, 13, 14]


def test_adam_lite_can_be_driven_from_its_real_pose() -> None:
    robot = load_robot("adam_lite")
    assert robot.missing_facts() == []
    leg = ("hipPitch", "hipRoll", "hipYaw", "kneePitch", "anklePitch", "ankleRoll")
    left = fact(robot, "default", *(f"{name}_Left" for name in leg))
    right = fact(robot, "default", *(f"{name}_Right" for name in leg))
    assert left == [-0.32, 0.0, -0.18, 0.66, -0.39, 0.0]
    assert right == [-0.32, 0.0, 0.18, 0.66, -0.39, 0.0]
    assert fact(robot, "default", "shoulderRoll_Left", "shoulderRoll_Right") == [0.1, -0.1]
    assert fact(robot, "stiffness", "anklePitch_Left", "anklePitch_Right") == [25.0, 25.0]


def test_rohands_ranges_are_those_of_its_registers() -> None:
    robot = load_robot("rohand")
    degrees = np.degrees([robot.lower, robot.upper]).T
    said = [(2.26, 36.76), (100.22, 178.37), (97.81, 176.06), (101.38, 176.54), (98.84, 174.86)]
    np.testing.assert_allclose(degrees, [*said, (0.0, 90.0)], atol=0.01)
    assert (degrees[:5, 0] >= [low for low, _ in said]).all()
    assert (degrees[:5, 1] <= [high for _, high in said]).all()
    np.testing.assert_array_equal(robot.default_joint_pos[:5], robot.upper[:5])  # the open hand
    assert robot.missing_facts() == []


def test_gr1t2s_wrists_stand_as_yaw_pitch_roll_and_stay_refused() -> None:
    robot = load_robot("gr1t2")
    for side, first in (("left", 22), ("right", 29)):
        names = [f"{side}_wrist_{axis}_joint" for axis in ("yaw", "pitch", "roll")]
        assert list(robot.joint_names[first : first + 3]) == names
    assert robot.missing_facts() == [
        "joint_order",
        "transport.encoder_zero",
        "transport.reduction_ratio",
        "transport.pole_pairs",
        "transport.torque_constant",
    ]


def test_the_rh56_has_three_interfaces() -> None:
    for side, motors in (("left", range(6, 12)), ("right", range(6))):
        modbus = load_robot(f"inspire_rh56_{side}")
        ftp = load_robot(f"inspire_rh56_ftp_{side}").transport
        dfx = load_robot(f"inspire_rh56_dfx_{side}").transport
        assert modbus.transport["protocol"] == "inspire"
        assert ftp["protocol"] == "inspire_ftp"
        assert ftp["command_topic"] == f"rt/inspire_hand/ctrl/{side[0]}"
        assert dfx["protocol"] == "inspire_dfx"
        assert (dfx["command_topic"], dfx["state_topic"]) == ("rt/inspire/cmd", "rt/inspire/state")
        assert dfx["motors"] == list(motors)
        assert (dfx["raw_lower"], dfx["raw_upper"]) == (1.0, 0.0)  # open is 1


def test_aliengos_protocol_has_to_be_told() -> None:
    transport = load_robot("aliengo").transport
    assert "local_port" not in transport
    ports = [each["local_port"] for each in transport["generations"].values()]
    assert ports == [8080, 8082, 8008]


SAID: list[tuple[str, str, Any]] = [
    ("t1", "torque_servo", {"motors": [15, 16, 21, 22], "stiffness": 50.0, "motor_stiffness": 0.0}),
    ("x2", "not_commanded", ["head_pitch_joint"]),
    ("atom", "rpy_unit", "deg"),
    ("h1", "unused_slots", {9: 10}),
]


@pytest.mark.parametrize(("name", "key", "value"), SAID)
def test_transports_say_what_a_driver_needs(name: str, key: str, value: Any) -> None:
    found = load_robot(name).transport[key]
    if isinstance(value, dict):
        assert value.items() <= found.items()
    else:
        assert found == value


def test_what_is_missing_is_still_refused() -> None:
    assert load_robot("dex3_right").missing_facts() == ["joint_order"]
    assert load_robot("x2").missing_facts() == ["joints.default"]
    assert "joints.effort" in load_robot("atom").missing_facts()
    x2 = load_robot("x2")
    assert fact(x2, "default", "left_knee_joint", "right_shoulder_roll_joint") == [0.669, -0.2]
    assert "third party" in x2.sources["default"]
