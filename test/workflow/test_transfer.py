"""One word moves a workflow to another platform, model or robot; what does not fit is refused."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest

from unicon_base.errors import PolicyError, RobotError
from unicon_core.check import check_workflow
from unicon_core.platforms.platform import Facts
from unicon_core.policies import load_policy
from unicon_core.robots import Robot, load_robot
from unicon_core.runtime import Report, Runner, RunOptions
from unicon_core.states import States
from unicon_core.states.standard import JOINT_STATES
from unicon_core.workflow import Program, load_workflow, workflow_names

pytest.importorskip("mujoco", reason="the robots move in mujoco")
pytest.importorskip("onnxruntime", reason="the policies need onnxruntime")
pytest.importorskip("onnx", reason="the policies are cut down with onnx")

from restricted_policy import restrict

G1 = load_robot("g1_29dof").joint_names
LEGS = G1[:12]
SUBSETS: dict[str, Sequence[str]] = {
    "legs": LEGS,
    "legs_in_another_order": LEGS[::-1],
    "dof23": load_robot("g1_23dof").joint_names,
}


def run(
    name: str | Path, overrides: Mapping[str, Any], seconds: float = 60.0
) -> tuple[Report, Program]:
    workflow = load_workflow(name, overrides)
    speed: Literal["real", "max"] = "max" if workflow.platform.facts.simulated else "real"
    return Runner(workflow, RunOptions(duration=seconds, speed=speed)).run(), workflow


@pytest.fixture(params=sorted(SUBSETS))
def partial(request: pytest.FixtureRequest, tmp_path: Path, assets: Path) -> tuple[Path, list[str]]:
    """A policy for some joints of the G1, and these joints."""
    joints = list(SUBSETS[request.param])
    folder = restrict(assets / "policies/g1_velocity_mjlab", tmp_path / request.param, joints)
    return folder, joints


# -- fewer joints than the robot -----------------------------------------------------------------


def test_a_policy_for_some_joints_walks_and_the_others_are_held(
    partial: tuple[Path, list[str]],
) -> None:
    """The cut-down mjlab policy: measured 4.6 m with 12 joints, 5.6 m with 23, 5.2 m with all."""
    folder, joints = partial
    report, workflow = run("g1_walk", {"policies.walk": str(folder)}, 10.0)
    assert not report.faults
    assert not report.fell
    assert report.base_displacement_m[0] > 4.0
    robot, states, contract = workflow.robot, workflow.states, load_policy(folder)
    held = [i for i, name in enumerate(robot.joint_names) if name not in joints]
    assert len(held) == 29 - len(joints)
    for state, expected in (
        ("joint_pos_target", robot.default_joint_pos),
        ("joint_stiffness", robot.joint_stiffness),
        ("joint_damping", robot.joint_damping),
    ):
        np.testing.assert_array_equal(states[state][held], expected[held])
    # Gravity and the gait move what is held by the robot's soft gains: measured 0.32 rad at most.
    assert np.abs(states["joint_pos"][held] - robot.default_joint_pos[held]).max() < 0.5
    moved = [robot.joint_names.index(name) for name in joints]
    action = contract.action
    target = action.offset + action.scale * states["action"]
    lower, upper = robot.lower[moved], robot.upper[moved]
    np.testing.assert_allclose(
        states["joint_pos_target"][moved], np.clip(target, lower, upper), atol=1e-6
    )
    np.testing.assert_array_equal(states["joint_stiffness"][moved], contract.stiffness)
    np.testing.assert_array_equal(states["joint_damping"][moved], contract.damping)


def test_the_check_shows_what_is_held(partial: tuple[Path, list[str]]) -> None:
    folder, joints = partial
    result = check_workflow("g1_walk", [f"policies.walk={folder}"])
    assert result.clean, result.text()
    table = next(s for s in result.sections if s.title == "Joints")
    shown = {row[1]: row[2] for row in table.rows}
    assert [name for name in G1 if shown[name] == "held"] == [n for n in G1 if n not in joints]
    assert [int(shown[name]) for name in joints] == list(range(len(joints)))
    order = "in another order, aligned by name" if joints[0] > joints[-1] else "robot's order"
    assert any(f"moves {len(joints)} of 29 joints" in line for line in table.lines)
    assert len(joints) != 12 or any(order in line for line in table.lines)
    note = next(note for note in result.notes if note.code == "joints.held")
    assert "they are held at their default" in note.evidence


# -- sim to sim ----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", workflow_names())
def test_every_workflow_runs_on_the_fake_robot_by_one_word(
    name: str, assets: Path, at_hand: Callable[[str], None]
) -> None:
    at_hand(name)
    terrain = {"scene.terrain": None} if name == "go2_stairs" else {}  # `fake` has no ground
    report, _ = run(name, {"platform": "fake"} | terrain, 1.0)
    assert report.platform == "fake"
    assert report.ticks > 0
    assert report.duration_s == pytest.approx(1.0)
    assert not report.faults


def test_the_go2_policy_walks_on_another_model_of_the_robot(assets: Path) -> None:
    report, _ = run("go2_walk", {"scene.model": "assets:models/go2/go2.xml"})
    assert not report.faults
    assert not report.fell
    assert report.base_displacement_m[0] > 2.0  # measured 3.75 m


def test_the_go2_policy_walks_on_a_go1_whose_joints_have_the_same_names(assets: Path) -> None:
    overrides = {
        "robot": "go1",
        "scene": {"model": "assets:models/go1/go1.xml", "initial_pose": "keyframe:home"},
        "flow": {"policy": "walk"},
    }
    report, workflow = run("go2_walk", overrides, 10.0)
    assert workflow.robot.name == report.robot == "go1"
    assert not report.faults
    assert not report.fell
    assert report.base_displacement_m[0] > 2.0  # measured 4.0 m


@pytest.mark.parametrize("name", ["g1_walk", "g1_holosoma"])
def test_a_robot_without_the_policys_joints_is_refused_in_one_line_with_their_names(
    name: str, assets: Path
) -> None:
    with pytest.raises(PolicyError) as caught:
        load_workflow(name, {"robot": "h1"})
    line = str(caught.value)
    assert line.startswith("policy 'walk': robot h1 lacks 13 of the 29 joints needed: ")
    for joint in ("left_ankle_roll_joint", "waist_pitch_joint", "right_wrist_yaw_joint"):
        assert joint in line
    assert "left_knee_joint" not in line
    assert line.endswith("; choose a robot that has them, or a policy made for h1")
    assert "\n" not in line


def test_motors_are_counted_on_the_robot_that_the_policy_was_made_for(assets: Path) -> None:
    """Atom has 29 joints too: without `given: {robot: …}` its joints would be taken silently."""
    with pytest.raises(PolicyError, match="robot atom lacks 7 of the 29 joints needed: waist_"):
        load_workflow("g1_walk", {"robot": "atom", "platform": "fake"})


def test_the_robot_of_other_formats_is_information(tmp_path: Path, assets: Path) -> None:
    """Only a deploy.yaml counts motors: elsewhere the robot may be one that we do not know."""
    folder = restrict(assets / "policies/g1_velocity_mjlab", tmp_path / "legs", LEGS)
    assert load_policy(folder, given={"robot": "someone_elses"}).robot == "someone_elses"


# -- sim to real ---------------------------------------------------------------------------------


class Motors:
    """A platform with motors, as far as the workflow can tell."""

    facts = Facts(
        "motors",
        reads=("joint_pos_target", "joint_stiffness", "joint_damping"),
        writes=(*JOINT_STATES, "base_quat", "base_ang_vel", "projected_gravity", "stamp_ns"),
    )

    def __init__(self, states: States, robot: Robot) -> None:
        self.states, self.sent = states, 0
        states["joint_pos"][...] = robot.rest_joint_pos
        states["base_quat"][...] = (1.0, 0.0, 0.0, 0.0)
        states["projected_gravity"][...] = (0.0, 0.0, -1.0)

    def recv(self) -> None:
        self.states["stamp_ns"][...] += 20_000_000

    def send(self) -> None:
        self.sent += 1

    def close(self) -> None: ...


opened: list[str] = []


def motors(states: States, robot: Robot, period: float) -> Motors:
    opened.append(robot.name)
    return Motors(states, robot)


@pytest.fixture
def hardware() -> str:
    """The word of a platform with motors."""
    opened.clear()
    return f"{__name__}:motors"


def test_a_workflow_runs_on_a_platform_with_motors_by_one_word(hardware: str) -> None:
    report, workflow = run("go2_walk", {"platform": hardware, "start": "none"}, 0.2)
    assert report.platform == "motors"
    assert opened == ["go2"]
    assert workflow.platform.sent >= 10  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("robot", "missing"),
    [("aliengo", "joints.stiffness, joints.damping"), ("x2", "joint"), ("atom", "joints.default")],
)
def test_a_robot_whose_facts_are_missing_is_not_opened(
    robot: str, missing: str, hardware: str
) -> None:
    facts = load_robot(robot).missing_facts()
    assert facts
    overrides = {"robot": robot, "platform": hardware, "flow": {"damp": {"duration": 1.0}}}
    with pytest.raises(RobotError) as caught:
        load_workflow("go2_stand", overrides)
    line = str(caught.value)
    assert line.startswith(f"robot {robot} cannot be driven on platform {hardware!r}: ")
    assert f"does not say {', '.join(facts)}; " in line
    assert missing in line
    assert opened == []


def test_a_robot_whose_facts_are_missing_may_be_simulated() -> None:
    overrides = {"robot": "x2", "platform": "fake", "flow": {"damp": {"duration": 0.1}}}
    assert load_robot("x2").missing_facts()
    report, _ = run("go2_stand", overrides)
    assert report.ticks > 0
    assert not report.faults


@pytest.mark.slow
def test_joints_that_rested_may_step_with_a_policys_first_action() -> None:
    """`encoder_stop` took joints that had rested in `pose` for stuck in the tick of the step."""
    report, _ = run("go2_walk", {"platform": "fake_robot", "start.gates": False}, 5.0)
    assert report.faults == []
    assert report.ended == "duration"
