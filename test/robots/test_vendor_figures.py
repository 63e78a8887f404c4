"""Where a vendor's own files contradict each other: what each says, what ours says, and why.

The rule is the narrower limit: a robot that is told less than it can takes no harm. What is not a
limit (gains, poses, orders) is a vendor's newer or real-robot file, and said here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from unicon_core.robots import load_robot


@dataclass(frozen=True)
class Bound:
    """A limit of which the vendor says several.

    Attributes:
        robot: the robot file.
        part: of the joints' names.
        field: `lower`, `upper`, `velocity` or `effort`.
        said: who says what; the narrowest is ours.
    """

    robot: str
    part: str
    field: str
    said: dict[str, float]

    @property
    def narrowest(self) -> float:
        """What all of them allow."""
        values = self.said.values()
        return max(values) if self.field == "lower" else min(values)


def both(robot: str, part: str, **said: float) -> list[Bound]:
    """Return the bounds ± of a joint."""
    lower = {who: -value for who, value in said.items()}
    return [Bound(robot, part, "lower", lower), Bound(robot, part, "upper", dict(said))]


# MJCF and URDF are the vendor's models, SDK its library's constants, the others files of its own.
BOUNDS = [
    *both("adam_lite", "waistRoll", mjcf=0.52, urdf=0.226),
    Bound("adam_lite", "kneePitch", "lower", {"mjcf": -0.09, "urdf": 0.052}),
    Bound("adam_lite", "kneePitch", "upper", {"mjcf": 2.4, "urdf": 2.391}),
    Bound("adam_lite", "hipRoll_Left", "lower", {"mjcf": -0.78, "urdf": -0.733}),
    Bound("adam_lite", "hipRoll_Right", "upper", {"mjcf": 0.78, "urdf": 0.733}),
    Bound("adam_lite", "shoulderRoll_Left", "upper", {"mjcf": 3.14, "urdf": 2.74}),
    Bound("adam_lite", "shoulderRoll_Right", "lower", {"mjcf": -3.14, "urdf": -2.74}),
    Bound("gr1t2", "ankle_pitch", "effort", {"wiki_urdf": 41.67, "lab_urdf": 15.0}),
    Bound("gr1t2", "ankle_roll", "effort", {"wiki_urdf": 41.67, "lab_urdf": 30.0}),
    Bound("gr1t2", "hip_roll", "effort", {"wiki_urdf": 84.18, "lab_urdf": 48.0}),
    *both("go1", "hip", urdf=0.863, sdk=1.047),
    Bound("go1", "thigh", "lower", {"urdf": -0.686, "sdk": -0.663}),
    Bound("go1", "thigh", "upper", {"urdf": 4.501, "sdk": 2.966}),
    Bound("go1", "calf", "lower", {"urdf": -2.818, "sdk": -2.721}),
    Bound("go1", "calf", "upper", {"urdf": -0.888, "sdk": -0.837}),
    Bound("aliengo", "hip", "lower", {"sdk": -0.873}),
    Bound("aliengo", "hip", "upper", {"sdk": 1.047, "urdf": 0.873}),
    Bound("aliengo", "thigh", "lower", {"sdk": -0.524}),
    Bound("aliengo", "thigh", "upper", {"sdk": 3.927}),
    Bound("aliengo", "calf", "lower", {"sdk": -2.775}),
    Bound("aliengo", "calf", "upper", {"sdk": -0.611, "urdf": -0.646}),
    Bound("t1", "Hip_Pitch", "lower", {"assets": -3.002, "gym": -1.8}),
    Bound("t1", "Hip_Pitch", "upper", {"assets": 2.2166, "gym": 1.57}),
    Bound("t1", "Hip_Pitch", "velocity", {"assets": 15.2, "gym": 12.5}),
    Bound("t1", "Knee", "velocity", {"assets": 14.7, "gym": 11.7}),
    Bound("t1", "Ankle_Pitch", "effort", {"assets": 24.0, "gym_urdf": 20.0, "gym_real": 24.0}),
    Bound("t1", "Ankle_Roll", "effort", {"assets": 15.0, "gym_real": 15.0}),
    Bound("t1", "Shoulder", "effort", {"assets": 18.0, "gym_real": 10.0}),
    Bound("t1", "Elbow", "effort", {"assets": 18.0, "gym_real": 10.0}),
    Bound("t1", "Waist", "effort", {"assets": 25.0, "gym_real": 30.0}),
    *both("atom", "ankle_roll", document=0.48, json=0.24),
    Bound("atom", "hip_pitch", "lower", {"json": -1.7}),
    Bound("atom", "hip_pitch", "upper", {"json": 1.8}),
    Bound("atom", "knee", "upper", {"json": 2.0}),
    Bound("atom", "ankle_pitch", "lower", {"recorded": -0.8727}),
    Bound("atom", "ankle_pitch", "upper", {"recorded": 0.5236}),
    Bound("atom", "right_shoulder_roll", "lower", {"recorded": -3.14}),
    Bound("atom", "right_shoulder_roll", "upper", {"recorded": 0.43}),
    Bound("atom", "elbow_pitch", "lower", {"recorded": -0.87}),
    Bound("atom", "elbow_pitch", "upper", {"recorded": 1.48}),
    *both("azureloong", "_06", urdf=1.8326, newer=1.5708),
    *both("azureloong", "_07", urdf=1.0472, newer=1.309),
    Bound("azureloong", "arm_l_05", "effort", {"urdf": 12.4, "driver": 11.5}),
    Bound("azureloong", "arm_r_07", "effort", {"urdf": 12.4, "driver": 11.5}),
    Bound("azureloong", "_l_06", "effort", {"urdf": 12.4, "driver": 11.5}),
    # The SDK's limits of the Dex3 are wider than its URDF's at the thumbs' second joints.
    Bound("dex3_left", "thumb_1", "lower", {"urdf": -0.610865, "sdk": -0.724}),
    Bound("dex3_left", "thumb_1", "upper", {"urdf": 1.0472, "sdk": 1.05}),
    Bound("dex3_right", "thumb_1", "lower", {"urdf": -1.0472, "sdk": -1.05}),
    Bound("dex3_right", "thumb_1", "upper", {"urdf": 0.610865, "sdk": 0.742}),
    *both("dex3_left", "thumb_0", urdf=1.0472, sdk=1.05),
    *both("dex3_right", "thumb_0", urdf=1.0472, sdk=1.05),
    Bound("dex3_left", "middle_0", "lower", {"urdf": -1.5708, "sdk": -1.57}),
    Bound("x2", "left_wrist_roll", "lower", {"urdf": -1.5097, "sdk": -1.571}),
    Bound("x2", "waist_yaw", "upper", {"urdf": 2.2078, "sdk": 2.382}),
    Bound("x2", "left_wrist_pitch", "upper", {"urdf": 0.5236, "sdk": 0.558}),
]


@pytest.mark.parametrize("bound", BOUNDS, ids=lambda b: f"{b.robot}-{b.part}-{b.field}")
def test_limits_are_what_all_of_the_vendors_files_allow(bound: Bound) -> None:
    robot = load_robot(bound.robot)
    found = [
        float(value)
        for name, value in zip(robot.joint_names, robot.joint_fact(bound.field))
        if bound.part in name
    ]
    assert found
    np.testing.assert_allclose(found, bound.narrowest, atol=1.1e-3)


# robot, field, joints in order, what the vendor's figure is and where it stands.
CHOSEN: list[tuple[str, str, tuple[str, ...], list[float], str]] = [
    (
        "adam_lite",
        "damping",
        ("waistRoll", "waistPitch", "waistYaw"),
        [6.1, 6.1, 4.1],
        "joint_pd_config.json and lite_run.yaml; the example's 4.1, 6.1, 6.1 go by another order",
    ),
    (
        "adam_lite",
        "stiffness",
        ("anklePitch_Left", "ankleRoll_Left", "hipRoll_Left"),
        [25.0, 0.0, 700.0],
        "lite_run.yaml: kps",
    ),
    (
        "adam_lite",
        "default",
        ("hipPitch_Left", "hipYaw_Left", "hipYaw_Right", "kneePitch_Left", "elbow_Left"),
        [-0.32, -0.18, 0.18, 0.66, -0.3],
        "lite_run.yaml: default_angles",
    ),
    (
        "x2",
        "default",
        ("left_hip_pitch_joint", "left_knee_joint", "right_shoulder_roll_joint"),
        [-0.312, 0.669, -0.2],
        "a third party's",
    ),
    (
        "dex3_left",
        "stiffness",
        ("left_hand_thumb_0_joint", "left_hand_index_1_joint"),
        [1.5, 1.5],
        "g1_dex3_example.cpp: gripMotors",
    ),
]


@pytest.mark.parametrize(
    ("name", "field", "joints", "figures", "source"), CHOSEN, ids=lambda v: str(v)[:20]
)
def test_what_is_chosen_is_the_figure_of_the_named_file(
    name: str, field: str, joints: tuple[str, ...], figures: list[float], source: str
) -> None:
    robot = load_robot(name)
    values = robot.joint_fact(field)
    ours = [values[robot.joint_names.index(joint)] for joint in joints]
    np.testing.assert_allclose(ours, figures, rtol=1e-6, err_msg=source)


@pytest.mark.parametrize(
    ("name", "group", "part"),
    [("adam_lite", slice(12, 15), "waist"), ("gr1t2", slice(22, 25), "left_wrist")],
)
def test_orders_that_files_contradict_each_other_about(name: str, group: slice, part: str) -> None:
    order = {
        "waist": ("waistRoll", "waistPitch", "waistYaw"),
        "left_wrist": tuple(f"left_wrist_{axis}_joint" for axis in ("yaw", "pitch", "roll")),
    }
    assert load_robot(name).joint_names[group] == order[part]
