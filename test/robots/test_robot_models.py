"""Names, order and limits agree with the vendors' models, where these are at hand.

The models are other people's and are not part of the project: they are found through
`UNICON_ASSETS`, else beside the checkout.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest

from unicon_core.resources import assets_root
from unicon_core.robots import load_robot

# Robot -> model below the assets folder: the MJCF or URDF named in the file's `sources`.
MODELS = {
    "a1": "models/a1/a1.urdf",
    "azureloong": "models/azureloong/AzureLoong.xml",
    "g1_23dof": "models/g1_23dof/g1_23dof.xml",
    "g1_29dof": "models/g1_29dof/g1_29dof.xml",
    "go1": "models/go1/go1.xml",
    "go2": "models/go2/go2.xml",
    "h1": "models/h1/h1.xml",
    "h1_2": "models/h1_2/h1_2_handless.xml",
    "n1": "models/n1/FOURIERN1.urdf",
    "t1": "models/t1/T1_23dof.xml",
}

# The vendor's MJCF and URDF differ: the file has the narrower limit of both.
NARROWER = {"t1"}


def _joints(path: Path) -> dict[str, tuple[float, float]]:
    """Return the limits of the hinge and slide joints of an MJCF or URDF, in file order."""
    root = ET.parse(path).getroot()
    if root.tag == "robot":
        return {
            joint.get("name", ""): (
                float(limit.get("lower", "nan")),
                float(limit.get("upper", "nan")),
            )
            for joint in root.findall("joint")
            if joint.get("type") in ("revolute", "prismatic")
            and (limit := joint.find("limit")) is not None
        }
    ranges = {
        default.get("class"): joint.get("range")
        for default in root.iter("default")
        for joint in default.findall("joint")
    }
    found = {}
    for joint in root.find("worldbody").iter("joint"):  # type: ignore[union-attr]
        if joint.get("type") != "free":
            text = joint.get("range") or ranges.get(joint.get("class")) or "nan nan"
            low, high = map(float, text.split())
            found[joint.get("name", "")] = (low, high)
    return found


def _motor_order(path: Path) -> list[str]:
    actuators = ET.parse(path).getroot().find("actuator")
    return [a.get("joint", "") for a in actuators] if actuators is not None else []


@pytest.fixture(params=sorted(MODELS))
def model(request: pytest.FixtureRequest) -> tuple[str, Path]:
    root = assets_root()
    if root is None:
        pytest.skip("the assets folder is not at hand: set UNICON_ASSETS")
    path = root / MODELS[request.param]
    if not path.is_file():
        pytest.skip(f"{MODELS[request.param]} is not in the assets folder")
    return request.param, path


def test_names_are_the_models(model: tuple[str, Path]) -> None:
    """Simulators give motor slots that the robot does not use a joint of their own."""
    name, path = model
    robot, joints = load_robot(name), _joints(path)
    slots = robot.transport.get("motors", range(robot.num_joints))
    if list(slots) == list(range(robot.num_joints)):
        assert set(robot.joint_names) == set(joints)
    else:
        assert set(robot.joint_names) < set(joints)


def test_limits_are_the_models(model: tuple[str, Path]) -> None:
    name, path = model
    robot = load_robot(name)
    limits = _joints(path)
    expected = np.array([limits[joint] for joint in robot.joint_names])
    # The models round to 4 to 6 digits.
    if name in NARROWER:
        assert (robot.lower >= expected[:, 0] - 1e-3).all()
        assert (robot.upper <= expected[:, 1] + 1e-3).all()
        return
    np.testing.assert_allclose(robot.lower, expected[:, 0], atol=1e-3)
    np.testing.assert_allclose(robot.upper, expected[:, 1], atol=1e-3)


def test_order_is_that_of_the_models_motors(model: tuple[str, Path]) -> None:
    name, path = model
    motors = _motor_order(path)
    if not motors:
        pytest.skip(f"{path.name} has no actuators")
    robot = load_robot(name)
    slots = robot.transport.get("motors", range(robot.num_joints))
    assert robot.joint_names == tuple(motors[slot] for slot in slots)
