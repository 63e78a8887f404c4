"""A robot made of members: one robot, one set of states, a platform for each."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from member_robots import LOG

from unicon_base.errors import Fault, RobotError, UniconError, WorkflowError
from unicon_core.gates.gate import Variant
from unicon_core.platforms.joined import JoinedPlatform
from unicon_core.robots import compose, load_files, load_robot, robot_files
from unicon_core.runtime import Runner, RunOptions
from unicon_core.states.standard import COMMAND_STATES, JOINT_STATES
from unicon_core.testing import Bench
from unicon_core.workflow import Program

MADE = "member_robots:make"
QUICK = RunOptions(speed="max")
MEMBERS = ("body", "left_hand", "left_hand")


@pytest.fixture(autouse=True)
def fresh() -> None:
    LOG.clear()


def go2_with(hand: str = "inspire_rh56_left", **more: str) -> Any:
    return compose(
        {"body": load_robot("go2"), "left_hand": load_robot(hand)}
        | {name: load_robot(robot) for name, robot in more.items()}
    )


# -- the robot -----------------------------------------------------------------------------------


def test_joints_stand_member_by_member_and_the_first_has_the_base() -> None:
    go2, hand = load_robot("go2"), load_robot("inspire_rh56_left")
    whole = go2_with()
    assert whole.joint_names == go2.joint_names + hand.joint_names
    assert whole.joints_of("left_hand") == slice(12, 18)
    assert whole.imu is not None
    assert whole.imu.frame == "imu_link"
    assert whole.walks
    assert whole.feet == go2.feet
    assert whole.file_of("L_index_proximal_joint") == hand.path
    np.testing.assert_array_equal(whole.joint_stiffness[12:], 1.0)  # "on": it has no gains
    np.testing.assert_array_equal(whole.by_position, [False] * 12 + [True] * 6)
    assert whole.missing_facts() == []
    again = load_files(robot_files(whole))
    assert again.joint_names == whole.joint_names
    assert again.name == whole.name


def test_a_name_of_two_members_is_told_apart_and_the_base_keeps_its_own() -> None:
    whole = go2_with("rohand", right_hand="rohand", spare="go2")
    assert whole.joint_names[:12] == load_robot("go2").joint_names
    assert whole.joint_names[12] == "left_hand_th_proximal_link"
    assert whole.joint_names[18] == "right_hand_th_proximal_link"
    assert whole.joint_names[24] == "spare_FR_hip_joint"
    assert whole.missing_facts() == []


def test_two_joints_of_one_name_are_refused() -> None:
    go2, hand = load_robot("go2"), load_robot("rohand")
    odd = replace(go2, joint_names=("left_hand_th_root_link", *go2.joint_names[1:]))
    with pytest.raises(RobotError, match="two joints are called"):
        compose({"body": odd, "left_hand": hand, "right_hand": hand})


# -- platforms -----------------------------------------------------------------------------------


def test_each_platform_writes_its_slice_and_its_own_stamp(go2_with_hands: dict[str, Any]) -> None:
    del go2_with_hands["robot"]["right_hand"]
    hold = {"chain": [{"pose": {"to": {"L_index_proximal_joint": 1.0}, "duration": 0.2}}]}
    program = Program(**go2_with_hands, flow=hold)
    assert isinstance(program.platform, JoinedPlatform)
    own = program.platform.members["left_hand"]
    report = Runner(program, QUICK).run()
    assert not report.faults
    assert report.ended == "done"
    states = program.states
    index = program.robot.joint_names.index("L_index_proximal_joint")
    assert states["joint_pos_target"][index] == 1.0
    assert states["joint_pos"][index] > 0.9
    assert int(states["stamp_ns"]) == int(states["body_stamp_ns"]) > 0
    assert int(states["left_hand_stamp_ns"]) > 0
    assert own.facts.simulated
    assert program.platform.facts.simulated
    assert program.platform.facts.name == "fake"
    assert program.platform.facts.reads == COMMAND_STATES
    assert {*JOINT_STATES, "base_quat"} <= {*program.platform.facts.writes}
    assert "base_quat" not in own.facts.writes


def test_a_policy_of_the_body_gets_the_bits_of_the_body_alone() -> None:
    """The same observations, the same targets, whatever hands there are."""
    pytest.importorskip("mujoco")
    pytest.importorskip("onnxruntime")
    targets: list[list[bytes]] = []
    watched: list[Any] = []

    def note(seen: list[bytes]) -> None:
        seen.append(watched[0].tobytes())

    for hands in (False, True):
        seen: list[bytes] = []
        flow: Any = {"policy": "walk"}
        robot: Any = "go2"
        platform: Any = "mujoco"
        if hands:
            robot = {"body": "go2", "left_hand": "inspire_rh56_left"}
            platform = {"body": "mujoco", "left_hand": "fake"}
            flow = {"zip": [{**flow, "of": "body"}, {"hold": None, "of": "left_hand"}]}

        program = Program(
            robot=robot,
            platform=platform,
            policies={"walk": "go2_velocity"},
            flow=flow,
            commands=[{"velocity_command": {"constant": [0.5, 0.0, 0.0]}}],
            deferred=[partial(note, seen)],
        )
        watched[:] = [program.states["joint_pos_target"][:12]]
        report = Runner(program, RunOptions(speed="max", duration=1.0)).run()
        assert not report.faults
        targets.append(seen)
    assert len(targets[0]) == 50
    assert targets[0] == targets[1]


def test_a_policy_without_a_member_holds_the_hands() -> None:
    pytest.importorskip("onnxruntime")
    program = Program(
        robot={"body": "go2", "left_hand": "inspire_rh56_left"},
        platform={"body": "fake", "left_hand": "fake"},
        policies={"walk": "go2_velocity"},
        flow={"policy": "walk"},
    )
    Runner(program, RunOptions(speed="max", duration=0.1)).run()
    hand = program.robot.members["left_hand"]
    np.testing.assert_array_equal(program.states["joint_pos_target"][12:], hand.default_joint_pos)
    np.testing.assert_array_equal(program.states["joint_stiffness"][12:], 1.0)


# -- one writer for each joint ---------------------------------------------------------------------


@pytest.mark.parametrize(
    ("flow", "told"),
    [
        (
            [{"hold": None}, {"hold": None, "of": "left_hand"}],
            "block 'hold of left_hand' writes 'joint_damping of left_hand' in the same tick as "
            "'hold'; a joint has one writer: give 'hold' other joints, of: body",
        ),
        (
            [{word: None, "of": m} for word, m in zip(("hold", "hold", "damp"), MEMBERS)],
            "block 'damp of left_hand' writes 'joint_damping of left_hand' in the same tick as "
            "'hold of left_hand'",
        ),
        (
            [{"hold": None, "of": "left_hand"}],
            "reads 'joint_pos_target of body', which no block writes",
        ),
        (
            [{"hold": None, "of": "left_leg"}],
            "the robot has no member 'left_leg'; known: body, left_hand",
        ),
        ([{"hold": None, "of": 3}], "of: 3 is not a member; write of: NAME"),
    ],
)
def test_a_joint_has_one_writer(flow: list[Any], told: str) -> None:
    with pytest.raises(WorkflowError) as raised:
        Program(
            robot={"body": "go2", "left_hand": "inspire_rh56_left"},
            platform={"body": "fake", "left_hand": "fake"},
            rate=50,
            flow={"zip": flow},
        )
    assert told in str(raised.value)


def test_one_word_moves_a_workflow_of_members_to_one_platform(
    go2_with_hands: dict[str, Any],
) -> None:
    """Options of members stay where they are, unread."""
    options = {"left_hand": {"address": "192.168.11.210"}, "fake": {"time_constant": 0.1}}
    whole = go2_with_hands | {"platform": "fake", "platforms": options}
    program = Program(**whole, flow="hold")
    assert not isinstance(program.platform, JoinedPlatform)
    assert "body_stamp_ns" not in program.states
    program.close()


def test_members_divide_the_joints_among_blocks() -> None:
    program = Program(
        robot={"body": "go2", "left_hand": "inspire_rh56_left"},
        platform={"body": "fake", "left_hand": "fake"},
        rate=50,
        flow={
            "chain": [
                {"pose": {"to": "stand", "duration": 0.1}},
                {
                    "zip": [
                        {"hold": {"duration": 0.2}, "of": "body"},
                        {"pose": {"to": {"L_*": 0.5}, "duration": 0.1}, "of": "left_hand"},
                    ]
                },
            ]
        },
    )
    assert not Runner(program, QUICK).run().faults
    np.testing.assert_array_equal(program.states["joint_pos_target"][12:], 0.5)
    np.testing.assert_array_equal(
        program.states["joint_pos_target"][:12], load_robot("go2").default_joint_pos
    )


def test_a_scene_is_of_the_whole(go2_with_hands: dict[str, Any]) -> None:
    pytest.importorskip("mujoco")
    go2_with_hands["platform"] = {"body": "mujoco", "hands": "fake"}
    pose = {"*_calf_joint": -1.0, "L_index_proximal_joint": 0.7}
    scene: dict[str, Any] = {
        "initial_pose": pose,
        "joints": {"RL_*": {"strength": 0.5}},
        "noise": {"joint_pos": 0.001},
        "push": {"every": 0.2, "velocity": 0.5},
        "delay": 1,
    }
    program = Program(**go2_with_hands, scene=scene, flow={"hold": {"duration": 0.5}})
    program.platform.recv()
    index = program.robot.joint_names.index("L_index_proximal_joint")
    assert program.states["joint_pos"][index] == pytest.approx(0.7, abs=0.01)
    assert program.states["joint_pos"][2] == pytest.approx(-1.0, abs=0.01)
    assert not Runner(program, QUICK).run().faults
    assert np.abs(program.states["base_lin_vel"][:2]).max() > 0.01
    scene["joints"] = {"L_*": {"strength": 0.5}}
    with pytest.raises(WorkflowError, match="platform 'fake' of left_hand simulates no strength"):
        Program(**go2_with_hands, scene=scene, flow="hold")


# -- robots ----------------------------------------------------------------------------------------


def robots(body: dict[str, Any], hand: dict[str, Any], **more: Any) -> Program:
    values: dict[str, Any] = {
        "robot": {"body": "go2", "left_hand": "inspire_rh56_left"},
        "platform": {"body": MADE, "left_hand": MADE},
        "platforms": {"body": body, "left_hand": hand},
        "start": {"operator": False, "fade_in": 0.1},
        "rate": 100,
        "duration": 0.3,
        "flow": "hold",
    }
    return Program(**values | more)


def of(robot: str) -> list[str]:
    return [what for name, what in LOG if name == robot]


@pytest.mark.usefixtures("time_passes")
def test_two_robots_run_behind_their_gates_and_the_hands_get_ready_first() -> None:
    program = robots({"steps": 2}, {"steps": 3})
    assert not program.platform.facts.simulated
    variants = [gate for gate in program.gates if isinstance(gate, Variant)]
    assert len(variants) == 2
    report = Runner(program, RunOptions(speed="real")).run()
    assert not report.faults
    ready = [name for name, what in LOG if what == "prepared"]
    assert ready == ["inspire_rh56_left"] * 4 + ["go2"] * 3
    for name in ("go2", "inspire_rh56_left"):
        assert of(name)[-2:] == ["limp", "closed"]
        assert "command" in of(name)
    assert program.platform.commanders() == {  # type: ignore[attr-defined]
        "topic of go2": 0,
        "topic of inspire_rh56_left": 0,
    }


@pytest.mark.usefixtures("time_passes")
@pytest.mark.parametrize(
    ("where", "faulty"),
    [pytest.param("recv", "body", marks=pytest.mark.slow), ("send", "left_hand")],
)
def test_a_fault_of_one_damps_all(where: str, faulty: str) -> None:
    wrong = {"wrong": where, "after": 80}
    program = robots(*((wrong, {}) if faulty == "body" else ({}, wrong)))
    report = Runner(program, RunOptions(speed="real")).run()
    assert report.faults
    assert f"{faulty}: {where} of" in report.faults[0]
    for name in ("go2", "inspire_rh56_left"):
        assert of(name)[-2:] == ["limp", "closed"]


def test_a_member_in_a_process_of_its_own_is_prepared_there() -> None:
    program = robots(
        {},
        {"steps": 1, "others": 1},
        platform={"body": MADE, "left_hand": {"child": MADE, "silence": 5.0, "watchdog": 5.0}},
    )
    platform: Any = program.platform
    told = [platform.prepare() for _ in range(2)]
    assert told == ["left_hand: 1 steps left", ""]
    assert platform.commanders()["topic of inspire_rh56_left"] == 1
    program.close()


def test_all_are_closed_though_one_raises() -> None:
    program = robots({"wrong": "close"}, {})
    with pytest.raises(Fault, match="close of go2 failed"):
        program.close()
    assert LOG == [("go2", "closed"), ("inspire_rh56_left", "closed")]
    program.close()
    assert len(LOG) == 2


def test_what_was_opened_is_closed_where_the_next_cannot_be_built() -> None:
    with pytest.raises(UniconError, match="left_hand: build of inspire_rh56_left failed"):
        robots({}, {"wrong": "build"})
    assert LOG == [("go2", "closed")]


@pytest.mark.slow
def test_a_simulated_body_with_a_real_hand_counts_as_a_robot() -> None:
    program = robots({}, {}, platform={"body": "fake", "left_hand": MADE}, platforms={})
    assert not program.platform.facts.simulated
    assert program.gates
    report = Runner(program, RunOptions(speed="real")).run()
    assert not report.faults
    # Its time is the machine's, not that of the simulation.
    assert int(program.states["stamp_ns"]) > int(program.states["body_stamp_ns"]) + 10**9
    assert of("inspire_rh56_left")[-2:] == ["limp", "closed"]


def test_a_mix_cannot_be_silent() -> None:
    values: dict[str, Any] = {
        "robot": {"body": "go2", "left_hand": "inspire_rh56_left"},
        "platform": {"body": "fake", "left_hand": MADE},
        "rate": 50,
        "flow": "hold",
    }
    with pytest.raises(WorkflowError, match="body is simulated and others are not"):
        Program(**values, silent=True)
    assert LOG == []
    Program(**values, dry=True).close()


def test_what_a_member_does_not_tell_is_zero_and_the_check_says_so() -> None:
    from unicon_core.platforms.joined import joined_facts
    from unicon_core.platforms.platform import Facts

    facts = joined_facts(
        {"body": Facts("a", writes=JOINT_STATES), "left_hand": Facts("b", writes=("joint_pos",))}
    )
    assert facts.notes == (
        "left_hand does not tell joint_vel: it is 0 there",
        "left_hand does not tell joint_effort: it is 0 there",
    )


def test_a_safety_block_of_one_member_is_no_safety_of_the_others() -> None:
    program = robots(
        {}, {}, safety=[{"finite": None, "of": "body"}, {"joint_limits": 0.01, "of": "body"}]
    )
    assert program.safety[0] == "finite"
    assert "joint_limits" in program.safety
    program.close()
    both = [{"joint_limits": 0.01, "of": member} for member in MEMBERS[:2]]
    program = robots({}, {}, safety=["finite", *both])
    assert "joint_limits" not in program.safety
    program.close()


def test_a_body_keeps_its_stops_though_its_hands_say_no_limits() -> None:
    program = robots({}, {})
    assert program.safety_left_out.keys() <= {"hardware_stop"}
    program.close()
    bench = Bench(go2_with(), period=0.01)
    block = bench.block("velocity_stop")
    bench.states["joint_vel"][12:] = 30.0
    block.tick()
    bench.states["joint_vel"][3] = 1.6 * bench.robot.velocity_limit[3]
    with pytest.raises(Fault, match=bench.robot.joint_names[3]):
        block.tick()
    with pytest.raises(RobotError, match="does not say the velocity limit"):
        Bench("inspire_rh56_left").block("velocity_stop")
    with pytest.raises(RobotError, match="give rate_limit a max_rate"):
        bench.block("rate_limit")


def test_fingers_may_stop_at_what_they_grip() -> None:
    bench = Bench(go2_with(), period=0.01)
    block = bench.block("encoder_stop")
    bench.stand()
    for tick in range(50):
        bench.states["joint_pos"][:12] += 0.001  # the legs tell of motion, the fingers do not
        bench.states["joint_pos_target"][12:] = 0.02 * tick
        block.tick()
    bench.states["joint_pos_target"][0] += 0.2
    with pytest.raises(Fault, match="FR_hip_joint is stuck"):
        assert bench.ticks(block, 50)


# -- records ---------------------------------------------------------------------------------------


def test_a_recorded_run_replays_to_the_bit(tmp_path: Path, capsys: Any) -> None:
    from unicon_ros.cli.main import main

    path = tmp_path / "hands.yaml"
    path.write_text(
        "robot: {body: go2, left_hand: inspire_rh56_left}\n"
        "platform: {body: fake, left_hand: fake}\n"
        "rate: 50\n"
        "flow: {chain: [{pose: {to: rest, duration: 0.3}}, {hold: {duration: 0.2}}]}\n"
    )
    bag = str(tmp_path / "bag")
    arguments = ["run", str(path), "--no-ros", "--speed", "max", "--record", bag]
    assert main(arguments) == 0
    assert main(["replay", bag, "--verify"]) == 0
    assert main(["check", str(path)]) == 0
    assert main(["show", str(path)]) == 0
    told = capsys.readouterr().out
    assert "robot left_hand" in told
    assert "left_hand_stamp_ns" in told
