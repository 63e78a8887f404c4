"""Facts of our Go2 model of primitives, and that the robot file agrees with it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

mujoco = pytest.importorskip("mujoco")
CONFIG = Path(__file__).resolve().parents[1] / "config"
MODEL = CONFIG / "models" / "go2" / "go2.xml"


@pytest.fixture(scope="module")
def model() -> Any:
    return mujoco.MjModel.from_xml_path(str(MODEL))


@pytest.fixture(scope="module")
def robot() -> dict[str, Any]:
    return dict(yaml.safe_load((CONFIG / "robots" / "go2.yaml").read_text(encoding="utf-8")))


def column(robot: dict[str, Any], key: str) -> np.ndarray:
    return np.array([joint[key] for joint in robot["joints"]])


def simulate(model: Any, data: Any, target: np.ndarray, kp: Any, kd: Any, seconds: float) -> None:
    """PD with the actuators' torque clip, evaluated in every physics step."""
    limit = model.actuator_ctrlrange[:, 1]
    for _ in range(round(seconds / model.opt.timestep)):
        torque = kp * (target - data.qpos[7:]) - kd * data.qvel[6:]
        data.ctrl[:] = np.clip(torque, -limit, limit)
        mujoco.mj_step(model, data)


def at_key(model: Any, name: str) -> Any:
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key(name).id)
    return data


def test_motors_and_joints_stand_in_the_robot_files_order(
    model: Any, robot: dict[str, Any]
) -> None:
    names = [joint["name"] for joint in robot["joints"]]
    assert names[:4] == ["FR_hip_joint", "FR_thigh_joint", "FR_calf_joint", "FL_hip_joint"]
    assert [model.joint(i).name for i in range(1, model.njnt)] == names
    driven = [model.joint(int(j)).name for j in model.actuator_trnid[:, 0]]
    assert driven == names


def test_limits_agree_with_the_robot_file(model: Any, robot: dict[str, Any]) -> None:
    np.testing.assert_allclose(model.jnt_range[1:, 0], column(robot, "lower"))
    np.testing.assert_allclose(model.jnt_range[1:, 1], column(robot, "upper"))
    np.testing.assert_allclose(model.actuator_ctrlrange[:, 1], column(robot, "effort"))
    np.testing.assert_allclose(model.actuator_ctrlrange[:, 0], -column(robot, "effort"))


def test_poses_lie_within_the_limits(robot: dict[str, Any]) -> None:
    for key in ("default", "rest"):
        pose = column(robot, key)
        assert (pose >= column(robot, "lower")).all()
        assert (pose <= column(robot, "upper")).all()


def test_home_is_the_robot_files_standing_pose(model: Any, robot: dict[str, Any]) -> None:
    np.testing.assert_allclose(model.key("home").qpos[7:], column(robot, "default"))


def test_mass_is_that_of_a_go2(model: Any) -> None:
    assert model.body("base_link").subtreemass[0] == pytest.approx(15.0, abs=0.5)


def test_left_and_right_mirror_each_other(model: Any) -> None:
    for right, left in (("FR", "FL"), ("RR", "RL")):
        for part in ("hip", "thigh", "calf", "foot"):
            a, b = model.body(f"{right}_{part}"), model.body(f"{left}_{part}")
            assert a.mass == b.mass
            np.testing.assert_allclose(a.inertia, b.inertia)
            np.testing.assert_allclose(a.pos, b.pos * [1, -1, 1])
            np.testing.assert_allclose(a.ipos, b.ipos * [1, -1, 1])


def test_sensors_imu_and_feet_have_the_expected_names(model: Any, robot: dict[str, Any]) -> None:
    for name in ("imu_quat", "imu_gyro", "imu_acc", "frame_pos", "frame_vel"):
        assert model.sensor(name).id >= 0
    np.testing.assert_allclose(model.site("imu").pos, robot["imu"]["position"])
    assert model.body(robot["base_frame"]).id == 1
    for foot in robot["feet"]:
        assert model.body(foot).id > 0
    assert model.opt.timestep == 0.002


def test_it_has_no_meshes(model: Any) -> None:
    assert model.nmesh == 0


def test_it_stands_under_the_robot_files_gains(model: Any, robot: dict[str, Any]) -> None:
    data = at_key(model, "home")
    kp, kd = column(robot, "stiffness"), column(robot, "damping")
    simulate(model, data, column(robot, "default"), kp, kd, 2.0)
    assert data.qpos[2] > 0.27
    assert np.abs(data.qvel).max() < 0.05
    touching = {model.geom(int(contact.geom2)).name for contact in data.contact}
    assert touching == {"FR", "FL", "RR", "RL"}


def test_it_lies_stably_when_damped(model: Any, robot: dict[str, Any]) -> None:
    data = at_key(model, "lie")
    before = data.qpos.copy()
    simulate(model, data, before[7:], 0.0, column(robot, "damping"), 2.0)
    np.testing.assert_allclose(data.qpos, before, atol=0.01)
    assert data.qpos[2] < 0.1


def test_the_rest_pose_sinks_into_lying_when_damped(model: Any, robot: dict[str, Any]) -> None:
    data = at_key(model, "home")
    data.qpos[2], data.qpos[7:] = 0.13, column(robot, "rest")
    simulate(model, data, column(robot, "rest"), 0.0, column(robot, "damping"), 8.0)
    np.testing.assert_allclose(data.qpos[7:], model.key("lie").qpos[7:], atol=0.02)


def test_every_group_of_facts_has_a_source(robot: dict[str, Any]) -> None:
    assert {"joints", "default", "rest", "gains", "imu", "feet", "transport"} <= set(
        robot["sources"]
    )
    assert robot["unknown"] == []
