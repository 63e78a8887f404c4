"""Strength, friction, armature and delay of joints: what they do, and where they are refused."""

from __future__ import annotations

import importlib
import importlib.util
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from scenes import in_scene

from unicon_base.errors import PlatformError, WorkflowError
from unicon_core.platforms.kit.command import JointDelay
from unicon_core.platforms.mujoco import make
from unicon_core.platforms.platform import info_of
from unicon_core.robots import load_robot, robot_table
from unicon_core.states import States, standard_states
from unicon_core.workflow import Program, load_document

CONFIG = Path(__file__).resolve().parents[2] / "config"
HAS_PYBULLET = importlib.util.find_spec("pybullet") is not None


def go2(joints=None, period=0.02, robot="go2"):
    """Return MuJoCo with a Go2 in the air, and its states."""
    it = load_robot(robot)
    states = States(standard_states(it.joint_names))
    scene = {"initial_height": 2.0} | ({} if joints is None else {"joints": joints})
    return in_scene(make, states, it, period, **scene), states


def overlay(folder, simulated):
    path = folder / "weak.yaml"
    path.write_text(f"schema: unicon.robot/1\nextends: go2\nsimulated: {simulated}\n")
    return path


def test_what_nobody_says_leaves_the_model_as_it_is():
    told, _ = go2({"*": {"strength": 1.0, "delay": 0.0}})
    plain, _ = go2()
    for name in ("dof_frictionloss", "dof_armature", "actuator_forcerange"):
        assert (getattr(told.model, name) == getattr(plain.model, name)).all()
    assert told.servo._strength is None
    assert told.robots[0].delay is None


def test_friction_and_armature_stand_in_the_model_by_name():
    platform, _ = go2({"*_calf_joint": {"friction": 1.5}, "RL_calf_joint": {"armature": 0.05}})
    dofs = {j: int(platform.model.joint(f"{j}_joint").dofadr[0]) for j in ("RL_calf", "FR_hip")}
    assert platform.model.dof_frictionloss[dofs["RL_calf"]] == 1.5
    assert platform.model.dof_frictionloss[dofs["FR_hip"]] == 0.2
    assert platform.model.dof_armature[dofs["RL_calf"]] == 0.05
    assert platform.model.dof_armature[dofs["FR_hip"]] == 0.01
    assert platform.info()["joints"]["friction"][11] == 1.5


def swung(platform, states):
    """Speed of a calf after 0.06 s of 1 N·m in the air, joints limp."""
    for name in ("joint_stiffness", "joint_damping"):
        states[name][...] = 0.0
    states.joint_effort_ff[...] = 0.0
    states.joint_effort_ff[2] = 1.0
    for _ in range(3):
        platform.send()
    platform.recv()
    return float(states.joint_vel[2])


@pytest.mark.parametrize("engine", ["mujoco", "pybullet"])
def test_passive_damping_is_kept_or_replaced(engine, tmp_path):
    if engine == "pybullet" and not HAS_PYBULLET:
        pytest.skip("pybullet is not installed")
    model = (CONFIG / "models" / "go2" / "go2.xml").read_text(encoding="utf-8")
    path = tmp_path / "damped.xml"
    path.write_text(model.replace('damping="0.1"', 'damping="0.5"'), encoding="utf-8")
    robot = load_robot("go2")
    build: Any = importlib.import_module(f"unicon_core.platforms.sim.{engine}.platform").make
    speeds = {}
    for word in ("keep", "replace"):
        states = States(standard_states(robot.joint_names))
        scene = {"initial_height": 3.0, "model": str(path)}
        platform = in_scene(build, states, robot, 0.02, passive=word, **scene)
        assert info_of(platform)["passive"] == word
        assert platform.passive_damping == pytest.approx(0.5 * (word == "keep"))
        speeds[word] = swung(platform, states)
        if word == "keep":
            platform.reset()
            with platform.undamped():
                speeds["undamped"] = swung(platform, states)
            platform.reset()
            assert swung(platform, states) == pytest.approx(speeds["keep"], rel=1e-4)
        platform.close()
    assert 0.0 < speeds["keep"] < 0.8 * speeds["replace"]
    assert speeds["undamped"] == pytest.approx(speeds["replace"], rel=1e-4)


def test_every_robot_of_a_batch_does_without_passive_damping():
    robot = load_robot("go2")
    states = States(standard_states(robot.joint_names), num_robots=3)
    platform = in_scene(make, states, robot, 0.02, passive="replace")
    assert not any(model.dof_damping.any() for model in platform._models)
    platform.close()


