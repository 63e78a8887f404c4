"""Policies in every format are the loop of that format, bit-exact, and walk alike.

Each format holds go2_velocity (`format_writers.py`). Beside what is imported runs a plain loop of
numpy, onnxruntime and mujoco, which knows the format by that table alone.
"""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from format_writers import FORMS, MOTORS, ROOT, SHIPPED, Form, dump, pose
from onnx import TensorProto, helper, numpy_helper
from policy_helpers import save, write_linear

from unicon_core.policies import import_policy
from unicon_core.policies.networks.onnx_file import read_onnx
from unicon_core.robots import load_robot
from unicon_core.runtime import Report, Runner, RunOptions
from unicon_core.workflow import load_workflow

mujoco = pytest.importorskip("mujoco", reason="the robot walks in mujoco")
ort = pytest.importorskip("onnxruntime", reason="the plain loop runs onnxruntime")

F = np.float32
MODEL = ROOT / "config" / "models" / "go2" / "go2.xml"
COMMAND = F([0.6, 0.0, 0.2])


def workflow(folder: Path, policy: Any) -> Path:
    """Write a workflow that walks with a policy from the first tick; return it."""
    values = {
        "schema": "unicon.workflow/1", "name": "walk", "robot": "go2", "platform": "mujoco",
        "scene": {"initial_pose": "policy:walk"}, "policies": {"walk": policy}, "rate": 50,
        "flow": {"policy": "walk"}, "safety": "none",
        "commands": [{"velocity_command": {"constant": COMMAND.tolist()}}],
    }  # fmt: skip
    dump(folder / "walk.yaml", values)
    return folder / "walk.yaml"


def imported(folder: Path, name: str) -> tuple[dict[str, Any], Path]:
    """Write the policy in a format and import it; return a workflow's entry, and the folder."""
    entry = FORMS[name].write(folder / "source", FORMS[name])
    report = import_policy(
        entry["path"], folder / "imported", robot=load_robot("go2"), given=entry.get("given")
    )
    assert not report.missing
    return entry, report.path.parent


class Physics:
    """Go2 in plain mujoco: PD torques of affine actuators, ten steps of 2 ms for a tick."""

    def __init__(self, qpos: Any) -> None:
        m = self.m = mujoco.MjModel.from_xml_path(str(MODEL))
        limit = np.tile([23.7, 23.7, 45.43], 4)
        m.actuator_biastype[:] = int(mujoco.mjtBias.mjBIAS_AFFINE)
        m.actuator_ctrllimited[:], m.actuator_forcelimited[:] = 0, 1
        m.actuator_gainprm[:, 0] = m.actuator_biasprm[:] = 0.0
        m.actuator_forcerange[:] = np.float32(limit)[:, None] * np.array([-1.0, 1.0])
        ranges = m.actuator_ctrlrange
        m.actuator_forcerange[:, 0] = np.maximum(m.actuator_forcerange[:, 0], ranges[:, 0])
        m.actuator_forcerange[:, 1] = np.minimum(m.actuator_forcerange[:, 1], ranges[:, 1])
        self.d = mujoco.MjData(m)
        self.d.qpos[:] = qpos
        mujoco.mj_forward(m, self.d)

    def measured(self) -> dict[str, Any]:
        d = self.d
        gyro = d.sensordata[self.m.sensor("imu_gyro").adr[0] :][:3]
        rotation = d.body(1).xmat.reshape(3, 3)
        return {
            "q": F(d.qpos[7:]), "dq": F(d.qvel[6:]), "ang_vel": F(gyro),
            "gravity": F(np.array([0.0, 0.0, -1.0]) @ rotation),
        }  # fmt: skip

    def step(self, target: Any) -> None:
        m, d = self.m, self.d
        m.actuator_gainprm[:, 0], m.actuator_biasprm[:, 1], m.actuator_biasprm[:, 2] = 40, -40, -1
        d.ctrl[:] = target
        mujoco.mj_step2(m, d)
        mujoco.mj_step(m, d, 9)
        mujoco.mj_step1(m, d)


