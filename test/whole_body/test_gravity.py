"""gravity: an arm without stiffness stays where it is put, and nothing else is carried."""

from __future__ import annotations

import numpy as np
import pytest

from unicon_base.errors import UniconError, WorkflowError
from unicon_core.check import check_workflow
from unicon_core.models.find import pick_model
from unicon_core.models.load import load_model
from unicon_core.models.loaded import import_mujoco
from unicon_core.models.posed import Weight
from unicon_core.robots import compose, load_robot
from unicon_core.runtime import Runner, RunOptions
from unicon_core.testing import Bench
from unicon_core.workflow import Program
from unicon_core.workflow.uses import block, of

pytest.importorskip("mujoco", reason="weights need mujoco")


def energy(robot, joint_pos, quat=(1.0, 0.0, 0.0, 0.0)):
    """Return the potential energy of a model in [J]."""
    mujoco = import_mujoco()
    loaded = load_model(pick_model(robot), robot, quiet=True)
    loaded.model.opt.enableflags |= int(mujoco.mjtEnableBit.mjENBL_ENERGY)
    data = mujoco.MjData(loaded.model)
    data.qpos[loaded.addresses] = joint_pos
    if loaded.base is not None:
        data.qpos[3:7] = quat
    mujoco.mj_forward(loaded.model, data)
    return float(data.energy[0])


def test_the_torques_are_the_slope_of_the_potential_energy(reacher):
    weight = Weight(load_model(pick_model(reacher), reacher, quiet=True))
    rng = np.random.default_rng(1)
    found = np.zeros(3)
    for _ in range(5):
        angles = rng.uniform(-1.5, 1.5, 3)
        weight(angles, found)
        for joint in range(3):
            step = np.eye(3)[joint] * 1e-5
            slope = (energy(reacher, angles + step) - energy(reacher, angles - step)) / 2e-5
            assert found[joint] == pytest.approx(slope, abs=1e-6)


def test_a_base_that_leans_turns_the_weight_with_it(assets):
    robot = load_robot("g1_29dof")
    weight = Weight(load_model(pick_model(robot), robot, quiet=True))
    found = np.zeros(29)
    quat = np.array((0.9, 0.2, -0.3, 0.1)) / np.linalg.norm((0.9, 0.2, -0.3, 0.1))
    arms = robot.group(["arms"])
    angles = robot.default_joint_pos.astype(float)
    angles[arms] += 0.3
    weight(angles, found, quat)
    for joint in arms[::3]:
        step = np.eye(29)[joint] * 1e-5
        slope = energy(robot, angles + step, quat) - energy(robot, angles - step, quat)
        assert found[joint] == pytest.approx(slope / 2e-5, abs=1e-5)


def lying(robot, *more):
    """Return where an arm without stiffness begins, and where it is after a second."""
    program = Program(
        robot=robot,
        platform="mujoco",
        rate=250,
        flow={"zip": [{"forward_command": {"stiffness_scale": 0.0, "damping_scale": 0.2}}, *more]},
    )
    Runner(program, RunOptions(duration=1.0, speed="max", warn=lambda _: None)).run()
    return program.robot.default_joint_pos, program.states["joint_pos"]


def test_without_stiffness_an_arm_stays_where_it_is(reacher):
    begin, fallen = lying(str(reacher.path))
    assert np.abs(fallen - begin).max() > 0.3
    begin, held = lying(str(reacher.path), "gravity")
    assert np.abs(held - begin).max() < 2e-3


def test_only_the_joints_that_are_named_are_carried_within_their_effort(reacher):
    bench = Bench(reacher)
    bench.states.joint_effort_ff = (1.0, 2.0, 2.9)
    made = bench.block("gravity", moves=["last"])
    made.tick()
    assert made.tick.torque[2] != 0.0
    assert bench.states.joint_effort_ff[:2].tolist() == [1.0, 2.0]
    bench.states.joint_effort_ff = (0.0, 0.0, -2.9)
    bench.states.joint_pos = (0.0, 0.0, 0.0)
    made.tick()  # -2.9 - 0.98 N·m: more than it can give
    assert bench.states.joint_effort_ff[2] == np.float32(-3.0)


