"""Genesis gets MuJoCo's own model: what it is told, what it reads, and that robots walk alike."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
from typing import Any

import numpy as np
import pytest

from unicon_base.errors import Fault, MissingDependencyError
from unicon_core.platforms.kit.joint_model import joint_model
from unicon_core.platforms.kit.scene import Scene
from unicon_core.platforms.kit.start import start_of
from unicon_core.robots import load_robot
from unicon_core.runtime import Runner, RunOptions
from unicon_core.workflow import load_workflow
from unicon_sims.genesis.platform import adapted, begun, otherwise

# What these tests run against, the most that config/evidence.yaml may say by them.
EVIDENCE = "vendor"

mujoco = pytest.importorskip("mujoco", reason="pip install 'unicon_ros[sim]'")
INSTALL = "pip install 'unicon_ros[sim-genesis]'"


def needs_genesis(test):
    """Skip where it is not installed; compiling takes a minute where its cache is empty."""
    absent = importlib.util.find_spec("genesis") is None
    for mark in (
        pytest.mark.skipif(absent, reason=f"genesis is not installed: {INSTALL}"),
        pytest.mark.slow,
        pytest.mark.timeout(400),
    ):
        test = mark(test)
    return test


LIMB = """
<mujoco>
  <compiler angle="radian"/>
  <option timestep="0.002" integrator="{integrator}" solver="{solver}"/>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 1" friction="1.5 0.02 0.01" condim="3"/>
    <body name="base" pos="0 0 1">
      <freejoint/>
      <geom name="trunk" type="box" size=".2 .1 .05" mass="5" friction="0.3 0.005 0.001"/>
      <body name="leg" pos="0.1 0 0">
        <joint name="hip" axis="0 1 0" ref="0.4" range="-2 2" damping="0.3" armature="0.02"
          frictionloss="0.1"/>
        <geom name="foot" type="sphere" size="0.03" pos="0 0 -0.3" mass="0.5" priority="1"
          friction="0.6 0.03 0.02" condim="6"/>
        <geom name="pad" type="sphere" size="0.03" pos="0 0.1 -0.3" mass="0.5"/>
        {more}
      </body>
    </body>
  </worldbody>
  <contact><pair geom1="floor" geom2="pad" condim="3" friction="0.2 0.2"/>{pair}</contact>
  <actuator><motor joint="hip" ctrlrange="-20 20" ctrllimited="true"/></actuator>
</mujoco>
"""

LEGGED = """\
schema: unicon.robot/1
name: limb
description: box with a leg
manufacturer: unicon_ros
kind: quadruped
models: {}
base_frame: base
joints:
  - {name: hip, lower: -2.0, upper: 2.0, velocity: 60.0, effort: 20.0, default: 0.5, rest: 0.0,
     stiffness: 10.0, damping: 0.5}
imu: {frame: imu, position: [0, 0, 0], quat: [1, 0, 0, 0]}
feet: [leg]
transport: {protocol: none}
sources: {joints: ours, gains: ours, default: ours, rest: ours, imu: ours, feet: ours,
  transport: ours}