class Plain:
    """The loop of a format."""

    def __init__(self, form: Form, session: Any) -> None:
        self.form, self.session, self.default = form, session, F(pose(form))
        self.last, self.phase, self.command = np.zeros(12, F), 0.0, np.zeros(3, F)
        self.frames: deque[Any] = deque(maxlen=form.history)
        self.at = [MOTORS.index(name) for name in form.order]

    def __call__(self, now: dict[str, Any]) -> Any:
        """Return the targets in motor order."""
        form, now = self.form, dict(now)
        step = F(np.inf if form.slew is None else form.slew * 0.02)
        self.command = self.command + np.clip(COMMAND - self.command, -step, step)
        if form.gait is not None:
            self.phase = np.fmod(self.phase + (2 * np.pi * 0.02 / form.gait + np.pi), 2 * np.pi)
            self.phase -= np.pi
        now |= {
            "q": now["q"][self.at] - self.default, "dq": now["dq"][self.at], "action": self.last,
            "command": self.command, "phase": F([np.sin(self.phase), np.cos(self.phase)]),
            "sin": F([np.sin(self.phase)]), "cos": F([np.cos(self.phase)]),
        }  # fmt: skip
        frame = np.concatenate([now[name] * F(scale) for name, scale in form.blocks.items()])
        if form.bound is not None:
            frame = np.clip(frame, -form.bound, form.bound)
        if not self.frames:
            self.frames.extend([np.zeros_like(frame)] * form.history)
        self.frames.append(frame)
        self.seen = np.concatenate(self.frames)
        action = self.session.run(None, {"obs": self.seen[None]})[0][0]
        clipped = action if form.clip is None else np.clip(action, F(-form.clip), F(form.clip))
        self.last = clipped if form.feeds_clipped else action
        target = np.zeros(12, F)
        target[self.at] = self.default + F(0.25) * clipped
        return target


def walked(path: Path, ticks: int) -> Iterator[tuple[Any, Any, Any, float]]:
    """Yield observation, targets, initial positions and way along x of each tick of a workflow."""
    program = load_workflow(str(path))
    start = program.platform.data.qpos.copy()
    runner = Runner(program, RunOptions(speed="max"))
    runner.reset()
    for _ in range(ticks):
        runner.tick(0)
        target = program.states["joint_pos_target"].copy()
        seen = program.states["observation"].copy()
        yield seen, target, start, float(program.states["base_pos_w"][0])
    program.close()


@lru_cache
def shipped(folder: Path, ticks: int) -> float:
    """How far the shipped policy walks in [m]."""
    *_, (*_, way) = walked(workflow(folder, f"{SHIPPED}/"), ticks)
    return way


def beside_its_loop(folder: Path, policy: Path, form: Form, ticks: int) -> float:
    """Hold a policy against the loop of its format in every tick; return the way in [m]."""
    model = next(policy.glob("*.onnx"))
    loop = Plain(form, ort.InferenceSession(str(model), providers=["CPUExecutionProvider"]))
    physics, way = None, 0.0
    for tick, told in enumerate(walked(workflow(folder, f"{policy}/"), ticks)):
        seen, target, start, way = told
        physics = physics or Physics(start)
        wanted = loop(physics.measured())
        np.testing.assert_array_equal(seen, loop.seen, f"observation of tick {tick}")
        np.testing.assert_array_equal(target, wanted, f"tick {tick}")
        physics.step(wanted)
    return way


@pytest.mark.parametrize("name", FORMS)
def test_a_format_is_its_loop_to_the_bit_and_walks_as_shipped(
    tmp_path: Path, tmp_path_factory: pytest.TempPathFactory, name: str
) -> None:
    _, folder = imported(tmp_path, name)
    way = beside_its_loop(tmp_path, folder, FORMS[name], 250)
    assert way > 1.5
    assert way == pytest.approx(shipped(tmp_path_factory.getbasetemp(), 250), abs=0.25)


@pytest.mark.parametrize("name", FORMS)
def test_a_random_network_in_a_format_is_its_loop_to_the_bit(tmp_path: Path, name: str) -> None:
    """It sees all of its input, and its actions are beyond the clip where there is one."""
    _, folder = imported(tmp_path, name)
    model, policy = next(folder.glob("*.onnx")), folder / "policy.yaml"
    inputs = read_onnx(model).inputs[0].shape[1]
    assert isinstance(inputs, int)
    weight = F(np.random.default_rng(3).normal(size=(inputs, 12))) * F(
        0.02 if FORMS[name].clip is None else 200.0
    )
    write_linear(model, inputs, 12, weight=weight)
    text = policy.read_text("utf-8").splitlines(keepends=True)
    policy.write_text("".join(line for line in text if not line.startswith("sha256")), "utf-8")
    beside_its_loop(tmp_path, folder, FORMS[name], 12)


def run(path: Path, speed: Any) -> Report:
    program = load_workflow(str(path))
    return Runner(program, RunOptions(speed=speed, duration=2.0)).run()


