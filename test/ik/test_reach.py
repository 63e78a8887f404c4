"""Block `reach`: states in, commands of joints out; silence, entry, what is refused."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from unicon_base.errors import MissingDependencyError, RobotError, UniconError, WorkflowError
from unicon_core.memory import Memory
from unicon_core.models.find import pick_model
from unicon_core.models.frames import Frames
from unicon_core.models.load import load_model
from unicon_core.robots import Robot, load_robot
from unicon_core.states.layout import StateSpec
from unicon_core.testing import Bench
from unicon_core.workflow.autowire import BuildContext, autowire, read_options
from unicon_core.workflow.build import WarmUps
from unicon_manipulation.reach import Reach

pytest.importorskip("daqp", reason="daqp is not installed: pip install 'unicon_ros[ik]'")

HANDS = ["left_hand", "right_hand"]


class Reaching(Bench):
    """A robot at its default pose, and a block `reach`.

    Attributes:
        heard: what the block has told.
    """

    def __init__(self, robot: Robot, **options: Any) -> None:
        lag = options.pop("lag", 0.0)
        given = {"effectors": ["tool"], "moves": ["arm"]} | options
        options = read_options(Reach, given, lambda text, *_: WorkflowError(f"block 'reach'{text}"))
        specs: dict[str, StateSpec] = Reach.declares(robot=robot, **options)
        super().__init__(robot, states=specs)
        self.stand()
        self.heard: list[str] = []
        context = BuildContext(self.states, robot, self.period, tell=self.heard.append, lag=lag)
        self.reach = autowire(Reach, "reach", context, options)
        self.warm_ups = WarmUps(context)
        self.warm_ups.add(self.reach, Reach, lambda other: autowire(Reach, "reach", other, options))
        frames = Frames(
            load_model(pick_model(robot), robot, quiet=True), robot, robot.end_effectors
        )
        self.where = frames.of

    def aim(self, name: str = "tool", shift: Any = (0.0, 0.0, 0.0)) -> None:
        """Ask for where an end effector is at the default pose, shifted by some [m]."""
        pose = self.where(self.robot.default_joint_pos)[name]
        pose[:3] += shift
        self.states[f"{name}_target"] = pose

    def run(self, ticks: int) -> Any:
        """Tick, as if the joints followed at once; return the command of the last tick."""
        for _ in range(ticks):
            self.reach.tick()
            command = self.states.joint_pos_command
            np.copyto(self.states.joint_pos, command, where=~np.isnan(command))
            self.states.stamp_ns += round(1e9 * self.period)
        return self.states.joint_pos_command.copy()


@pytest.fixture
def welder(arm: Robot) -> Reaching:
    return Reaching(arm)


def test_a_target_is_reached_and_that_is_told(welder: Reaching) -> None:
    welder.aim(shift=(0.05, -0.05, 0.1))
    welder.run(60)
    states = welder.states
    assert states.tool_reachable == 1
    assert states.tool_error[0] < 1e-3
    found = welder.where(states.joint_pos_command)["tool"]
    np.testing.assert_allclose(found[:3], states.tool_target[:3], atol=1e-3)


def test_nobody_who_wants_anything_means_no_command(welder: Reaching) -> None:
    assert np.isnan(welder.run(3)).all()
    assert np.isnan(welder.states.joint_vel_command).all()
    assert np.isnan(welder.states.tool_error).all()
    welder.aim()
    assert not np.isnan(welder.run(3)).any()
    welder.states.tool_target[0] = np.nan
    assert np.isnan(welder.run(1)).all()
    assert welder.states.tool_reachable == 0
    assert welder.heard == []


def test_velocities_are_those_of_the_positions(welder: Reaching) -> None:
    welder.aim(shift=(0.1, 0.0, 0.0))
    before = welder.run(1)
    for _ in range(30):
        after = welder.run(1)
        vel = welder.states.joint_vel_command
        np.testing.assert_allclose(vel, (after - before) / welder.period, atol=2e-5)
        assert np.abs(vel).max() <= 2.0 * 1.0001
        before = after


def test_it_begins_where_a_joint_is_held_and_else_where_it_is_measured(arm: Robot) -> None:
    for stiffness, begun in ((60.0, 0.2), (0.0, 0.1)):
        it = Reaching(arm, max_rate=1.0)
        it.states.joint_stiffness[...] = stiffness
        it.states.joint_pos[...] = it.robot.default_joint_pos + 0.1
        it.states.joint_pos_target[...] = it.robot.default_joint_pos + 0.2
        it.aim(shift=(0.2, 0.2, 0.0))
        first = it.run(1) - it.robot.default_joint_pos
        assert np.abs(first - begun).max() <= 0.02 * 1.0001
        it.run(5)
        it.states.tool_target[...] = np.nan
        it.run(1)
        it.states.joint_pos_target[...] = it.robot.default_joint_pos - 0.5
        it.states.joint_pos[...] = it.robot.default_joint_pos - 0.4
        it.aim()
        again = it.run(1) - it.robot.default_joint_pos
        assert np.abs(again - (-0.5 if stiffness else -0.4)).max() <= 0.02 * 1.0001


def test_sag_does_not_wind_it_up(arm: Robot) -> None:
    """What is commanded is where it goes on from, however the joints hang behind."""
    it, free = Reaching(arm), Reaching(arm)
    for each in (it, free):
        each.aim(shift=(0.05, 0.0, 0.05))
    for _ in range(50):
        it.reach.tick()
        it.states.joint_pos[...] = it.states.joint_pos_command - 0.1
        free.run(1)
    np.testing.assert_array_equal(it.states.joint_pos_command, free.states.joint_pos_command)


def test_what_is_measured_a_tick_late_changes_nothing_of_the_arms(g1: Robot) -> None:
    """As on a workstation, whose joint positions are of the tick before."""
    late, soon = (Reaching(g1, effectors=HANDS, moves=["arms"]) for _ in range(2))
    for name in HANDS:
        for it in (late, soon):
            it.aim(name, (0.05, 0.0, 0.1))
    waiting = late.states.joint_pos.copy()
    for _ in range(40):
        soon.run(1)
        late.reach.tick()
        arms = late.states.joint_pos_command.copy()
        late.states.joint_pos[...], waiting = waiting, np.where(np.isnan(arms), waiting, arms)
    np.testing.assert_array_equal(late.states.joint_pos_command, soon.states.joint_pos_command)
    assert late.states.left_hand_reachable == late.states.right_hand_reachable == 1


def test_one_hand_alone_leaves_the_other_arm_to_itself(g1: Robot) -> None:
    it = Reaching(g1, effectors=HANDS, moves=["arms"])
    it.aim("left_hand", (0.05, 0.0, 0.1))
    command = it.run(60)
    left, right = it.robot.group(["left_arm"]), it.robot.group(["right_arm"])
    assert not np.isnan(command[left]).any()
    assert np.isnan(np.delete(command, left)).all()
    assert it.states.left_hand_reachable == 1
    it.states.joint_pos[right] += 0.2
    it.aim("right_hand", (0.05, 0.0, 0.1))
    before = np.where(it.states.joint_stiffness > 0, it.states.joint_pos_target, 0.0)
    assert np.abs(it.run(1)[right] - before[right]).max() <= 0.04 * 1.0001
    it.run(60)
    assert it.states.right_hand_reachable == 1


def test_joints_that_nobody_needs_are_not_commanded(arm: Robot) -> None:
    it = Reaching(arm, effectors={"elbow": {"orientation": 0}, "tool": {}})
    it.aim("elbow", (0.0, 0.02, 0.02))
    it.states.joint_pos_command[...] = 7.0
    command = it.run(20)
    assert not np.isnan(command[:3]).any()
    assert np.isnan(command[3:]).all()
    assert np.isnan(it.states.joint_vel_command[3:]).all()
    assert it.states.elbow_error[0] < 0.01


def test_what_is_no_position_holds_no_joint(arm: Robot) -> None:
    it = Reaching(arm)
    it.states.joint_pos_target[...] = (np.nan, np.inf, 0.0, 0.0, 0.0, -np.inf)
    it.aim()
    assert np.isfinite(it.run(1)).all()
    assert it.reach.tick.ik.failures == 0  # type: ignore[attr-defined]


def test_a_flow_that_enters_anew_begins_where_joints_are_held(welder: Reaching) -> None:
    welder.aim()
    welder.run(5)
    welder.states.joint_pos_target[...] = welder.robot.default_joint_pos - 0.5
    went_on = welder.run(1) - welder.robot.default_joint_pos
    assert np.abs(went_on).max() <= 0.04
    assert welder.reach.reset is not None
    welder.reach.reset()
    begun = welder.run(1) - welder.robot.default_joint_pos
    assert np.abs(begun + 0.5).max() <= 0.04 * 1.0001


def test_other_joints_stand_where_they_are_measured(g1: Robot) -> None:
    it = Reaching(g1, effectors=["left_hand"], moves=["left_arm"])
    waist = it.robot.joint_names.index("waist_yaw_joint")
    it.aim("left_hand", (0.05, 0.0, 0.1))
    for i in range(120):
        it.states.joint_pos[waist] = 0.2 * np.sin(0.05 * i)
        it.run(1)
    found = it.where(it.states.joint_pos)["left_hand"]
    np.testing.assert_allclose(found[:3], it.states.left_hand_target[:3], atol=3e-3)


def test_on_a_workstation_it_is_a_tick_ahead_of_what_it_is_told(g1: Robot) -> None:
    period = Reaching(g1, effectors=HANDS, moves=["arms"]).period
    late = Reaching(g1, effectors=HANDS, moves=["arms"], lag=period)
    soon = Reaching(g1, effectors=HANDS, moves=["arms"])
    waist, turn, speed = g1.joint_names.index("waist_yaw_joint"), 0.5, np.array([0.0, 0.1, 0.2])
    late.states.joint_vel[waist] = turn  # of its waist, which the robot tells a tick late
    late.states.joint_vel[g1.group(["arms"])] = 3.0  # of arms that it knows better
    for it, ticks in ((late, -1.0), (soon, 0.0)):
        it.aim("left_hand", (0.05, 0.0, 0.1))
        it.states.left_hand_target_velocity[:3] = speed
        it.states.left_hand_target[:3] += ticks * period * speed
        for i in range(30):
            it.states.joint_pos[waist] = turn * period * (i + ticks)
            it.run(1)
    arms = g1.group(["left_arm"])
    commands = [it.states.joint_pos_command[arms] for it in (late, soon)]
    np.testing.assert_allclose(*commands, atol=1e-5)


def test_joints_that_are_not_measured_are_where_they_were(g1: Robot) -> None:
    it = Reaching(g1, effectors=["left_hand"], moves=["left_arm"])
    it.aim("left_hand", (0.05, 0.0, 0.1))
    it.run(5)
    it.states.joint_pos[12] = np.nan
    for value in (np.nan, np.inf, 0.0):
        it.states.joint_pos[12] = value
        it.reach.tick()
        own = it.states.joint_pos_command[it.robot.group(["left_arm"])]
        assert np.isfinite(own).all()


def test_nothing_is_commanded_before_anything_is_measured(arm: Robot) -> None:
    it = Reaching(arm)
    it.aim()
    it.states.joint_pos[...] = np.nan
    it.reach.tick()
    assert np.isnan(it.states.joint_pos_command).all()


@pytest.mark.parametrize(
    ("pose", "told"),
    [
        (
            [0.3, 0.0, 0.2, 2.0, 0.0, 0.0, 0.0],
            "reach: tool_target has a quaternion of length 2, which counts as no target; write "
            "finite [m] and a unit quaternion, w first, or NaN for none",
        ),
        (
            [np.inf, 0.0, 0.2, 1.0, 0.0, 0.0, 0.0],
            "reach: tool_target has a position [inf, 0.0, 0.2], which counts as no target; write "
            "finite [m] and a unit quaternion, w first, or NaN for none",
        ),
    ],
)
def test_what_is_no_target_is_told_once(welder: Reaching, pose: Any, told: str) -> None:
    pose = np.array(pose, np.float32)
    welder.states.tool_target[...] = pose
    assert np.isnan(welder.run(3)).all()
    assert [line.replace("0.20000000298023224", "0.2") for line in welder.heard] == [told]
    welder.aim()
    welder.run(2)
    welder.states.tool_target[...] = pose
    welder.run(2)
    assert len(welder.heard) == 2


def test_a_quaternion_that_is_a_little_off_is_taken(welder: Reaching) -> None:
    welder.aim()
    welder.states.tool_target[3:] *= 1.01
    welder.run(5)
    assert welder.states.tool_reachable == 1


def test_position_alone_needs_no_quaternion(arm: Robot) -> None:
    it = Reaching(arm, effectors={"tool": {"orientation": 0}})
    it.aim(shift=(0.0, 0.1, 0.0))
    it.states.tool_target[3:] = np.nan
    it.run(60)
    assert it.states.tool_reachable == 1


def test_look_ahead_and_age_bring_a_target_on(arm: Robot) -> None:
    """A target that moves at 0.2 m/s is met where it will be, whether told so or by its age."""
    plain, ahead, aged = Reaching(arm), Reaching(arm, look_ahead=0.1), Reaching(arm)
    future = Reaching(arm, look_ahead=0.1)  # a clock that is ahead takes nothing back
    for it in (plain, ahead, aged, future):
        it.states.stamp_ns[...] = 10**9
        it.aim()
        it.states.tool_target_velocity[...] = (0.0, 0.2, 0.0, 0.0, 0.0, 0.3)
    aged.states.tool_target_stamp_ns[...] = 9 * 10**8
    future.states.tool_target_stamp_ns[...] = 2 * 10**9
    for it in (plain, ahead, aged, future):
        for _ in range(60):
            it.reach.tick()
    at = [it.where(it.states.joint_pos_command)["tool"] for it in (plain, ahead, aged, future)]
    np.testing.assert_allclose(at[1][:3] - at[0][:3], [0.0, 0.02, 0.0], atol=5e-4)
    np.testing.assert_allclose(at[2], at[1], atol=1e-5)
    np.testing.assert_array_equal(at[3], at[1])
    turned = 2.0 * np.arccos(np.clip(abs(at[0][3:] @ at[1][3:]), 0.0, 1.0))
    assert turned == pytest.approx(0.03, abs=2e-3)


def test_garbage_in_every_state_breaks_no_limit(g1: Robot) -> None:
    it, rng = Reaching(g1, effectors=HANDS, moves=["arms"]), np.random.default_rng(0)
    read = [*(name for name in it.reach.reads), "joint_pos", "joint_pos_target", "joint_stiffness"]
    arms, commanded = it.robot.group(["arms"]), 0
    lower, upper = it.robot.lower[arms], it.robot.upper[arms]
    for _ in range(300):
        for name in read:
            view = it.states[name]
            if rng.random() < 0.1:
                wrong = [np.nan, np.inf, -1e30, 1e30, 7.0] if view.dtype.kind == "f" else [-1, 5]
                view[...] = rng.choice(wrong)
            elif name.endswith("hand_target") and rng.random() < 0.3:
                it.aim(name.removesuffix("_target"), 0.2 * rng.normal(size=3))
            elif name.startswith("joint_pos") and rng.random() < 0.3:
                view[...] = it.robot.default_joint_pos + 0.1 * rng.normal(size=29)
        it.reach.tick()
        own = it.states.joint_pos_command[arms]
        there = ~np.isnan(own)
        commanded += bool(there.any())
        assert (own[there] >= lower[there]).all()
        assert (own[there] <= upper[there]).all()
        assert np.abs(it.states.joint_vel_command[arms][there]).max(initial=0.0) <= 2.0001
    assert commanded > 100
    assert it.reach.tick.ik.failures == 0  # type: ignore[attr-defined]


@pytest.mark.parametrize("stamp", [1, 5 * 10**9, -(10**15)])
def test_no_stamp_brings_a_target_farther_than_is_believed(arm: Robot, stamp: int) -> None:
    it = Reaching(arm)
    it.states.stamp_ns[...] = 10**9
    it.aim()
    it.states.tool_target_velocity[...] = (0.0, 0.2, 0.0, 0.0, 0.0, 0.0)
    it.states.tool_target_stamp_ns[...] = stamp
    for _ in range(60):
        it.reach.tick()
    moved = it.where(it.states.joint_pos_command)["tool"] - it.where(it.states.joint_pos)["tool"]
    assert -1e-3 <= moved[1] <= 0.2 * 0.3 + 1e-3


def test_a_velocity_that_is_not_known_is_none(arm: Robot) -> None:
    it = Reaching(arm, look_ahead=0.1)
    it.aim()
    it.states.tool_target_velocity[...] = np.nan
    it.run(30)
    assert it.states.tool_reachable == 1


def test_a_solver_without_an_answer_keeps_the_joints_still(welder: Reaching) -> None:
    welder.aim(shift=(0.1, 0.0, 0.0))
    before = welder.run(5)
    problem = welder.reach.tick.ik._quadratic  # type: ignore[attr-defined]
    solve = problem._solve
    for told in (1, 2):
        problem._solve = lambda *_: (np.full(6, np.nan), 0.0, -1, {})
        np.testing.assert_array_equal(welder.run(3), before)
        assert not welder.states.joint_vel_command.any()
        problem._solve = solve
        before = welder.run(3)
        assert (
            welder.heard
            == ["reach: the solver has no answer; the joints keep still until it has"] * told
        )
    assert welder.reach.tick.ik.failures == 6  # type: ignore[attr-defined]


def test_a_memory_goes_on_to_the_bit(arm: Robot) -> None:
    one, other = Reaching(arm), Reaching(arm)
    memories = [Memory({"reach": it.reach.tick}, it.states.buffer) for it in (one, other)]
    one.aim(shift=(0.1, 0.05, 0.0))
    one.run(10)
    kept, states = memories[0].take(), one.states.snapshot()
    assert memories[0].unproven == {}
    wanted = one.run(20)
    other.states.restore(states)
    memories[1].put_back(kept)
    assert other.run(20).tobytes() == wanted.tobytes()


def test_warm_ups_change_nothing_and_tell_nothing(welder: Reaching) -> None:
    welder.aim(shift=(0.1, 0.0, 0.0))
    welder.run(3)
    before = welder.states.snapshot()
    welder.states.tool_target[3:] = 2.0
    refresh = welder.warm_ups.refresh(None)
    assert welder.reach.warm_up is not None
    assert refresh is not None
    refresh()
    welder.reach.warm_up()
    assert welder.heard == []
    welder.states.restore(before)
    twin = Reaching(welder.robot)
    twin.aim(shift=(0.1, 0.0, 0.0))
    assert welder.run(5).tobytes() == (twin.run(3), twin.run(5))[1].tobytes()


@pytest.mark.parametrize(
    ("options", "wrong"),
    [
        (
            {"effectors": ["tol"]},
            "block 'reach': robot welder has no end effector 'tol'; did you mean 'tool'? known: "
            "elbow, tool; name one under end_effectors in {file}",
        ),
        ({"effectors": []}, "block 'reach': effectors names none; known: elbow, tool"),
        (
            {"effectors": {"tool": {"turn": 1}}},
            "block 'reach': effectors.tool: unknown key 'turn'; known: orientation, position",
        ),
        (
            {"effectors": {"tool": {"position": -1}}},
            "block 'reach': effectors.tool.position is -1; write a number from 0 to 100",
        ),
        (
            {"effectors": {"tool": {"position": 0, "orientation": 0}}},
            "block 'reach': effectors.tool is free; give it a weight above 0",
        ),
        ({"moves": ["leg"]}, "robot welder has no group or joint 'leg'; known: arm, elbow, …"),
        (
            {"max_rate": "fast"},
            "block 'reach': max_rate is 'fast'; write a number above 0 to 200 [rad/s] or robot",
        ),
        ({"max_rate": 0}, "block 'reach': max_rate is 0; write a number above 0 to 200 [rad/s]"),
        ({"apart": 2.0}, "block 'reach': apart is 2.0; write a number from 0 to 0.5 [m]"),
        ({"look_ahead": 1.0}, "block 'reach': look_ahead is 1.0; write a number from 0 to 0.3 [s]"),
        ({"posture": -1.0}, "block 'reach': posture is -1.0; write a number from 0 to 1"),
        ({"tolerance": 0}, "block 'reach': tolerance is 0; write a number above 0 to 1 [m]"),
    ],
)
def test_what_is_wrong_is_told_in_one_line(
    arm: Robot, arm_file: Path, options: Any, wrong: str
) -> None:
    with pytest.raises(UniconError) as caught:
        Reaching(arm, **options)
    said = str(caught.value)
    if wrong.endswith("…"):
        assert said.startswith(wrong[:-1])
    else:
        assert said == wrong.replace("{file}", str(arm_file))


def test_a_batch_is_refused(arm: Robot) -> None:
    specs = Reach.declares(robot=arm, effectors=["tool"])
    it = Bench(arm, 4, states=specs)
    with pytest.raises(WorkflowError) as caught:
        it.block("reach", effectors=["tool"], moves=["arm"])
    assert str(caught.value) == (
        "block 'reach': it is for one robot; leave num_robots out, or leave it out"
    )


def test_a_rate_of_the_robot_file_needs_one(arm_file: Path) -> None:
    text = arm_file.read_text().replace("velocity: 8.0", "velocity: null")
    arm_file.write_text(text.replace("unknown: []", "unknown: [joints.velocity]"))
    with pytest.raises(RobotError) as caught:
        Reaching(load_robot(arm_file), max_rate="robot")
    assert "give reach a max_rate in [rad/s]" in str(caught.value)


def test_no_joint_is_quicker_than_its_robot_file_says(arm_file: Path) -> None:
    arm_file.write_text(arm_file.read_text().replace("velocity: 8.0", "velocity: 0.5"))
    it = Reaching(load_robot(arm_file), max_rate=6.0)
    it.aim(shift=(0.3, 0.3, 0.0))
    it.run(5)
    assert np.abs(it.states.joint_vel_command).max() <= 0.5 * 1.0001


@pytest.mark.parametrize(("module", "package"), [("daqp", "ik"), ("mujoco", "sim")])
def test_a_missing_package_is_named_with_its_remedy(
    monkeypatch: pytest.MonkeyPatch, arm: Robot, module: str, package: str
) -> None:
    it = Reaching(arm)
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(MissingDependencyError) as caught:
        it.block("reach", effectors=["tool"], moves=["arm"])
    install = f"pip install 'unicon_ros[{package}]'"
    assert str(caught.value) == f"block 'reach' needs {module}: {install}"