unknown: []
"""


def limb(folder, **says):
    """Return a robot of one leg, its model, and the scene that has it."""
    words = {"integrator": "implicitfast", "solver": "Newton", "more": "", "pair": ""} | says
    (folder / "limb.xml").write_text(LIMB.format(**words), encoding="utf-8")
    (folder / "limb.yaml").write_text(LEGGED, encoding="utf-8")
    robot = load_robot(str(folder / "limb.yaml"))
    scene = Scene(initial_pose="default", model=str(folder / "limb.xml"))
    return robot, start_of(robot, scene), scene


# What it is told, which needs no Genesis


def test_friction_is_said_as_mujoco_mixes_it(tmp_path):
    _, start, _ = limb(tmp_path)
    model = adapted(start, joint_model(start, "keep"))
    # Genesis takes the larger of two: the floor says nothing, each geom what counts with the floor.
    friction = {model.geom(i).name: model.geom_friction[i].tolist() for i in range(model.ngeom)}
    assert friction["floor"] == [0.0, 0.0, 0.0]
    assert friction["trunk"] == pytest.approx([1.5, 0.02, 0.01])  # the larger
    assert friction["foot"] == pytest.approx([0.6, 0.03, 0.02])  # of the higher priority
    assert friction["pad"] == pytest.approx([0.2, 0.005, 0.0001])  # of the pair
    dimensions = dict(zip(friction, model.geom_condim.tolist()))
    assert dimensions == {"floor": 1, "trunk": 3, "foot": 6, "pad": 3}
    assert start.loaded.model.geom_friction[0, 0] == 1.5  # the model itself stays


def test_joints_have_the_scenes_figures(tmp_path):
    robot, start, scene = limb(tmp_path)
    for passive, damping in (("keep", 0.3), ("replace", 0.0)):
        model = adapted(start, joint_model(start, passive))  # type: ignore[arg-type]
        assert model.dof_damping[6] == damping
        assert model.dof_armature[6] == 0.02
    said = Scene(model=scene.model, joints={"hip": {"armature": 0.5, "friction": 2.0}})
    start = start_of(robot, said)
    heavy = adapted(start, joint_model(start, "replace"))
    assert heavy.dof_armature[6] == 0.5
    assert heavy.dof_frictionloss[6] == 2.0
    assert heavy.dof_invweight0[6] < 0.3 * model.dof_invweight0[6]  # of the new armature
    assert not heavy.actuator_ctrllimited.any()
    assert start.qpos[7] == pytest.approx(start.joint_pos[0])


def test_what_it_does_otherwise_is_told(tmp_path):
    assert otherwise(limb(tmp_path)[1]) == []
    ghost = '<geom name="ghost" type="sphere" size="0.01" contype="0" conaffinity="0"/>'
    pair = '<pair geom1="floor" geom2="ghost"/>'
    _, start, _ = limb(tmp_path, integrator="RK4", solver="PGS", more=ghost, pair=pair)
    assert otherwise(start) == [
        "integrator RK4 became implicitfast",
        "solver PGS became Newton",
        "left out: contacts of 1 geoms that touch by pairs alone",
    ]


def test_without_genesis_the_install_command_is_told(monkeypatch):
    monkeypatch.setitem(sys.modules, "genesis", None)
    hook = sys.excepthook
    with pytest.raises(MissingDependencyError) as error:
        load_workflow("go2_stand", ["platform=genesis"])
    assert str(error.value) == f"platform 'genesis' needs genesis-world: {INSTALL}"
    assert sys.excepthook is hook


# What it reads and does


@needs_genesis
@pytest.mark.parametrize("name", ["go2_stand", "g1_walk"])
def test_masses_and_places_of_links_are_mujocos(name):
    workflow = load_workflow(name, ["platform=genesis"])
    platform: Any = workflow.platform
    model = platform.start.loaded.model
    entity = platform._robots
    data = mujoco.MjData(model)
    qpos = platform.start.qpos
    rng = np.random.default_rng(3)
    at = platform.start.loaded.addresses
    qpos[at] += rng.uniform(-0.3, 0.3, len(at))
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    entity.set_qpos(qpos[None])
    names = [link.name for link in entity.links]
    pos, quat = (array()[0].numpy() for array in (entity.get_links_pos, entity.get_links_quat))
    masses = entity.get_links_mass().numpy().reshape(-1)
    assert len(names) > 12
    for i, link in enumerate(names):
        body = model.body(link).id
        assert pos[i] == pytest.approx(data.xpos[body], abs=1e-6)
        assert np.abs(quat[i] @ data.xquat[body]) == pytest.approx(1.0, abs=1e-9)
        assert masses[i] == pytest.approx(model.body_mass[body], rel=1e-6)
    joints = platform._rates
    figures = platform.figures
    assert entity.get_dofs_armature(joints).numpy() == pytest.approx(figures.armature)
    assert entity.get_dofs_damping(joints).numpy() == pytest.approx(figures.damping)
    assert entity.get_dofs_frictionloss(joints).numpy() == pytest.approx(figures.friction)
    workflow.close()


@needs_genesis
@pytest.mark.parametrize("name", ["go2_stand", "g1_walk"])
def test_a_robot_in_the_air_moves_as_in_mujoco(name):
    """Inertia, armature, damping, dry friction and limits at once; measured: 1e-14."""
    scene = "scene.initial_height=3.0"
    workflow = load_workflow(name, ["platform=genesis", scene])
    platform: Any = workflow.platform
    model = adapted(platform.start, platform.figures)
    model.opt.timestep = platform.timestep
    data = mujoco.MjData(model)
    joints = platform._rates
    data.qpos[:] = platform._begin[0]
    for step in range(150):
        torque = 4.0 * np.sin(step // 10 + np.arange(len(joints)))
        data.qfrc_applied[joints] = torque
        mujoco.mj_step(model, data)
        platform.step(torque[None])
        assert platform._positions()[0] == pytest.approx(data.qpos, abs=1e-8)
        assert platform._velocities()[0] == pytest.approx(data.qvel, abs=1e-6)
    assert data.nefc > 0
    assert np.abs(data.qpos - platform._begin[0]).max() > 0.3
    workflow.close()


@needs_genesis
def test_a_joint_that_does_not_begin_at_0_is_where_it_says(tmp_path):
    robot, _, scene = limb(tmp_path)
    ends = []
    for platform in ("mujoco", "genesis"):
        workflow = load_workflow(_workflow(tmp_path, robot, scene), [f"platform={platform}"])
        states = workflow.states
        workflow.platform.recv()
        assert float(states.joint_pos[0]) == pytest.approx(0.5, abs=1e-6)
        states.joint_stiffness = 10.0
        states.joint_pos_target = -0.5
        for _ in range(10):
            workflow.platform.send()
        workflow.platform.recv()
        ends.append(float(states.joint_pos[0]))
        workflow.close()
    assert ends[0] < 0.4
    assert ends[1] == pytest.approx(ends[0], abs=0.01)


def _workflow(folder, robot, scene):
    path = folder / "limb_hold.yaml"
    path.write_text(
        f"schema: unicon.workflow/1\nname: limb_hold\ndescription: hold\nrobot: {robot.path}\n"
        f"platform: mujoco\nscene: {{model: {scene.model}, initial_pose: default, "
        "initial_height: 3}\n"
        "rate: 50\nflow: hold\n",
        encoding="utf-8",
    )
    return str(path)


@needs_genesis
@pytest.mark.parametrize(("name", "seconds", "way"), [("go2_walk", 60, 3.5), ("g1_walk", 10, 3.6)])
def test_it_walks_there(name, seconds, way):
    pytest.importorskip("onnxruntime", reason="the policy needs onnxruntime")
    workflow = load_workflow(name, ["platform=genesis"])
    report = Runner(workflow, RunOptions(speed="max", duration=seconds)).run()
    assert report.faults == []
    assert not report.fell
    assert np.hypot(*report.base_displacement_m[:2]) >= way


@needs_genesis
@pytest.mark.parametrize("speed", [1e6, np.nan, 1e300])
def test_physics_that_blow_up_are_a_fault(speed):
    workflow = load_workflow("go2_stand", ["platform=genesis"])
    platform: Any = workflow.platform
    platform._robots.set_dofs_velocity(np.full((1, 18), speed))
    with pytest.raises(Fault, match="blew up"):
        platform.send()
    platform.reset()
    platform.send()
    workflow.close()


_OTHER = """
import logging, signal, sys
hook, handlers = sys.excepthook, [signal.getsignal(s) for s in (2, 11, 15)]
{init}
from unicon_core.workflow import load_workflow
for _ in range(2):
    one = load_workflow("go2_stand", ["platform=genesis", "flow=hold"])
    for _ in range(3):
        one.platform.recv()
        one.platform.send()
    one.close()
    one.platform.close()
assert handlers == [signal.getsignal(s) for s in (2, 11, 15)]
assert {mine} or sys.excepthook is hook
"""


@needs_genesis
@pytest.mark.parametrize(
    "init", ["", "import genesis as gs; gs.init(precision='32', logging_level='error')"]
)
def test_it_keeps_to_itself_in_a_process_whoever_began(init):
    text = _OTHER.format(init=init, mine=bool(init))
    done = subprocess.run(
        [sys.executable, "-c", text],
        capture_output=True,
        text=True,
        timeout=390,
        check=False,
        env={k: v for k, v in os.environ.items() if not k.startswith("QD_")},  # of this process's
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout == ""
    lines = done.stderr.splitlines()
    assert [line for line in lines if not line.startswith("genesis: ")] == []
    assert len(lines) <= 4


@needs_genesis
def test_begun_twice_is_once():
    assert begun() is begun()