def test_torques_that_no_other_block_rewrites_do_not_add_up(reacher):
    """As beside a policy of positions."""
    bench = Bench(reacher)
    bench.states.joint_effort_ff = (0.0, 0.5, 0.0)
    made = bench.block("gravity", moves=["last"])
    made.tick()
    once = bench.states.joint_effort_ff.copy()
    made.tick()
    assert once[2] != 0.0
    assert bench.states.joint_effort_ff.tolist() == once.tolist()
    bench.states.joint_effort_ff[2] = 0.25  # now another one does
    made.tick()
    assert bench.states.joint_effort_ff[2] == pytest.approx(0.25 + made.tick.torque[2])


def test_a_measurement_that_is_none_leaves_the_last_torque(reacher):
    bench = Bench(reacher)
    made = bench.block("gravity")
    made.tick()
    held = bench.states.joint_effort_ff.copy()
    assert np.isfinite(held).all()
    for wrong in (np.nan, np.inf, 1e38):
        bench.states.joint_pos[0] = wrong
        bench.states.joint_effort_ff = 0.0
        made.tick()
        assert np.isfinite(bench.states.joint_effort_ff).all()
    bench.states.joint_pos = 0.0


def test_hands_weigh_what_their_models_say(assets):
    robot = load_robot("g1_29dof")
    hands = {side: load_robot(f"inspire_rh56_{side}") for side in ("left", "right")}
    whole = compose({"body": robot, **{f"{s}_hand": hand for s, hand in hands.items()}})
    found = []
    for each in (robot, whole):
        torque = np.zeros(each.num_joints)
        Weight(load_model(pick_model(each), each, quiet=True))(each.default_joint_pos, torque)
        found.append(torque[robot.joint_names.index("left_elbow_joint")])
    assert abs(found[1]) > 1.3 * abs(found[0])


@pytest.mark.parametrize(
    ("moves", "message"),
    [
        (["legs"], "left_hip_pitch_joint bears a foot: what it carries depends on the ground"),
        (["legs"], "name others in moves, such as waist or arms"),
        (["left_hand"], "takes positions alone: its vendor closes the loop"),
        (["wings"], "no group or joint 'wings'"),
    ],
)
def test_what_cannot_be_carried_is_refused(moves, message, assets):
    with pytest.raises(UniconError) as told:
        Program(
            robot={"body": "g1_29dof", "left_hand": "inspire_rh56_left"},
            platform="mujoco",
            rate=50,
            flow={"zip": ["hold", {"gravity": {"moves": moves}}]},
        )
    assert message in str(told.value)


def test_a_batch_and_a_carried_member_are_refused(assets, reacher):
    with pytest.raises(WorkflowError, match="is for one robot; leave num_robots out"):
        Bench(reacher, 3).block("gravity")
    hand = of("left_hand", block("gravity"))
    with pytest.raises(WorkflowError, match="how the member is turned is not known here"):
        Program(
            robot={"body": "g1_29dof", "left_hand": "inspire_rh56_left"},
            platform="mujoco",
            rate=50,
            flow={"zip": ["hold", hand]},
        )


def test_what_a_walker_carries_has_to_be_said(assets, reacher):
    with pytest.raises(WorkflowError, match=r"name the joints that others move: moves: \[arms\]"):
        Bench("g1_29dof").block("gravity")
    with pytest.raises(WorkflowError, match="every joint of inspire_rh56_left takes positions"):
        Bench("inspire_rh56_left").block("gravity")
    assert Bench(reacher).block("gravity").tick.moves == ("yaw", "lift", "elbow")


WITHOUT_TORQUES = """
from dataclasses import replace
from unicon_core.platforms.fake import FakeRobot
from unicon_core.platforms.kit.scene import Scene


class Positions(FakeRobot):
    facts = replace(FakeRobot.facts, name="positions", reads=("joint_pos_target",))


def make(states, robot, period, scene: Scene) -> Positions:
    return Positions(states, robot, period, scene, 0.0)
"""


def test_a_platform_that_takes_no_torques_is_a_finding(reacher, monkeypatch):
    folder = reacher.path.parent
    (folder / "positions_alone.py").write_text(WITHOUT_TORQUES)
    monkeypatch.syspath_prepend(str(folder))
    path = folder / "carried.yaml"
    path.write_text(
        "schema: unicon.workflow/1\nname: carried\ndescription: An arm.\nrobot: reacher.yaml\n"
        'platform: "positions_alone:make"\nrate: 50\nflow: {zip: [hold, gravity]}\n'
        "safety: [finite, joint_limits]\n"
    )
    found = [str(finding) for finding in check_workflow(path).findings]
    (line,) = [line for line in found if "action.unsent" in line]
    assert "block 'gravity'" in line
    assert "does not send joint_effort_ff" in line
