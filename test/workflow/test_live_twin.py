"""The live twin: gap, lag and flag beside a run whose commands it does not touch."""

from __future__ import annotations

import importlib.util
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from unicon_base.errors import Fault, WorkflowError
from unicon_core.flow import Block, Stage
from unicon_core.platforms.kit.disturbances import Beside
from unicon_core.platforms.kit.scene import Scene
from unicon_core.platforms.mujoco import make
from unicon_core.robots import load_robot
from unicon_core.runtime import Runner, RunOptions
from unicon_core.states import States, standard_states
from unicon_core.states.standard import COMMAND_STATES
from unicon_core.workflow import HookBlocks, Program, load_document

pytest.importorskip("mujoco", reason="mujoco is not installed: pip install 'unicon_ros[sim]'")

RL_CALF = 11
WORKFLOW = """\
robot: go2
platform: mujoco
rate: 50
flow: {chain: [{excite: {signal: sine, frequency: 1.0, amplitude: 0.15, duration: 2.5, fade: 0.5}}]}
"""


def ran(
    path: Path, overrides: Mapping[str, Any] | None = None, text: str = WORKFLOW
) -> tuple[Any, dict[str, Any]]:
    """Run a workflow; return its report, and the twin's states of every tick."""
    path.write_text(text)
    rows: dict[str, list[Any]] = {}

    def hook(program: Program) -> HookBlocks:
        names = [name for name in program.states if name.startswith(("twin", "joint_pos"))]
        rows.update({name: [] for name in names})

        def look() -> None:
            for name in names:
                rows[name].append(program.states[name].copy())

        return {Stage.OBSERVE: [Block("look", look, endless=True)]}

    program = Program(load_document(path, overrides or {}), hooks=[hook])
    report = Runner(program, RunOptions(speed="max", warn=str)).run()
    return report, {name: np.array(values) for name, values in rows.items()}


def test_a_twin_of_a_simulator_is_the_same_and_changes_no_command(tmp_path: Path) -> None:
    path = tmp_path / "w.yaml"
    alone, _ = ran(path)
    report, told = ran(path, {"twin": "mujoco"})
    assert report.sha256_commands == alone.sha256_commands
    assert told["twin_gap"].max() < 1e-4  # it begins at states in float32
    assert told["twin_gap"][-1].min() > 0.0
    assert not told["twin_flag"].any()
    assert not told["twin_lag"].any()
    later = np.abs(told["twin_joint_pos"][:-1] - told["joint_pos"][1:])
    assert later.max() < 1e-3


def test_a_weak_joint_raises_its_flag_and_the_stop_names_it(tmp_path: Path) -> None:
    path = tmp_path / "w.yaml"
    weak = {"scene.joints": {"RL_calf_joint": {"strength": 0.3}}, "twin": {"platform": "mujoco"}}
    report, told = ran(path, weak)
    assert report.faults == []
    assert told["twin_gap"][-1].argmax() == RL_CALF
    assert told["twin_flag"][-1].nonzero()[0].tolist() == [RL_CALF]
    report, _ = ran(path, weak | {"safety": ["finite", "joint_limits", "twin_stop"]})
    assert "joint RL_calf_joint is 0." in report.faults[0]
    assert "rad from its twin for 10 ticks; is its motor weak" in report.faults[0]


PLAIN = """\
from unicon_core.platforms.platform import Facts
from unicon_core.platforms.mujoco import make

def plain(states, robot, period, scene=None):
    assert not (scene.joints or scene.delay or scene.seed)
    return make(states, robot, period, scene=scene)

plain.facts = Facts("plain", simulated=True)
"""