def test_passive_is_one_of_two_words():
    document = load_document("go2_stand", ["platforms={mujoco: {passive: drop}}"])
    with pytest.raises(WorkflowError, match=r"passive 'drop' is not known; known: keep, replace"):
        Program(document)


def test_strength_scales_torque_and_limit():
    efforts = []
    for strength in (1.0, 0.25):
        platform, states = go2({"RL_calf_joint": {"strength": strength}}, period=0.002)
        states["joint_pos_target"][...] = states["joint_pos"] if strength is None else -0.9
        states["joint_stiffness"][...] = 10.0
        platform.send()
        platform.recv()
        small = states["joint_effort"].copy()
        states["joint_stiffness"][...] = 2000.0
        platform.send()
        platform.recv()
        efforts.append((small[11], states["joint_effort"][11], small[8]))
    (small, limit, other), (weak, weak_limit, weak_other) = efforts
    assert weak == pytest.approx(0.25 * small, rel=1e-5)
    assert limit == pytest.approx(45.43, rel=1e-5)
    assert weak_limit == pytest.approx(0.25 * 45.43, rel=1e-5)
    assert weak_other == pytest.approx(other, rel=1e-3)


@pytest.mark.parametrize("steps", [1, 5, 9, 10, 13, 30])
def test_a_delay_is_the_same_command_some_physics_steps_later(steps):
    """Ten steps a tick; the reference feeds every step by hand."""
    delayed, states = go2({"*": {"delay": steps * 0.002}})
    plain, told = go2(period=0.002)
    rng = np.random.default_rng(steps)
    targets = load_robot("go2").default_joint_pos + rng.uniform(-0.2, 0.2, (6, 12))
    for each in (states, told):
        each["joint_stiffness"][...], each["joint_damping"][...] = 40.0, 1.0
    for step in range(60):
        if step % 10 == 0:
            states["joint_pos_target"][...] = targets[step // 10]
            delayed.send()
        told["joint_pos_target"][...] = targets[max(step - steps, 0) // 10]
        plain.send()
    assert np.abs(delayed.data.qpos - plain.data.qpos).max() < 1e-9
    assert np.abs(delayed.data.qvel).max() > 0.5


def test_joints_are_late_each_by_its_own_delay():
    rows = np.zeros((5, 4))
    late = JointDelay(rows, np.array([0, 3, 10, 25]), 10)
    acting = np.zeros((60, 4))
    step = 0
    for tick in range(6):
        rows[...] = tick + 1
        for steps, command in late():
            acting[step : step + steps] = command[0]
            step += steps
    assert step == 60
    for joint, delay in enumerate((0, 3, 10, 25)):
        at = np.maximum(np.arange(60) - delay, 0) // 10 + 1
        assert (acting[:, joint] == at).all()


def test_reset_forgets_the_commands_on_their_way():
    platform, states = go2({"*": {"delay": 0.05}})
    ends = []
    for _ in range(2):
        states["joint_stiffness"][...] = 40.0
        for target in (0.2, -0.2, 0.1, 0.0):
            states["joint_pos_target"][...] = load_robot("go2").default_joint_pos + target
            platform.send()
        ends.append(platform.data.qpos.copy())
        platform.reset()
    assert (ends[0] == ends[1]).all()


def test_an_overlay_is_the_robot_with_other_joints(tmp_path):
    path = overlay(tmp_path, "{RL_calf_joint: {strength: 0.5, friction: 2.0}}")
    robot = load_robot(path)
    assert (robot.name, robot.overlay) == ("go2", path)
    assert robot.path == load_robot("go2").path
    assert "RL_calf_joint.strength" in robot_table(robot)
    platform, _ = go2(robot=path)
    assert platform.info()["joints"]["strength"][11] == 0.5
    over, _ = go2({"RL_calf_joint": {"strength": 0.7}}, robot=path)
    assert over.info()["joints"]["strength"][11] == 0.7
    assert over.info()["joints"]["friction"][11] == 2.0


def program(tmp_path, text):
    path = tmp_path / "workflow.yaml"
    path.write_text(f"{text}\nrate: 50\nflow: hold\n")
    return Program(load_document(path))


@pytest.mark.parametrize(
    ("said", "message"),
    [
        ("{RL_calf_joint: {strength: -1}}", "RL_calf_joint.strength is -1; write a number from 0"),
        ("{RL_calf_joint: {friction: .inf}}", "scene.joints.RL_calf_joint.friction is inf"),
        ("{RL_calf_joint: {armature: true}}", "joints"),
        ("{RL_calf_joint: {mass: 1}}", "unknown key 'mass'; known: armature, delay"),
        ("{RL_calf: {strength: 1}}", "no joint like 'RL_calf'; did you mean 'RL_calf_joint'"),
        ("{RL_calf_joint: 0.5}", "joints"),
        ("[RL_calf_joint]", "joints"),
        ("{RL_calf_joint: {strength: .nan}}", "joints"),
    ],
)
def test_nonsense_in_a_scene_is_one_line(tmp_path, said, message):
    with pytest.raises(WorkflowError) as caught:
        program(tmp_path, f"robot: go2\nplatform: mujoco\nscene: {{joints: {said}}}")
    assert message in str(caught.value)
    assert "workflow.yaml:3" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_platform_that_cannot_says_what_it_can(tmp_path):
    weak = overlay(tmp_path, "{'*': {armature: 0.02}}")
    with pytest.raises(WorkflowError, match=r"'fake' simulates no strength .*nothing of joints"):
        program(tmp_path, "robot: go2\nplatform: fake\nscene: {joints: {'*': {strength: 0.5}}}")
    with pytest.raises(WorkflowError, match=rf"simulates no armature .* in {weak}, or choose"):
        program(tmp_path, f"robot: {weak}\nplatform: fake")
    with pytest.raises(WorkflowError, match=r"scene\.joints is for simulators"):
        program(tmp_path, "robot: go2\nplatform: fake_robot\nscene: {joints: {'*': {delay: 0.1}}}")
    program(tmp_path, f"robot: {weak}\nplatform: fake_robot").close()  # a robot has its own joints


@pytest.mark.skipif(not HAS_PYBULLET, reason="pybullet is not installed")
def test_pybullet_knows_strength_friction_and_delay(tmp_path):
    ways = {}
    for name, said in {
        "plain": "{}",
        "weak": "{RL_calf_joint: {strength: 0.3}}",
        "rubbing": "{RL_calf_joint: {friction: 20.0}}",
        "late": "{RL_calf_joint: {delay: 0.035}}",
    }.items():
        scene = f"{{initial_height: 2.0, joints: {said}}}"
        it = program(tmp_path, f"robot: go2\nplatform: pybullet\nscene: {scene}")
        states = it.states
        begin = load_robot("go2").default_joint_pos
        states["joint_stiffness"][...], states["joint_damping"][...] = 30.0, 1.0
        states["joint_pos_target"][...] = begin
        it.platform.send()
        states["joint_pos_target"][...] = begin + 0.2
        rows = []
        for _ in range(3):
            it.platform.send()
            it.platform.recv()
            rows.append(states["joint_pos"][[8, 11]] - begin[[8, 11]])
        it.close()
        ways[name] = np.array(rows)
    for name in ("weak", "rubbing", "late"):
        assert ways[name][0, 1] < 0.6 * ways["plain"][0, 1]
    assert abs(ways["rubbing"][:, 1]).max() < 0.01
    assert abs(ways["late"][0, 1]) < 0.02  # its body moves
    assert ways["late"][2, 1] > 0.05
    scene = "{joints: {'*': {armature: 0.02}}}"
    with pytest.raises(WorkflowError, match=r"'pybullet' simulates no armature"):
        program(tmp_path, f"robot: go2\nplatform: pybullet\nscene: {scene}")


def test_a_child_is_told_the_same(tmp_path):
    scene = "{joints: {RL_calf_joint: {strength: 0.5}}}"
    it = program(tmp_path, f"robot: go2\nplatform: {{child: mujoco}}\nscene: {scene}")
    try:
        assert info_of(it.platform)["joints"]["strength"][11] == 0.5
    finally:
        it.close()


def test_a_batch_of_weak_robots_is_as_one(toy_robot, toy_model, states_of):
    robot = toy_robot()
    joints = {"elbow_joint": {"strength": 0.5, "friction": 0.1, "delay": 0.002}}
    ends = []
    for count in (None, 2):
        states = states_of(robot, count)
        platform = in_scene(make, states, robot, 0.004, model=toy_model(), joints=joints)
        for target in (0.3, -0.2, 0.1):
            states["joint_stiffness"][...] = 20.0
            states["joint_pos_target"][...] = target
            platform.send()
        ends.append([r.data.qpos.copy() for r in platform.robots])
    assert (ends[0][0] == ends[1]).all()
    assert isinstance(platform.model, mujoco.MjModel)


def test_scene_in_python_refuses_too():
    with pytest.raises(PlatformError, match=r"scene\.joints\.\w+\.strength is nan"):
        go2({"RL_calf_joint": {"strength": np.nan}})
