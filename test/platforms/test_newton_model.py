"""Newton has the model that MuJoCo has: masses, forces, joints and contacts."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest

from unicon_base.errors import UniconError
from unicon_core.conformance import Rig
from unicon_core.platforms.kit.joint_model import joint_model
from unicon_core.platforms.kit.scene import Scene
from unicon_core.platforms.kit.start import start_of
from unicon_core.robots import load_robot
from unicon_sims.newton.platform import make

mujoco = pytest.importorskip("mujoco", reason="pip install 'unicon_ros[sim]'")


@pytest.fixture
def newton():
    """Return the module; where it is not installed, the test is skipped."""
    return pytest.importorskip("newton", reason="pip install 'unicon_ros[sim-newton]'")


@lru_cache
def built(name, pose="default"):
    """Return a robot, where it begins, the MuJoCo model that Newton made of it, and its joints."""
    robot = load_robot(name)
    start = start_of(robot, Scene(initial_pose=pose))
    return robot, start, *made_of(robot, start)


def made_of(robot, start):
    """Return the MuJoCo model that Newton makes of a robot's, and first velocity of each joint."""
    import newton
    import warp

    from unicon_sims.newton.world import build_world, solver_options

    world, numbers = build_world(newton, warp, start, robot, joint_model(start, "keep"))
    with warp.ScopedDevice("cpu"):
        model = world.finalize()
        solver = newton.solvers.SolverMuJoCo(model, use_mujoco_cpu=True, **solver_options(start))
    firsts = model.joint_qd_start.numpy()
    return solver.mj_model, {joint: int(firsts[number]) for joint, number in numbers.items()}


def both(name, pose="default"):
    """Return MuJoCo's data of the model and of Newton's at the start, and degrees of freedom."""
    robot, start, made, dofs = built(name, pose)
    loaded = start.loaded
    given = start.loaded.model
    own = [*range(6), *(int(given.jnt_dofadr[joint]) for joint in loaded.joints)]
    other = [*range(6), *(dofs[joint] for joint in robot.joint_names)]
    found = []
    for model, order in ((given, own), (made, other)):
        data = mujoco.MjData(model)
        data.qpos[:3], data.qpos[3:7] = start.position, start.quat
        for angle, dof in zip(start.joint_pos, order[6:]):
            data.qpos[dof + 1] = angle  # a free joint has one coordinate more
        data.qvel[order] = np.random.default_rng(3).normal(size=len(order))
        mujoco.mj_forward(model, data)
        found.append(data)
    return found, [own, other]


ROBOTS = ["go2", "go1", "t1", "g1_29dof", "h1"]


def available(name):
    """Return the name; a robot whose model is not here skips the test."""
    try:
        start_of(load_robot(name), Scene())
    except UniconError as error:
        pytest.skip(str(error))
    return name


@pytest.mark.slow
@pytest.mark.parametrize("name", ROBOTS)
def test_masses_inertias_and_places_are_the_models(newton, name):
    (given, made), orders = both(available(name))
    # Accelerations under gravity, with all the centrifugal forces of a random motion: masses,
    # centres, inertias, axes, anchors and armatures all count.
    matrices = []
    biases = []
    for data, model, order in zip((given, made), (given.model, made.model), orders):
        full = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, full) if _new() else mujoco.mj_fullM(model, full, data.qM)
        matrices.append(full[np.ix_(order, order)])
        biases.append(data.qfrc_bias[order])
    size = np.abs(matrices[0]).max()
    assert np.abs(matrices[1] - matrices[0]).max() < 2e-6 * size
    assert np.abs(biases[1] - biases[0]).max() < 2e-5 * np.abs(biases[0]).max()
    base = int(given.model.jnt_bodyid[given.model.dof_jntid[0]])
    masses = made.model.body_subtreemass[1], given.model.body_subtreemass[base]
    assert masses[0] == pytest.approx(masses[1], rel=1e-6)
    assert made.subtree_com[1] == pytest.approx(given.subtree_com[base], abs=1e-5)
    names = {given.model.body(i).name: i for i in range(given.model.nbody)}
    seen = 0
    for i in range(made.model.nbody):
        link = made.model.body(i).name.rsplit("/")[-1]
        j = names.get(link)
        if j is not None and given.model.body_mass[j] > 0.0:
            assert made.xipos[i] == pytest.approx(given.xipos[j], abs=1e-5)
            seen += 1
    assert seen >= len(orders[0]) - 7


def _new():
    """Return whether `mj_fullM` takes the data, not its matrix."""
    return "qM" not in dir(mujoco.MjData)


