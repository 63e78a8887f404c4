"""A policy that moves a group of joints, and does not see the joints that others move."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from unicon_base.errors import Fault, UniconError, WorkflowError
from unicon_core.check import check_workflow
from unicon_core.flow import Zip
from unicon_core.policies import Policy, load_policy, policy_states
from unicon_core.policies.policy import DrivenPolicy
from unicon_core.robots import Robot, load_robot
from unicon_core.runtime import Runner, RunOptions
from unicon_core.runtime.report import Report
from unicon_core.states import States, standard_states
from unicon_core.workflow import Program
from unicon_core.workflow.uses import block

pytest.importorskip("onnxruntime", reason="the networks are ONNX")

HIDDEN = {"policy": "walk", "drives": ["legs", "waist"], "sees_default_for": ["arms"]}
SEEN = {"policy": "walk", "drives": ["legs", "waist"]}


class Wave:
    """Swings some joints about their standing pose."""

    endless = True
    writes = ("joint_pos_target", "joint_stiffness", "joint_damping")

    def __init__(self, states: States, robot: Robot, period: float, moves: tuple[str, ...]) -> None:
        self.moves, self._period, self._ticks = moves, period, 0
        at = robot.group(moves)
        self._phase = np.arange(len(at))
        self._default = robot.default_joint_pos[at]
        self._gains = robot.joint_stiffness[at], robot.joint_damping[at]
        self._outs, self._at = [states[name] for name in self.writes], at

    def __call__(self) -> None:
        self._ticks += 1
        time = self._ticks * self._period
        swing = 0.6 * min(time / 2.0, 1.0) * np.sin(2.0 * np.pi * 0.4 * time + self._phase)
        for out, value in zip(self._outs, (self._default + swing, *self._gains)):
            out[self._at] = value


def waving(*moves: str) -> Callable[..., Any]:
    def wave(states: States, robot: Robot, period: float) -> Wave:
        return Wave(states, robot, period, moves)

    return wave


def walking(assets: Path, drives: dict[str, Any], *moves: str, **values: Any) -> Program:
    return Program(
        robot="g1_29dof",
        platform="mujoco",
        scene={
            "model": str(assets / "models/g1_29dof/g1_29dof.xml"),
            "initial_pose": "policy:walk",
        },
        policies={
            "walk": {
                "path": str(assets / "policies/g1_velocity_mjlab"),
                "given": {"robot": "g1_29dof"},
            }
        },
        commands=[{"velocity_command": {"constant": [0.6, 0.0, 0.0]}}],
        flow=Zip(block("policy", **drives), block(waving(*moves or ("arms",)))),
        safety=["finite", "joint_limits", "tilt_stop"],
        **values,
    )


def ran(program: Program, duration: float) -> Report:
    options = RunOptions(duration=duration, speed="max", warn=lambda _: None)
    return Runner(program, options).run()


def test_g1_walks_while_its_arms_swing_unseen(assets: Path) -> None:
    program = walking(assets, HIDDEN)
    report = ran(program, 20.0)
    assert not report.faults
    assert float(program.states["base_pos_w"][0]) > 8.0


def test_with_the_arms_seen_it_falls(assets: Path) -> None:
    report = ran(walking(assets, SEEN), 20.0)
    assert "leans" in str(report.faults[0])


def test_it_is_the_policy_with_hidden_joints_at_their_default() -> None:
    robot, contract = load_robot("go2"), load_policy("go2_velocity")
    specs = standard_states(robot.joint_names)
    specs |= policy_states(contract, robot.joint_names, {})
    live, whole = States(specs), States(specs)
    driven = DrivenPolicy(lambda s: Policy(contract, s, robot), live, robot, ["F*"], ["RL_*"])
    plain = Policy(contract, whole, robot)
    front, hidden = robot.group(["F*"]), robot.group(["RL_*"])
    default = dict(zip(contract.joints, contract.default_joint_pos))
    generator = np.random.default_rng(3)
    for _ in range(5):
        for name in driven.reads:
            live[name][...] = generator.normal(0.0, 0.3, live[name].shape)
            whole[name][...] = live[name]
        whole["joint_pos"][hidden] = [default[robot.joint_names[i]] for i in hidden]
        whole["joint_vel"][hidden] = 0.0
        for name in ("joint_pos_target", "joint_stiffness", "joint_damping"):
            live[name][...] = 7.0
        driven()
        plain()
        for name in ("joint_pos_target", "joint_stiffness", "joint_damping"):
            assert (live[name][front] == whole[name][front]).all()
            assert (np.delete(live[name], front) == 7.0).all()
        for name in ("action", "observation"):
            if name in live:
                assert (live[name] == whole[name]).all()
    before = live.buffer.copy()
    driven.warm_up()
    assert (live.buffer == before).all()
    driven.reset()
    assert not live["action"].any()


def test_nan_of_a_hidden_joint_is_not_seen() -> None:
    robot, contract = load_robot("go2"), load_policy("go2_velocity")
    specs = standard_states(robot.joint_names)
    specs |= policy_states(contract, robot.joint_names, {})
    states = States(specs)
    driven = DrivenPolicy(lambda s: Policy(contract, s, robot), states, robot, (), ["RL_*"])
    states["joint_pos"][robot.group(["RL_*"])] = np.nan
    driven()
    places = np.setdiff1d(np.arange(12), robot.group(["RL_*"]))
    assert (driven.places == places).all()
    assert np.isfinite(states["joint_pos_target"]).all()
    states["joint_pos"][robot.group(["RR_*"])] = np.nan
    with pytest.raises(Fault, match="not finite"):
        driven()


@pytest.mark.parametrize(
    ("drives", "moves", "error"),
    [
        ({**HIDDEN, "drives": ["lges"]}, ("arms",), "no group or joint 'lges'; did you mean"),
        ({**HIDDEN, "sees_default_for": ["arm"]}, ("arms",), "no group or joint 'arm'"),
        ({**HIDDEN, "sees_default_for": ["legs"]}, ("arms",), "and would not see it"),
        (HIDDEN, ("right_arm",), "'joint_pos_target of left_arm', which no block writes"),
        ({**HIDDEN, "drives": ["legs"]}, ("arms",), "'joint_pos_target of waist', which no"),
        (HIDDEN, ("arms", "waist_yaw_joint"), "both move waist_yaw_joint: take them"),
        ({"policy": "walk"}, ("arms",), "give 'policy' other joints, of: legs or waist"),
        (HIDDEN, ("wings",), "no group or joint 'wings'"),
    ],
)
def test_joints_have_one_writer(
    assets: Path, drives: dict[str, Any], moves: tuple[str, ...], error: str
) -> None:
    with pytest.raises(UniconError) as raised:
        walking(assets, drives, *moves)
    assert error in str(raised.value)


WORKFLOW = """
schema: unicon.workflow/1
name: {name}
description: Arms swing.
robot: g1_29dof
platform: mujoco
scene: {{model: "assets:models/g1_29dof/g1_29dof.xml", initial_pose: "policy:walk"}}
policies: {{walk: {{path: "assets:policies/g1_velocity_mjlab", given: {{robot: g1_29dof}}}}}}
flow:
  zip:
    - policy: {{policy: walk, drives: [legs, waist]{more}}}
    - call: {{function: "arms_that_swing:swing"}}