@pytest.mark.slow
@pytest.mark.parametrize("name", FORMS)
def test_real_rate_and_full_speed_give_the_same_commands(tmp_path: Path, name: str) -> None:
    entry, folder = imported(tmp_path, name)
    fast, real = (run(workflow(tmp_path, entry), speed) for speed in ("max", "real"))
    again = run(workflow(tmp_path, f"{folder}/"), "max")
    assert fast.ticks == real.ticks == 100
    assert fast.sha256_commands == real.sha256_commands == again.sha256_commands


def exploy(path: Path, order: list[str], weight: Any, default: Any) -> None:
    """Write a linear network as exploy does: states by name, targets in [rad], its own memory."""
    sizes = {
        "obj.go2.joints.pos": 12, "obj.go2.joints.vel": 12, "obj.go2.base.w_Q_b": 4,
        "sensor.imu.base.ang_vel_b_rt_w_in_b": 3, "cmd.se2_velocity.base": 3,
        "memory.last.in": 12,
    }  # fmt: skip
    nodes = [
        helper.make_node("Concat", list(sizes), ["all"], axis=1),
        helper.make_node("MatMul", ["all", "weight"], ["memory.last.out"]),
        helper.make_node("Add", ["memory.last.out", "default"], ["output.joint_targets.legs.pos"]),
    ]
    ends = ("output.joint_targets.legs.pos", "memory.last.out")

    def tensor(name: str, size: int) -> Any:
        return helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, size])

    constants = {"weight": weight, "default": default[None]}
    graph = helper.make_graph(
        nodes,
        "exploy",
        [tensor(*item) for item in sizes.items()],
        [tensor(name, 12) for name in ends],
        [numpy_helper.from_array(F(value), name) for name, value in constants.items()],
    )
    metadata = {
        "exploy_version": "0.1.0",
        "update_rate": 50.0,
        "output.joint_targets.legs": {
            "names": order,
            "stiffness": [40.0] * 12,
            "damping": [1.0] * 12,
        },
        "obj.go2.joints": {"joint_names": order},
    }
    save(path, graph, [(key, json.dumps(value)) for key, value in metadata.items()])


def exploy_workflow(folder: Path) -> tuple[Path, Path, list[str]]:
    rng = np.random.default_rng(8)
    order = [str(name) for name in rng.permutation(MOTORS)]
    default = F(np.tile([0.0, 0.9, -1.8], 4))[[MOTORS.index(name) for name in order]]
    exploy(folder / "exploy.onnx", order, rng.normal(size=(46, 12)) * 0.03, default)
    report = import_policy(
        folder / "exploy.onnx",
        folder / "imported",
        given={"default_joint_pos": default.tolist()},
    )
    return workflow(folder, f"{report.path.parent}/"), folder / "exploy.onnx", order


def test_states_by_name_are_their_loop_to_the_bit(tmp_path: Path) -> None:
    path, network, order = exploy_workflow(tmp_path)
    session = ort.InferenceSession(str(network), providers=["CPUExecutionProvider"])
    at = [MOTORS.index(name) for name in order]
    last = np.zeros((1, 12), F)
    program = load_workflow(str(path))
    runner = Runner(program, RunOptions(speed="max"))
    physics = Physics(program.platform.data.qpos.copy())
    runner.reset()
    for tick in range(25):
        runner.tick(0)
        now = physics.measured()
        quat = F(physics.d.qpos[3:7])
        feed = {
            "obj.go2.joints.pos": now["q"][at], "obj.go2.joints.vel": now["dq"][at],
            "obj.go2.base.w_Q_b": quat, "sensor.imu.base.ang_vel_b_rt_w_in_b": now["ang_vel"],
            "cmd.se2_velocity.base": COMMAND,
        }  # fmt: skip
        target, last = session.run(
            None, {name: value[None] for name, value in feed.items()} | {"memory.last.in": last}
        )
        wanted = np.zeros(12, F)
        wanted[at] = target[0]
        told = program.states["joint_pos_target"]
        np.testing.assert_array_equal(told, wanted, f"tick {tick}")
        physics.step(wanted)
    program.close()
    assert np.abs(last).max() > 0.01


@pytest.mark.slow
def test_states_by_name_are_the_same_at_real_rate(tmp_path: Path) -> None:
    path, _, _ = exploy_workflow(tmp_path)
    fast, real = (run(path, speed) for speed in ("max", "real"))
    assert fast.sha256_commands == real.sha256_commands
