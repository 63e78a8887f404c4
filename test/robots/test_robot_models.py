"""Names, order and limits agree with the vendors' models, where these are at hand.

The models are other people's and are not part of the project: they are found through
`UNICON_ASSETS`.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest

from unicon_base.resources import assets_root
from unicon_core.models.find import pick_model
from unicon_core.models.load import load_model
from unicon_core.platforms.kit.scene import Scene
from unicon_core.robots import load_robot

# Models below the assets folder's `models/`, in folders named after their robots: the MJCF and URDF
# files named in the robot files' `sources`.
MODELS = (
    "a1/a1.urdf",
    "adam_lite/adam_lite.xml",
    "azureloong/AzureLoong.urdf",
    "azureloong/AzureLoong.xml",
    "dex3_left/dex3_1_l.urdf",
    "dex3_right/dex3_1_r.urdf",
    "g1_23dof/g1_23dof.xml",
    "g1_23dof/g1_23dof_rev_1_0.urdf",
    "g1_29dof/g1_29dof.xml",
    "g1_29dof/g1_29dof_rev_1_0.urdf",
    "go1/go1.urdf",
    "go1/go1.xml",
    "go2/go2.xml",
    "go2/go2_description.urdf",
    "gr1t2/gr1t2.urdf",
    "h1/h1.urdf",
    "h1/h1.xml",
    "h1_2/h1_2_handless.urdf",
    "h1_2/h1_2_handless.xml",
    "inspire_rh56_left/inspire_hand_left.urdf",
    "inspire_rh56_right/inspire_hand_right.urdf",
    "n1/FOURIERN1.urdf",
    "t1/T1_23dof.urdf",
    "t1/T1_23dof.xml",
    "x2/x2_ultra.urdf",
    "xhand1_left/xhand_left.urdf",
    "xhand1_right/xhand_right.urdf",
)

FILES = Path(__file__).resolve().parents[2] / "config" / "robots"
URDFS = tuple(model for model in MODELS if model.endswith(".urdf"))
MJCFS = tuple(model for model in MODELS if model.endswith(".xml"))

# The vendor's sources differ (MJCF and URDF, or URDF and SDK): the file has the narrower limit.
NARROWER = {"adam_lite", "aliengo", "atom", "azureloong", "go1", "gr1t2", "t1", "x2"}

# Joints that only the model has: wrists of another version, the links that a finger drags along.
MORE_JOINTS = {"adam_lite", "inspire_rh56_left", "inspire_rh56_right"}


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


def test_no_model_at_hand_is_left_out() -> None:
    root = assets_root()
    if root is None:
        pytest.skip("the assets folder is not at hand: set UNICON_ASSETS")
    folder = root / "models"
    found = {str(path.relative_to(folder)) for path in folder.glob("*/*.*")}
    assert {path for path in found if path.endswith((".urdf", ".xml"))} <= set(MODELS)


ROBOTS = sorted(path.stem for path in FILES.glob("*.yaml"))


@pytest.mark.parametrize("name", ROBOTS)
def test_a_robot_whose_model_is_at_hand_names_it_and_it_can_be_simulated(name: str) -> None:
    root = assets_root()
    if root is None:
        pytest.skip("the assets folder is not at hand: set UNICON_ASSETS")
    robot, there = load_robot(name), root / "models" / name
    if not robot.models:
        assert not there.exists(), f"name it: models: {{mjcf or urdf: assets:models/{name}/…}}"
        pytest.skip(f"no model of {name} is at hand")
    pytest.importorskip("mujoco", reason="mujoco is not installed: pip install 'unicon_ros[sim]'")
    named = next(iter(robot.models.values()))
    if named.startswith("assets:") and not (root / named.removeprefix("assets:")).exists():
        pytest.skip(f"{named} is not in the assets folder")
    loaded = load_model(pick_model(robot), robot)
    assert (loaded.base is not None) == robot.walks
    assert np.isfinite(Scene(initial_pose="rest").joint_pos(robot)).all()


@pytest.fixture(params=MODELS)
def model(request: pytest.FixtureRequest) -> tuple[str, Path]:
    root = assets_root()
    if root is None:
        pytest.skip("the assets folder is not at hand: set UNICON_ASSETS")
    path = root / "models" / request.param
    if not path.is_file():
        pytest.skip(f"models/{request.param} is not in the assets folder")
    return path.parent.name, path


def test_names_are_the_models(model: tuple[str, Path]) -> None:
    """Simulators may give motor slots that the robot does not use a joint of their own."""
    name, path = model
    robot, joints = load_robot(name), _joints(path)
    assert set(robot.joint_names) - set(joints) == set()
    slots = robot.transport.get("motors", range(robot.num_joints))
    if list(slots) == list(range(robot.num_joints)) and name not in MORE_JOINTS:
        assert len(joints) == robot.num_joints


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


@pytest.mark.parametrize("model", URDFS, indirect=True)
def test_speed_and_torque_limits_are_the_urdfs(model: tuple[str, Path]) -> None:
    """NaN where the robot file does not believe the URDF (place holders of the RH56)."""
    name, path = model
    robot = load_robot(name)
    found = {joint.get("name"): joint.find("limit") for joint in ET.parse(path).findall("joint")}
    for key, ours in (("velocity", robot.velocity_limit), ("effort", robot.effort_limit)):
        limits = [found[joint] for joint in robot.joint_names]
        theirs = np.array([np.nan if lim is None else float(lim.get(key, "nan")) for lim in limits])
        known = ~np.isnan(ours)
        assert known.all() or f"joints.{key}" in robot.unknown
        if name in NARROWER:
            assert (ours[known] <= theirs[known] * 1.001).all()
            continue
        np.testing.assert_allclose(ours[known], theirs[known], rtol=1e-3)


@pytest.mark.parametrize("model", MJCFS, indirect=True)
def test_order_is_that_of_the_models_motors(model: tuple[str, Path]) -> None:
    name, path = model
    motors = _motor_order(path)
    assert motors
    robot = load_robot(name)
    assert robot.joint_names == tuple(motor for motor in motors if motor in robot.joint_names)
    slots = robot.transport.get("motors", range(robot.num_joints))
    if len(motors) > max(slots) and name not in MORE_JOINTS:  # the model has the unused slots too
        assert robot.joint_names == tuple(motors[slot] for slot in slots)


def test_the_platform_loads_it_and_a_quadruped_stands(model: tuple[str, Path]) -> None:
    pytest.importorskip("mujoco", reason="the model is simulated")
    from unicon_core.platforms.kit.scene import Scene
    from unicon_core.platforms.mujoco import make
    from unicon_core.states import States, standard_states

    name, path = model
    robot = load_robot(name)
    states = States(standard_states(robot.joint_names))
    platform = make(states, robot, 0.02, scene=Scene(model=path))
    if robot.kind != "quadruped" or robot.missing_facts():
        return
    states.joint_pos_target = robot.default_joint_pos
    states.joint_stiffness, states.joint_damping = robot.joint_stiffness, robot.joint_damping
    for _ in range(150):
        platform.send()
    platform.recv()
    assert states.projected_gravity[2] < -0.99
    assert states.base_pos_w[2] > 0.2
    assert np.abs(states.joint_pos - robot.default_joint_pos).max() < 0.2