@pytest.mark.slow
@pytest.mark.parametrize("name", ROBOTS)
def test_joints_are_passive_as_the_model_says(newton, name):
    (given, made), (own, other) = both(available(name))
    for of in ("dof_damping", "dof_frictionloss", "dof_armature", "dof_solref", "dof_solimp"):
        figures = getattr(given.model, of)[own], getattr(made.model, of)[other]
        assert figures[1] == pytest.approx(figures[0], rel=1e-5), of
    joints = [
        model.dof_jntid[order[6:]] for model, order in ((given.model, own), (made.model, other))
    ]
    for of in ("jnt_range", "jnt_limited", "jnt_solref", "jnt_stiffness"):
        figures = getattr(given.model, of)[joints[0]], getattr(made.model, of)[joints[1]]
        assert figures[1] == pytest.approx(figures[0], rel=1e-5, abs=1e-6), of
    assert not made.model.nu  # no drive of the engine's own
    assert not made.model.neq or not made.eq_active.any()


@pytest.mark.slow
@pytest.mark.parametrize("name", ROBOTS)
@pytest.mark.parametrize("pose", ["default", "rest"])
def test_what_touches_touches_in_newton_too(newton, name, pose):
    robot, start, made, dofs = built(available(name), pose)
    given = start.loaded.model
    own = [int(given.jnt_qposadr[joint]) for joint in start.loaded.joints]
    other = [dofs[joint] + 1 for joint in robot.joint_names]
    rng = np.random.default_rng(5)
    most = 0
    for k in range(20):
        # Low, tilted, and with legs anywhere: floor and own links are met.
        quat = np.array((1.0, *rng.normal(scale=0.4 * (k > 0), size=3)))
        limits = given.jnt_range[start.loaded.joints].T
        angles = np.clip(start.joint_pos + rng.normal(scale=0.1 * k, size=len(own)), *limits)
        touched = []
        for model, order in ((given, own), (made, other)):
            data = mujoco.MjData(model)
            data.qpos[:3] = 0.0, 0.0, start.position[2] - 0.03 - 0.01 * k
            data.qpos[3:7] = quat / np.linalg.norm(quat)
            data.qpos[order] = angles
            mujoco.mj_forward(model, data)
            rows = [
                (c.dist, *c.pos, c.dim, *c.friction, *c.solref, *c.solimp) for c in data.contact
            ]
            touched.append(np.array(sorted(rows)).reshape(-1, 17))
        assert touched[0].shape == touched[1].shape
        most = max(most, len(touched[0]))
        assert np.abs(touched[1][:, 0] - touched[0][:, 0]).max(initial=0.0) < 1e-5
        for of in range(4, 17):  # of equally deep ones any may be first, with the same settings
            assert np.sort(touched[1][:, of]) == pytest.approx(np.sort(touched[0][:, of]), rel=1e-4)
    assert most >= 4


_ODD = """
<mujoco>
  <compiler angle="radian" autolimits="true"/>
  <option timestep="0.001" cone="elliptic" impratio="10" {option}/>
  <asset><mesh name="rock" vertex="0 0 0 .2 0 0 0 .2 0 0 0 .2 .1 .1 .15"/></asset>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 1" quat=".998 .05 0 0" friction=".7 .01 .001"/>
    <geom type="box" size=".3 .3 .05" pos=".3 0 .02" quat=".98 0 0 .2" priority="2"
      friction=".3" solref=".01 .9" solimp=".8 .9 .002"/>
    <geom type="sphere" size=".1" pos="-.3 0 0" condim="1"/>
    <geom type="ellipsoid" size=".1 .2 .05" pos="0 .3 0"/>
    <body name="box" pos="0 0 .1">
      <freejoint/>
      <inertial pos=".02 -.01 .01" mass="6" diaginertia=".08 .1 .14"/>
      <geom type="mesh" mesh="rock" pos=".1 0 -.1" condim="6" friction=".9 .02 .03"/>
      <geom type="ellipsoid" size=".2 .1 .08" pos="-.2 0 0" condim="4" margin="{margin}"/>
      <body name="mast" pos="0 0 .06">
        <joint name="yaw" axis="0 0 1" range="-3 3" ref=".3" stiffness="2" springref=".1"/>
        <inertial pos=".1 0 0" mass=".5" diaginertia=".001 .003 .003"/>
        <geom type="capsule" size=".02" fromto=".03 0 0 .18 0 0"/>
      </body>
      <body name="arm" pos="-.2 -.1 .05">
        <joint name="right" axis="1 0 0" range="-3 3" damping=".2" solreffriction=".03 1"/>
        <inertial pos="0 0 .1" mass=".6" diaginertia=".004 .004 .001"/>
        <geom type="cylinder" size=".03 .1" pos="0 0 .1"/>
      </body>
      <body name="thigh" pos=".2 .1 .05">
        <joint name="left" axis="0 1 0" pos=".01 .02 .03" range="-3 3" armature=".02"/>
        <joint name="beside" axis="1 1 0" damping=".1" ref=".2"/>
        <inertial pos="0 0 .1" mass=".8" diaginertia=".005 .005 .001"/>
        <geom type="capsule" size=".02" fromto="0 0 .03 0 0 .17"/>
        <body name="shank" pos="0 0 .2">
          <joint name="knee" axis="0 1 0" range="-3 3"/>
          <inertial pos="0 0 .1" mass=".4" diaginertia=".003 .003 .001"/>
          <geom type="box" size=".02 .02 .08" pos="0 0 .1"/>
          <geom name="foot" size=".04" pos="0 0 .2" contype="0" conaffinity="0"/>
        </body>
      </body>
    </body>
  </worldbody>
  <contact>
    <pair geom1="foot" geom2="floor" friction=".4 .4 .01 .001 .001" condim="4" solref=".015 1"/>
    <exclude body1="mast" body2="arm"/>
  </contact>
  {more}
</mujoco>
"""


