"""Feet of every robot whose model is at hand, against MuJoCo's own velocities and Jacobians."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from unicon_base.errors import ModelError
from unicon_core.models.feet import Feet
from unicon_core.models.find import pick_model
from unicon_core.models.load import load_model
from unicon_core.models.loaded import rows_of
from unicon_core.models.posed import PosedModel, foot_geoms
from unicon_core.robots import load_robot

LEGGED = ["go1", "a1", "go2", "g1_29dof", "g1_23dof", "h1", "h1_2", "t1", "adam_lite"]


def model_of(name):
    robot = load_robot(name)
    return robot, load_model(pick_model(robot), robot, quiet=True)


def at_random(robot, rng):
    quat = rng.normal(size=4)
    pos = np.nan_to_num(robot.default_joint_pos) + rng.uniform(-0.1, 0.1, robot.num_joints)
    return quat / np.linalg.norm(quat), rng.normal(size=3), pos, rng.normal(size=robot.num_joints)


@pytest.mark.parametrize("name", LEGGED)
def test_every_legged_robot_has_its_feet(name, assets):
    robot, loaded = model_of(name)
    feet = Feet(loaded, robot)
    assert feet.names == robot.feet
    pose = np.nan_to_num(robot.default_joint_pos)
    none = np.zeros_like(pose)
    assert feet(np.array((1.0, 0, 0, 0)), np.zeros(3), pose, none, none)
    assert (feet.position[:, 2] < -0.2).all()
    assert np.ptp(feet.position[:, 2]) < 0.03
    assert np.allclose(feet.velocity, 0.0)


@pytest.mark.parametrize("name", LEGGED)
def test_the_point_that_stands_still_tells_the_base_velocity(name, assets):
    """The velocity of the foot's point in the whole model, which has a base velocity besides."""
    robot, loaded = model_of(name)
    feet = Feet(loaded, robot)
    rng = np.random.default_rng(1)
    model = loaded.model
    data = mujoco.MjData(loaded.model)
    start = model.jnt_qposadr[loaded.base]
    first = model.jnt_dofadr[loaded.base]
    for _ in range(5):
        quat, rates, pos, vel = at_random(robot, rng)
        assert feet(quat, rates, pos, vel, None)
        base = rng.normal(size=3)
        data.qpos[start : start + 7] = (*rng.normal(size=3), *quat)
        data.qpos[loaded.addresses] = pos
        data.qvel[first : first + 6] = (*base, *rates)
        data.qvel[model.jnt_dofadr[loaded.joints]] = vel
        mujoco.mj_forward(model, data)
        jacobian = np.zeros((3, model.nv))
        for at, velocity, body in zip(feet.position, feet.velocity, _bodies(loaded, robot)):
            point = at + data.qpos[start : start + 3]
            mujoco.mj_jac(model, data, jacobian, None, point, body)
            np.testing.assert_allclose(velocity + base, jacobian @ data.qvel, atol=1e-9)


@pytest.mark.parametrize("name", ["go2", "go1", "a1", "g1_29dof"])
def test_torques_that_balance_a_force_tell_it(name, assets):
    """τ = h - Jᵀ f, of legs that are bent: through a straight one a force asks for no torque."""
    robot, loaded = model_of(name)
    feet = Feet(loaded, robot)
    rng = np.random.default_rng(2)
    model = loaded.model
    data = mujoco.MjData(loaded.model)
    start = model.jnt_qposadr[loaded.base]
    first = model.jnt_dofadr[loaded.base]
    dofs = model.jnt_dofadr[loaded.joints]
    for _ in range(5):
        _, _, pos, vel = at_random(robot, rng)
        quat = np.array((1.0, 0.0, 0.0, 0.0))
        rates = rng.normal(size=3)
        feet(quat, rates, pos, vel, None)
        data.qpos[start : start + 7] = (0.0, 0.0, 0.0, *quat)
        data.qpos[loaded.addresses] = pos
        data.qvel[first : first + 6] = (0.0, 0.0, 0.0, *rates)
        data.qvel[dofs] = vel
        mujoco.mj_forward(model, data)
        share = feet.weight / len(feet.names)
        forces = rng.uniform(0.0, 2.0, len(feet.names)) * share
        torque = data.qfrc_bias.copy()
        jacobian = np.zeros((3, model.nv))
        for at, force, body in zip(feet.position, forces, _bodies(loaded, robot)):
            mujoco.mj_jac(model, data, jacobian, None, at, body)
            torque -= jacobian.T @ (0.1 * force, -0.1 * force, force)
        assert feet(quat, rates, pos, vel, torque[dofs])
        np.testing.assert_allclose(feet.force, forces, atol=0.15 * share)


@pytest.mark.parametrize("name", ["go2", "t1", "g1_29dof", "adam_lite"])
def test_the_lowest_point_is_that_of_the_models_geometry(name, assets):
    robot, loaded = model_of(name)
    feet = Feet(loaded, robot)
    posed = PosedModel(loaded)
    pose = np.nan_to_num(robot.default_joint_pos)
    none = np.zeros(robot.num_joints)
    half = np.sqrt(0.5) * np.array((np.cos(0.1), np.sin(0.1), 0.0, 0.0)) * np.sqrt(2.0)
    feet(half, np.zeros(3), pose, none, None)
    posed.put(pose, (0.0, 0.0, 2.0, *half))
    heights = posed.heights()
    geoms = foot_geoms(loaded.model, robot.feet)
    for foot, at in zip(feet.names, feet.position):
        lowest = min(heights[g] for g in geoms[foot] if g in heights)
        assert at[2] + 2.0 == pytest.approx(lowest, abs=2e-3)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 3e38, 1e20])
@pytest.mark.parametrize("which", range(5))
def test_nonsense_is_told(which, value, assets):
    robot, loaded = model_of("go2")
    feet = Feet(loaded, robot)
    n = robot.num_joints
    arguments = [
        np.array(part, np.float32)
        for part in ((1, 0, 0, 0), np.zeros(3), robot.default_joint_pos, np.zeros(n), np.zeros(n))
    ]
    assert feet(*arguments)
    good = feet.velocity.copy()
    arguments[which][1] = value
    assert not feet(*arguments)
    assert (feet.velocity == good).all()


def test_a_model_without_the_feet_is_refused(assets):
    robot, loaded = model_of("go2")
    object.__setattr__(robot, "feet", ("paw",))
    with pytest.raises(ModelError, match=r"it has no feet \(feet of robot go2: paw\)"):
        Feet(loaded, robot)


def test_rows_with_regular_numbers_are_a_view():
    source = np.arange(60.0).reshape(20, 3)
    rng = np.random.default_rng(3)
    for index in ([2, 5, 8], [[4, 5], [9, 10]], [7], [[3], [1]], [[6, 5], [9, 8]]):
        rows, refresh = rows_of(source, np.array(index))
        assert refresh is None
        source[...] = rng.normal(size=source.shape)
        assert (rows == source[index]).all()
    for index in ([2, 5, 9], [[4, 5], [9, 11]]):
        rows, refresh = rows_of(source, np.array(index))
        source[...] = rng.normal(size=source.shape)
        assert refresh is not None
        refresh()
        assert (rows == source[index]).all()


def _bodies(loaded, robot):
    from unicon_core.models.posed import foot_bodies

    return list(foot_bodies(loaded.model, robot.feet).values())