safety: [finite, joint_limits, tilt_stop]
check: {{accept: {accept}}}
"""


@pytest.mark.usefixtures("assets")
def test_seen_joints_of_others_are_a_finding(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "arms_that_swing.py").write_text(
        "from test_driven import Wave\nfrom unicon_core.flow import Tick\n\n"
        "def swing(states, robot, period) -> Tick:\n"
        "    return Wave(states, robot, period, ('arms',))\n"
    )

    def found(name: str, more: str, accept: str = "[]") -> list[str]:
        path = tmp_path / f"{name}.yaml"
        path.write_text(WORKFLOW.format(name=name, more=more, accept=accept))
        return [str(finding) for finding in check_workflow(path).findings]

    (line,) = found("seen", "")
    assert "'walk': sees left_shoulder_pitch_joint" in line
    assert "joints.seen" in line
    assert "seen.yaml:" in line
    assert found("accepted", "", "[joints.seen]") == []
    assert found("hidden", ", sees_default_for: [arms]") == []


def test_one_that_drives_nothing_is_refused() -> None:
    robot, contract = load_robot("go2"), load_policy("go2_velocity")
    specs = standard_states(robot.joint_names)
    specs |= policy_states(contract, robot.joint_names, {})
    with pytest.raises(WorkflowError, match="drives no joint"):
        DrivenPolicy(lambda s: Policy(contract, s, robot), States(specs), robot, (), ["*"])


@pytest.mark.parametrize("name", ["g1_29dof", "g1_23dof", "h1", "h1_2", "t1", "adam_lite", "x2"])
def test_groups_of_a_humanoid_part_it(name: str) -> None:
    robot = load_robot(name)
    parts = [robot.groups[group] for group in ("legs", "waist", "arms")]
    parts += [robot.groups["head"]] if "head" in robot.groups else []
    assert sorted(joint for part in parts for joint in part) == sorted(robot.joint_names)
    both = {*robot.groups["left_arm"], *robot.groups["right_arm"]}
    assert both == {*robot.groups["arms"]}
    assert len(robot.groups["left_arm"]) == len(robot.groups["right_arm"])