@pytest.mark.slow
def test_all_kinds_of_geoms_joints_and_contacts_are_the_models(newton, tmp_path):
    rig = Rig("mujoco", tmp_path)
    (tmp_path / "odd.xml").write_text(_ODD.format(margin=0, option="", more=""), encoding="utf-8")
    start = start_of(rig.robot, Scene(model=str(tmp_path / "odd.xml"), initial_pose="model"))
    made, dofs = made_of(rig.robot, start)
    given = start.loaded.model
    names = [*rig.robot.joint_names, "beside"]
    orders = [*range(6), *(int(given.joint(name).dofadr[0]) for name in names)]
    others = [*range(6), *(dofs[name] for name in names)]
    rng = np.random.default_rng(0)
    met = 0
    for _ in range(100):
        quat = rng.normal(size=4) * (0.4, 1.0, 1.0, 1.0)
        place = [*rng.normal(scale=0.1, size=3), *quat / np.linalg.norm(quat)]
        angles = rng.uniform(-2.5, 2.5, 5)
        speeds = rng.normal(size=11)
        told = []
        for model, order in ((given, orders), (made, others)):
            data = mujoco.MjData(model)
            data.qpos[:7], data.qpos[np.array(order[6:]) + 1] = place, angles
            data.qvel[order] = speeds
            mujoco.mj_forward(model, data)
            forces = np.hstack((data.qfrc_passive[order], data.qfrc_bias[order]))
            told.append((_deepest(data, made), forces))
        assert told[1][0].keys() == told[0][0].keys()
        for pair, contact in told[0][0].items():
            assert told[1][0][pair] == pytest.approx(contact, rel=1e-4, abs=1e-5)
        assert told[1][1] == pytest.approx(told[0][1], rel=1e-3, abs=2e-3)
        met += len(told[0][0])
    assert met > 500


def _deepest(data, made):
    """Return the deepest contact of each pair of the given model's geoms that touch."""
    found: dict[tuple[int, ...], tuple[float, ...]] = {}
    for c in sorted(data.contact, key=lambda contact: -contact.dist):
        numbers = [int(geom) for geom in c.geom]
        if data.model is made:  # Newton names them geom_NUMBER_SHAPE, by the names that we gave
            numbers = [int(made.geom(geom).name.split("_")[1]) for geom in numbers]
        if c.dist < -1e-3:  # less is a matter of rounding
            found[tuple(sorted(numbers))] = (c.dist, c.dim, *c.friction, *c.solref, *c.solimp)
    return found


@pytest.mark.slow
def test_what_newton_leaves_out_is_a_note(newton, tmp_path):
    more = """<tendon><fixed><joint joint="knee" coef="1"/></fixed></tendon>
      <equality><joint joint1="yaw" joint2="right"/></equality>"""
    text = _ODD.format(margin=0.01, option='noslip_iterations="3"', more=more)
    (tmp_path / "odd.xml").write_text(text, encoding="utf-8")
    rig = Rig("mujoco", tmp_path)
    scene = Scene(model=str(tmp_path / "odd.xml"), initial_pose="model")
    platform = make(rig.states, rig.robot, rig.period, scene=scene)
    notes = platform.info()["notes"]
    for told in ("1 tendons", "1 equality", "3 iterations against slip", "margin=0.0"):
        assert any(told in note for note in notes), told
    assert set(notes) <= set(platform.facts.notes)
    platform.close()
