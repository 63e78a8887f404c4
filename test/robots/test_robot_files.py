"""What holds for every robot file of the project."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from unicon_core.robots import load_robot, robot_names
from unicon_core.robots.robot import JOINT_FIELDS

ROBOTS = Path(__file__).resolve().parents[2] / "config" / "robots"
NAMES = sorted(path.stem for path in ROBOTS.glob("*.yaml"))

# Joints by the vendors' own documents: see `sources` in each file.
JOINTS = {
    "a1": 12,
    "adam_lite": 23,
    "aliengo": 12,
    "arx_x5": 6,
    "atom": 29,
    "azureloong": 31,
    "dex3_left": 7,
    "dex3_right": 7,
    "g1_23dof": 23,
    "g1_29dof": 29,
    "go1": 12,
    "go2": 12,
    "gr1t2": 32,
    "h1": 19,
    "h1_2": 27,
    "inspire_rh56_dfx_left": 6,
    "inspire_rh56_dfx_right": 6,
    "inspire_rh56_ftp_left": 6,
    "inspire_rh56_ftp_right": 6,
    "inspire_rh56_left": 6,
    "inspire_rh56_right": 6,
    "n1": 23,
    "rohand": 6,
    "t1": 23,
    "x2": 31,
    "xhand1_left": 12,
    "xhand1_right": 12,
}


def test_every_supported_robot_has_a_file() -> None:
    assert set(JOINTS) <= set(NAMES)
    assert set(NAMES) <= set(robot_names())


@pytest.mark.parametrize("name", NAMES)
def test_file_loads_with_its_number_of_joints(name: str) -> None:
    robot = load_robot(name)
    assert robot.name == name
    assert robot.num_joints == JOINTS.get(name, robot.num_joints)
    for key in JOINT_FIELDS:
        array = robot.joint_fact(key)
        assert array.shape == (robot.num_joints,)
        assert array.dtype == np.float32
        assert not array.flags.writeable


@pytest.mark.parametrize("name", NAMES)
def test_sources_name_a_file_or_say_that_the_figure_is_ours(name: str) -> None:
    for group, text in load_robot(name).sources.items():
        named = "/" in text or text.startswith(("ours", "the open hand", "the same home pose"))
        assert named or "aimdk" in text, f"{group}: {text}"


@pytest.mark.parametrize("name", NAMES)
def test_motor_list_has_one_slot_per_joint(name: str) -> None:
    robot = load_robot(name)
    for key in ("motors", "motor_id", "motor_type", "actuators", "actuator_sign"):
        if key in robot.transport:
            assert len(robot.transport[key]) == robot.num_joints, key
    motors = robot.transport.get("motors", [])
    assert list(motors) == sorted(set(motors))


@pytest.mark.parametrize("name", NAMES)
def test_left_and_right_joints_have_mirrored_limits(name: str) -> None:
    """A swapped pair of figures shows here: a limit is the same on both sides, or its mirror."""
    robot = load_robot(name)
    index = {joint: i for i, joint in enumerate(robot.joint_names)}
    for joint, i in index.items():
        other = joint.replace("left", "right").replace("Left", "Right").replace("_l_", "_r_")
        j = index.get(other, i)
        a = (robot.lower[i], robot.upper[i])
        b = (robot.lower[j], robot.upper[j])
        if i == j or np.isnan((*a, *b)).any():
            continue
        # Vendors round the sides differently, Booster and PND by up to 0.1 rad.
        same = np.allclose(a, b, atol=0.11)
        mirrored = np.allclose(a, (-b[1], -b[0]), atol=0.11)
        assert same or mirrored, f"{joint}: {a} against {other}: {b}"
        for key in ("velocity", "effort", "stiffness", "damping"):
            if (name, key) == ("atom", "damping") and "elbow_pitch" in joint:
                continue  # 8 and 4 in the vendor's own controlParams.json
            fact = robot.joint_fact(key)
            assert np.allclose(fact[i], fact[j], rtol=1e-2, equal_nan=True), f"{joint}: {key}"


def test_robot_that_lacks_facts_says_which() -> None:
    assert load_robot("g1_29dof").missing_facts() == []
    assert load_robot("aliengo").missing_facts() == ["joints.stiffness", "joints.damping"]
    assert load_robot("dex3_right").missing_facts() == ["joint_order"]
    assert load_robot("n1").missing_facts() == [
        "transport.stiffness_scale",
        "transport.damping_scale",
        "transport.timeout_mode",
    ]
    assert load_robot("atom").missing_facts() == [
        "joints.default",
        "joints.velocity",
        "joints.effort",
    ]


def test_hand_that_closes_its_own_loop_needs_no_gains() -> None:
    hand = load_robot("inspire_rh56_left")
    assert hand.position_controlled
    assert np.isnan(hand.joint_stiffness).all()
    assert hand.missing_facts() == []


def test_imu_whose_axes_are_unknown_is_missing_for_a_robot_that_walks(tmp_path: Path) -> None:
    text = (ROBOTS / "go1.yaml").read_text("utf-8")
    text = text.replace("quat: [1, 0, 0, 0]", "quat: null").replace(
        "unknown: [joints.rest]", "unknown: [joints.rest, imu.quat]"
    )
    path = tmp_path / "go1.yaml"
    path.write_text(text, "utf-8")
    robot = load_robot(path)
    assert robot.imu is not None
    assert np.isnan(robot.imu.quat).all()
    assert robot.missing_facts() == ["imu.quat"]
