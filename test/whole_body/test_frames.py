"""frames: poses of end effectors and bodies, held against a chain of matrices."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference_frames import matrix, pose

from unicon_base.errors import ModelError, UniconError, WorkflowError
from unicon_core.models.find import pick_model
from unicon_core.models.frames import Frames
from unicon_core.models.load import load_model
from unicon_core.robots import load_robot
from unicon_core.robots.robot import Place
from unicon_core.runtime import Runner, RunOptions
from unicon_core.states.standard import pose_states
from unicon_core.testing import Bench
from unicon_core.workflow import Program
from unicon_core.workflow.uses import block, of

pytest.importorskip("mujoco", reason="kinematics need mujoco")

GO2 = load_robot("go2")
GO2_MODEL = load_model(pick_model(GO2), GO2, quiet=True)
TOE = Place("RL_calf", (0.01, -0.02, -0.2), (0.5, 0.5, -0.5, 0.5))


def of_reacher(robot, **options):
    names = options["of"] if isinstance(options.get("of"), dict) else robot.end_effectors
    specs: dict[str, Any] = {}
    for name in names:
        specs |= pose_states(name, options.get("frame", "base"))
    bench = Bench(robot, states=specs)
    return bench, bench.block("frames", **options)


@settings(max_examples=60)
@given(st.lists(st.floats(-3.0, 3.0), min_size=12, max_size=12))
def test_a_pose_is_that_of_a_chain_of_matrices(joint_pos):
    found = Frames(GO2_MODEL, GO2, {"toe": TOE}).of(joint_pos)["toe"]
    at, turn = pose(GO2_MODEL, joint_pos, TOE, "base_link")
    np.testing.assert_allclose(found[:3], at, atol=1e-12)
    np.testing.assert_allclose(matrix(found[3:]), turn, atol=1e-12)


def test_of_a_fixed_base_it_is_told_in_the_bases_frame(reacher):
    bench, made = of_reacher(reacher)
    bench.states.joint_pos = angles = np.array((0.4, -0.7, 1.2), np.float32)
    made.tick()
    loaded = load_model(pick_model(reacher), reacher, quiet=True)
    at, turn = pose(loaded, angles, reacher.end_effectors["tool"], "plate")
    np.testing.assert_allclose(bench.states.tool_pose[:3], at, atol=1e-6)
    np.testing.assert_allclose(matrix(bench.states.tool_pose[3:]), turn, atol=1e-6)
    bench, made = of_reacher(reacher, frame="world")
    bench.states.joint_pos = angles
    made.tick()
    world, _ = pose(loaded, angles, reacher.end_effectors["tool"], "world")
    np.testing.assert_allclose(bench.states.tool_pose[:3], world, atol=1e-6)
    assert bench.states.layout.specs["tool_pose"].frame == "world"


def test_in_the_world_a_base_that_floats_is_where_it_is_said_to_be():
    specs = pose_states("toe", "world")
    bench = Bench("go2", states=specs)
    made = bench.block("frames", of={"toe": "RL_calf"}, frame="world")
    assert {"base_pos_w", "base_quat"} <= {*made.reads}
    bench.stand()
    bench.states.base_pos_w = (1.0, 2.0, 3.0)
    bench.states.base_quat = (0.0, 0.0, 0.0, 1.0)  # half a turn to the left
    made.tick()
    at, _ = pose(GO2_MODEL, GO2.default_joint_pos, Place("RL_calf"), "base_link")
    expected = np.array((1.0 - at[0], 2.0 - at[1], 3.0 + at[2]))
    np.testing.assert_allclose(bench.states.toe_pose[:3], expected, atol=1e-5)


def test_the_quaternion_does_not_jump_in_sign(reacher):
    bench, made = of_reacher(reacher)
    before = np.zeros(7)
    for turn in np.linspace(-3.0, 3.0, 200):
        bench.states.joint_pos = (turn, 2.0 * np.sin(turn), 2.5 * np.cos(turn))
        made.tick()
        now = bench.states.tool_pose.astype(float)
        assert now[3:] @ before[3:] >= 0.0
        assert np.linalg.norm(now[3:]) == pytest.approx(1.0, abs=1e-6)
        before = now


def test_nan_of_an_encoder_is_not_known_and_gone_with_it(reacher):
    bench, made = of_reacher(reacher)
    assert np.isnan(bench.states.tool_pose).all()  # nobody knows yet
    made.tick()
    good = bench.states.tool_pose.copy()
    for wrong in (np.nan, np.inf):
        bench.states.joint_pos[1] = wrong
        made.tick()
        assert np.isnan(bench.states.tool_pose[:3]).any()
        bench.states.joint_pos[1] = 0.0
        made.tick()
        assert bench.states.tool_pose.tolist() == good.tolist()


def test_a_hands_own_frames_are_of_its_own_model(assets):
    program = Program(
        robot={"body": "g1_29dof", "left_hand": "inspire_rh56_left"},
        platform="mujoco",
        rate=50,
        estimate=[
            of("left_hand", block("frames", of={"tip": "L_index_intermediate"})),
            block("frames"),
        ],
        flow=block("hold"),
    )
    Runner(program, RunOptions(duration=0.04, speed="max")).run()
    hand = program.robot.members["left_hand"]
    own = program.states["joint_pos"][29:]
    loaded = load_model(pick_model(hand), hand, quiet=True)
    tip = Frames(loaded, hand, {"tip": Place("L_index_intermediate")}).of(own)["tip"]
    np.testing.assert_allclose(program.states["tip_pose"], tip, atol=1e-6)
    assert 0.05 < np.linalg.norm(tip[:3]) < 0.3
    assert program.states["left_hand_pose"][0] > 0.1
    assert len(program.context.models) == 2


@pytest.mark.parametrize("name", ["g1_29dof", "g1_23dof", "h1", "h1_2", "t1", "adam_lite"])
def test_hands_of_a_humanoid_are_on_both_sides_with_x_along_the_fingers(name, assets):
    robot = load_robot(name)
    loaded = load_model(pick_model(robot), robot, quiet=True)
    elbows = {
        side: Place(loaded.model.body(model_elbow(loaded.model, side)).name)
        for side in ("left", "right")
    }
    found = Frames(loaded, robot, {**robot.end_effectors, **elbows}).of(robot.default_joint_pos)
    left = found["left_hand"]
    right = found["right_hand"]
    np.testing.assert_allclose(left[:3] * (1, -1, 1), right[:3], atol=0.012)
    assert left[1] > 0.05
    for side, hand in (("left", left), ("right", right)):
        forearm = hand[:3] - found[side][:3]
        assert 0.15 < np.linalg.norm(forearm) < 0.45
        assert matrix(hand[3:])[:, 0] @ forearm > 0.9 * np.linalg.norm(forearm)


def model_elbow(model, side):
    """Return the body that turns at the elbow."""
    for joint in range(model.njnt):
        name = model.joint(joint).name.lower()
        if "elbow" in name and side in name and "yaw" not in name:
            return int(model.jnt_bodyid[joint])
    raise AssertionError(side)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"of": ["tol"]}, "no end effector 'tol'; did you mean 'tool'"),
        ({"of": [{}]}, "of.0 is {}; write a text"),
        ({"of": 3}, "of is 3; write a list, each a text or a mapping of a text to a text"),
        ({"robot": "go2"}, "block 'frames' has no option 'robot'; known: frame, of"),
        ({"of": {"tip": "forarm"}}, "end effector 'tip': no body 'forarm'"),
        ({"of": {"a tip": "forearm"}}, "'a tip' is not an identifier"),
        ({"frame": "map"}, "frame 'map' is not known; known: base, world"),
    ],
)
def test_a_wrong_option_is_told_with_what_there_is(reacher, options, message):
    with pytest.raises(UniconError) as told:
        Program(
            robot=str(reacher.path),
            platform="fake",
            rate=50,
            estimate=[block("frames", **options)],
            flow=block("hold"),
        )
    assert message in str(told.value)


def test_a_batch_or_a_robot_without_end_effectors_is_refused(reacher):
    batch = Bench(reacher, 3, states=pose_states("tool"))
    with pytest.raises(WorkflowError, match="is for one robot; leave num_robots out"):
        batch.block("frames")
    bare = replace(reacher, end_effectors={})
    with pytest.raises(WorkflowError, match=r"names no end effectors; give of: \{NAME: BODY\}"):
        Bench(bare).block("frames")
    with pytest.raises(ModelError, match="names no model"):
        Bench(replace(reacher, models={}), states=pose_states("tool")).block("frames")