def test_a_twin_is_not_asked_for_the_joints_of_the_scene(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It leaves them out, so that one may be a twin that simulates nothing of joints."""
    (tmp_path / "plain_twin.py").write_text(PLAIN)
    monkeypatch.syspath_prepend(tmp_path)
    disturbed = {"joints": {"*": {"armature": 0.1}}, "delay": 2, "seed": 3}
    for twin in ("mujoco", "plain_twin:plain"):
        overrides = {"scene": disturbed, "twin": twin}
        Program(load_document(_written(tmp_path), overrides)).close()
    with pytest.raises(
        WorkflowError, match=r"scene.joints: platform 'plain' simulates no armature"
    ):
        Program(load_document(_written(tmp_path), overrides | {"platform": "plain_twin:plain"}))


def test_commands_that_come_late_are_a_lag(tmp_path: Path) -> None:
    """In the air, so that all joints are late by the same."""
    scene = {"scene.initial_height": 60.0, "scene.delay": 3}
    over = {"twin": {"platform": "mujoco", "window": 1.0}}
    _, told = ran(tmp_path / "w.yaml", scene | over)
    assert told["twin_lag"][-1] == pytest.approx([0.06] * 12, abs=0.021)


def test_its_physics_and_what_was_not_measured_are_no_fault_of_the_run(tmp_path: Path) -> None:
    program = Program(load_document(_written(tmp_path), {"twin": "mujoco"}))
    try:
        tick = next(b.tick for b in program.blocks if b.name == "twin")
        states = program.states
        program.platform.recv()
        before = {name: states[name].copy() for name in ("joint_pos", "joint_vel")}
        for value in (np.nan, np.inf, 1e30):
            states["joint_vel"][...] = value
            for _ in range(3):
                tick()
        states["joint_pos"][...], states["joint_vel"][...] = before.values()
        states["joint_pos_target"][...] = before["joint_pos"]
        states["joint_stiffness"][...], states["joint_damping"][...] = 40.0, 1.0
        for _ in range(60):
            tick()
        assert np.isfinite(states["twin_joint_pos"]).all()
        assert np.isfinite(states["twin_gap"]).all()
    finally:
        program.close()


def test_a_robot_that_is_sent_nothing_has_no_twin(tmp_path: Path) -> None:
    overrides = {"twin": "mujoco", "safety": ["finite", "twin_stop"]}
    program = Program(load_document(_written(tmp_path), overrides), silent=True)
    program.close()
    assert "twin" not in [block.name for block in program.blocks]
    assert "twin_stop" in program.safety_left_out


def _written(folder: Path) -> Path:
    path = folder / "w.yaml"
    path.write_text(WORKFLOW)
    return path


@pytest.mark.parametrize(
    ("twin", "message"),
    [
        ([1], r"twin is \[1\]; write"),
        ({"window": 0.2}, r"twin: missing key 'platform'"),
        ({"platform": "mujoco", "bounds": 1}, r"twin: unknown key 'bounds'; did you mean 'bound'"),
        (
            {"platform": "mujoco", "window": -1},
            r"twin\.window is -1; write a number above 0 to 10",
        ),
        ({"platform": "mujoco", "window": float("nan")}, r"twin\.window is nan; write a number"),
        ({"platform": "mujoco", "over": 11}, r"twin\.over is 11"),
        ({"platform": "mujoco", "bound": 0}, r"twin\.bound is 0"),
        ({"platform": 3}, r"twin\.platform is 3"),
        ("mujoko", r"twin: unknown platform 'mujoko'; did you mean 'mujoco'"),
        ("fake_robot", r"twin: platform 'fake_robot' is a robot"),
        (
            "replay",
            r"twin: platform 'replay' cannot be a twin \(.*\); write twin: \{platform: mujoco",
        ),
        ("fake", r"twin: platform 'fake' cannot be put where a robot was measured; use mujoco"),
    ],
)
def test_nonsense_is_one_line(tmp_path: Path, twin: Any, message: str) -> None:
    with pytest.raises(WorkflowError, match=message):
        Program(load_document(_written(tmp_path), {"twin": twin}))


def test_a_stop_without_a_twin_and_a_twin_of_a_batch_are_refused(tmp_path: Path) -> None:
    with pytest.raises(WorkflowError, match=r"twin_flag"):
        Program(load_document(_written(tmp_path), {"safety": ["finite", "twin_stop"]}))
    with pytest.raises(WorkflowError, match=r"twin: a twin is of one robot"):
        Program(load_document(_written(tmp_path), {"twin": "mujoco", "num_robots": 2}))


@pytest.mark.skipif(importlib.util.find_spec("pybullet") is None, reason="no pybullet")
def test_a_simulator_that_cannot_be_put_anywhere_is_refused(tmp_path: Path) -> None:
    with pytest.raises(WorkflowError, match=r"platform 'pybullet' cannot be put where"):
        Program(load_document(_written(tmp_path), {"twin": "pybullet"}))


def test_put_is_what_is_read_then() -> None:
    robot = load_robot("go2")
    states = States(standard_states(robot.joint_names))
    platform = make(states, robot, 0.02, scene=Scene())
    rng = np.random.default_rng(0)
    quat = rng.normal(size=4)
    put = {
        "joint_pos": rng.uniform(-0.5, 0.5, 12),
        "joint_vel": rng.uniform(-1.0, 1.0, 12),
        "base_quat": quat / np.linalg.norm(quat),
        "base_ang_vel": rng.uniform(-1.0, 1.0, 3),
        "base_pos_w": np.array((1.0, 2.0, 3.0)),
        "base_lin_vel": rng.uniform(-1.0, 1.0, 3),
    }
    platform.put(put)
    platform.recv()
    for name, value in put.items():
        np.testing.assert_allclose(states[name], value, atol=1e-6)


def test_a_base_whose_place_nobody_measures_stands_on_the_floor() -> None:
    robot = load_robot("go2")
    beside = Beside(make, robot, 0.02, Scene(initial_height=2.0))
    pose = robot.default_joint_pos
    beside.put({"joint_pos": pose, "joint_vel": 0.0 * pose, "base_quat": np.array((1.0, 0, 0, 0))})
    beside.platform.recv()
    assert beside.states["base_pos_w"][2] == pytest.approx(0.31, abs=0.02)
    commands = dict.fromkeys(COMMAND_STATES, np.full(12, np.nan))
    with pytest.raises(Fault, match="joint_pos_target"):
        beside.step(commands)
