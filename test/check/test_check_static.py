"""Every static check against one deliberately wrong input; the message names culprit and remedy."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

pytest.importorskip("mujoco", reason="the checks are run on a model")
pytest.importorskip("onnxruntime", reason="the policies need onnxruntime")
pytest.importorskip("onnx", reason="the test networks are written with onnx")

from check_helpers import (
    JOINTS,
    NULL,
    ROOT,
    STAND,
    check,
    codes,
    note_of,
    section,
    text_of,
    write_workflow,
)

from unicon_base.errors import CheckError, RobotError
from unicon_core.check import CODES, check_workflow, refuse_errors
from unicon_core.check.rules import LIVE
from unicon_core.robots import load_robot, robot_names
from unicon_core.workflow import load_workflow
from unicon_core.workflow.document import workflow_names
from unicon_ros.cli.main import main


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "toy"


def test_a_good_workflow_is_clean(folder: Path) -> None:
    result = check(folder)
    assert result.clean, result.text()
    assert result.text().endswith("clean")
    titles = [s.title.split(" of ")[0].split(" [")[0] for s in result.sections]
    for title in (
        "Joints",
        "Gains",
        "Limits",
        "Observation",
        "Action",
        "Timing",
        "Default pose",
        "Feet in the default pose",
        "Conventions",
        "Files",
        "Blocks",
    ):
        assert title in titles


@pytest.mark.parametrize("name", workflow_names())
def test_every_workflow_of_ours_is_clean(
    name: str, assets: Path, at_hand: Callable[[str], None]
) -> None:
    at_hand(name)
    result = check_workflow(name)
    assert result.clean, result.text()


def test_blocks_that_are_fused_run_before_send(folder: Path) -> None:
    rows = {row[0]: row[2] for row in section(check(folder), "Blocks")}
    (name,) = (name for name in rows if "joint_limits" in name)
    assert rows[name] == "before send"


def test_terms_of_whole_frames_are_shown_in_their_frame(folder: Path) -> None:
    changes: dict[str, Any] = {"observation.layout": "frame_major", "observation.newest": "last"}
    changes |= {f"observation.terms.{i}.history": 3 for i in range(6)}
    result = check(folder, {**changes, "observation.start": "first"}, inputs=135)
    rows = {row[0]: row[2] for row in section(result, "Observation")}
    assert rows["ang_vel"] == "frame[0:3]"
    assert rows["last_action"] == "frame[33:45]"


def test_a_robot_whose_driver_lacks_facts_is_found(folder: Path) -> None:
    values = {"robot": "n1", "platform": "fourier", "rate": 50, "flow": {"hold": {}}}
    path = folder / "n1.yaml"
    folder.mkdir()
    path.write_text(yaml.safe_dump({**values, "safety": ["finite", "joint_limits"]}), "utf-8")
    line = text_of(check_workflow(path), "robot.facts")
    for key in ("stiffness_scale", "damping_scale", "timeout_mode"):
        assert f"transport.{key}" in line
    with pytest.raises(RobotError, match=r"transport\.timeout_mode"):
        load_workflow(path)


def test_joints_are_listed_in_every_order(folder: Path) -> None:
    rows = section(check(folder), "Joints")
    by_joint = {row[1]: row for row in rows}
    assert rows[0][1] == "FR_hip_joint"  # the vendor's order
    assert by_joint["FL_hip_joint"][2] == "0"  # the policy's
    assert "FL_hip_joint" in by_joint["FL_hip_joint"][3]  # the model's


def test_joints_that_no_policy_moves_are_told(folder: Path) -> None:
    result = check(folder, {"action.joints": list(JOINTS[:9])}, inputs=42)
    # 12 positions, 12 velocities, 9 actions; but the network has 12 outputs
    assert codes(result) == ["build"]
    assert (
        "joints has 9 names, the network's output 'actions' 12 values"
        in result.findings[0].evidence
    )


def test_the_action_of_fewer_joints_holds_the_rest(folder: Path) -> None:
    path = write_workflow(folder, {"action.joints": list(JOINTS[:9])}, inputs=42)
    from check_helpers import write_network

    write_network(folder / "policy" / "policy.onnx", 42, 9)
    result = check_workflow(path)
    assert result.clean, result.text()
    assert "RR_hip_joint, RR_thigh_joint, RR_calf_joint" in note_of(result, "joints.held")


def test_gains_of_one_side_only_are_found(folder: Path) -> None:
    gains = [40.0] * 12
    gains[1] = 60.0
    line = text_of(check(folder, {"stiffness": gains}), "gains.symmetry")
    assert line.startswith(
        "policy 'walk', stiffness: FL_thigh_joint has 60 and FR_thigh_joint has 40; "
        "bring stiffness into the order of joints"
    )


def test_swapped_gains_are_found(folder: Path) -> None:
    result = check(folder, {"stiffness": [1.0] * 12, "damping": [40.0] * 12})
    line = text_of(result, "gains.swapped")
    assert "damping is greater than stiffness at 12 of 12 joints" in line
    assert "exchange stiffness and damping" in line


FIELDS = ("stiffness", "damping")


@pytest.mark.parametrize("platform", ["mujoco", "hardware"])
@pytest.mark.parametrize(
    ("times", "said"),
    [
        ((600.0, 50.0), "600 N·m/rad and 50 N·m·s/rad reach its effort limit of 23.7 N·m within"),
        ((600.0, 5.0), "within 0.04 rad or 4.7 rad/s"),
        ((60.0, 50.0), "within 0.4 rad or 0.47 rad/s"),
    ],
)
def test_gains_of_a_robot_file_ten_times_too_high_are_refused_by_check_and_run(
    folder: Path, hardware: str, platform: str, times: tuple[float, float], said: str
) -> None:
    joints = {f"joints.{i}.{key}": v for i in range(12) for key, v in zip(FIELDS, times)}
    name = hardware if platform == "hardware" else platform
    path = write_workflow(folder, None, {"platform": name, "flow": {"hold": {}}}, joints)
    line = text_of(check_workflow(path), "gains.stiff")
    assert line.startswith("robot go2, gains: FR_")
    assert said in line
    assert "rad/s (a tick is 0.02 s) with damping ratio" in line
    if platform == "mujoco":
        with pytest.raises(CheckError, match="is not run"):
            refuse_errors(load_workflow(path))


def test_one_joint_that_swings_faster_than_the_ticks_is_found(folder: Path) -> None:
    path = write_workflow(folder, None, {"flow": {"hold": {}}}, {"joints.4.stiffness": 600.0})
    line = text_of(check_workflow(path), "gains.stiff")
    assert "FL_thigh_joint: 600 N·m/rad" in line
    assert "rad/s (a tick is 0.02 s) with damping ratio" in line


def test_gains_of_a_block_that_are_too_high_are_found(folder: Path) -> None:
    flow = {"forward_command": {"stiffness": 600.0, "damping": 50.0}}
    changes = {"flow": flow, "scene": None, "rate": 50, "commands": None, "policies": None}
    line = text_of(check(folder, None, changes), "gains.stiff")
    assert line.startswith("block 'forward_command', gains: ")


@pytest.mark.parametrize("name", robot_names())
def test_no_gains_of_a_shipped_robot_are_too_high(name: str, folder: Path, assets: Path) -> None:
    values = {"robot": name, "platform": "fake", "rate": 50, "flow": {"hold": {}}}
    folder.mkdir()
    path = folder / "held.yaml"
    path.write_text(yaml.safe_dump(values), "utf-8")
    lacking = [fact for fact in load_robot(name).unknown if fact == "joints.stiffness"]
    assert codes(check_workflow(path)) == ["build" for _ in lacking]


def test_missing_damping_is_found(folder: Path) -> None:
    line = text_of(check(folder, {"damping": [0.0] * 12}), "gains.damping")
    assert "stiffness 40 and damping 0; give the damping" in line


def test_positions_without_stiffness_are_found(folder: Path) -> None:
    result = check(folder, {"stiffness": [0.0] * 3 + [40.0] * 9})
    line = text_of(result, "action.limp")
    assert "FL_hip_joint is given positions and its stiffness is 0: it does not go there" in line
    assert "(3 joints)" in line
    assert "gains.swapped" not in codes(result)


def test_gains_other_than_the_robots_are_a_note(folder: Path) -> None:
    assert "the policy's are used" in note_of(check(folder), "gains.differ")


def test_effort_limits_far_from_the_models_are_found(folder: Path) -> None:
    result = check(folder, robot={"joints.0.effort": 5.0})
    line = text_of(result, "limits.effort")
    assert "effort of FR_hip_joint: the robot file says 5 N·m and the model 23.7" in line
    assert "correct joints.effort" in line


def test_other_variants_of_a_motor_are_a_note(folder: Path) -> None:
    result = check(folder, robot={"joints.0.effort": 20.0})
    assert result.clean, result.text()
    assert "FR_hip_joint 20/23.7" in note_of(result, "limits.differ")


def test_other_position_limits_than_the_models_are_a_note(folder: Path) -> None:
    result = check(folder, robot={"joints.0.upper": 0.9})
    assert result.clean, result.text()
    assert "position limits differ from robot go2's at FR_hip_joint" in note_of(
        result, "limits.differ"
    )


def test_a_scale_beyond_a_joints_range_is_found(folder: Path) -> None:
    line = text_of(check(folder, {"action.scale": 2.5, "stiffness": [10.0] * 12}), "action.scale")
    assert "one unit of action moves FL_hip_joint by 2.5 rad, and its whole range is 2.094" in line


def test_a_scale_of_zero_is_found(folder: Path) -> None:
    line = text_of(check(folder, {"action.scale": 0.0}), "action.scale")
    assert "it is 0: no joint could move" in line


def test_scales_of_one_side_only_are_found(folder: Path) -> None:
    scale = [0.125, *[0.25] * 11]
    line = text_of(check(folder, {"action.scale": scale}), "action.symmetry")
    assert "FL_hip_joint has 0.125 and FR_hip_joint has 0.25" in line


def test_a_stiffness_that_is_on_or_off_is_found(folder: Path) -> None:
    line = text_of(check(folder, {"stiffness": [400.0] * 12}), "gains.stiff")
    assert "FL_hip_joint: 400 N·m/rad reaches its effort limit of 23.7 N·m within 0.059" in line


def test_an_offset_outside_the_limits_is_found(folder: Path) -> None:
    offset = list(STAND)
    offset[2] = offset[5] = -0.5
    line = text_of(check(folder, {"action.offset": offset}), "action.offset")
    assert "action 0 puts FL_calf_joint at -0.5 rad, its limits are [-2.723, -0.8378]" in line


def test_reach_beyond_the_limits_needs_something_that_limits(folder: Path) -> None:
    changes = {"action.scale": 1.0, "stiffness": [10.0] * 12}
    limited = check(folder / "a", changes)
    assert limited.clean, limited.text()
    assert "joint_limits cuts them off" in note_of(limited, "action.reach")
    bare = check(folder / "b", changes, {"safety": ["finite"]})
    assert "add joint_limits to safety" in text_of(bare, "action.reach")


def test_a_term_times_zero_is_found(folder: Path) -> None:
    line = text_of(check(folder, {"observation.terms.1.scale": 0.0}), "observation.scale")
    assert line.startswith("policy 'walk', term 'gravity': scale is 0")


@pytest.mark.parametrize(
    ("term", "scale", "said"),
    [
        (
            1,
            -1.0,
            "'gravity': scale is -1 at 3 of 3 elements of projected_gravity: was ",
        ),
        (
            3,
            [1.0] * 11 + [-1.0],
            "'joint_pos': scale is -1 at 1 of 12 elements of joint_pos: was it",
        ),
        (
            4,
            57.3,
            "'joint_vel': scale is 57.3 at 12 of 12 elements of joint_vel: was it tr",
        ),
    ],
)
def test_an_odd_scale_is_noted(folder: Path, term: int, scale: Any, said: str) -> None:
    result = check(folder, {f"observation.terms.{term}.scale": scale})
    assert result.clean, result.text()
    assert f"policy 'walk', term {said}" in note_of(result, "observation.scale")


def test_usual_scales_are_not_noted(folder: Path) -> None:
    changes = {"observation.terms.2.scale": [-2.0, 2.0, 1.0], "observation.terms.4.scale": 1.0}
    assert "observation.scale" not in [note.code for note in check(folder, changes).notes]


def test_a_term_clipped_to_one_value_is_found(folder: Path) -> None:
    line = text_of(check(folder, {"observation.terms.4.clip": [0.0, 0.0]}), "observation.clip")
    assert line.startswith("policy 'walk', term 'joint_vel': it is clipped to 0 … 0")


def test_a_size_that_is_not_the_networks_is_found_term_by_term(folder: Path) -> None:
    result = check(folder, inputs=44)
    line = text_of(result, "build")
    assert "the observation has 45 values and the network's input 'obs' takes 44" in line
    assert "joint_pos [9:21]" in line


def test_what_hardware_cannot_measure_is_a_note_in_simulation(folder: Path) -> None:
    result = check(folder, {"observation.terms.0.state": "base_lin_vel"})
    assert result.clean, result.text()
    line = note_of(result, "observation.measured")
    assert "term 'ang_vel': reads base_lin_vel, which no sensor of the robot measures" in line


HARDWARE = """
from unicon_core.platforms.platform import Platform


def make(states, robot, period, *, address="192.168.123.10") -> Platform:
    raise AssertionError("a check opens no hardware")
"""


@pytest.fixture
def hardware(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """The name of a platform that must not be built."""
    (tmp_path / "toy_hardware.py").write_text(HARDWARE, encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "toy_hardware", raising=False)
    return "toy_hardware:make"


def test_what_hardware_cannot_measure_is_a_finding_there(folder: Path, hardware: str) -> None:
    changes = {"observation.terms.0.state": "base_lin_vel"}
    result = check(folder, changes, {"platform": hardware})
    line = text_of(result, "observation.measured")
    assert f"and platform '{hardware}' does not deliver; let leg_odometry estimate it" in line


RISEN = {"flow": {"chain": [{"pose": {"to": "stand"}}, {"policy": "walk"}]}}


def test_hardware_is_not_opened_by_a_check(folder: Path, hardware: str) -> None:
    result = check(folder, None, {"platform": hardware, **RISEN})
    assert result.clean, result.text()
    assert "hardware, not opened" in result.subject


def test_an_unknown_option_of_hardware_is_found(folder: Path, hardware: str) -> None:
    result = check(folder, None, {"platform": hardware, "platforms": {hardware: {"adress": "x"}}})
    assert "has no option 'adress'; did you mean 'address'?" in text_of(result, "build")


def test_options_of_hardware_that_are_no_mapping_are_found(folder: Path, hardware: str) -> None:
    result = check(folder, None, {"platform": hardware, "platforms": {hardware: 5}})
    assert "is 5; write a mapping" in text_of(result, "build")


def test_missing_facts_fail_on_hardware_and_not_in_simulation(folder: Path, hardware: str) -> None:
    robot = {"transport.protocol": NULL, "unknown": ["transport.protocol"]}
    path = write_workflow(folder, None, {"platform": hardware}, robot)
    line = text_of(check_workflow(path), "robot.facts")
    assert "robot go2: the file does not say transport.protocol; find them" in line
    simulated = check_workflow(path, ["platform=mujoco"])
    assert simulated.clean, simulated.text()
    assert "the real robot cannot be driven" in note_of(simulated, "robot.facts")


def test_motor_slots_that_do_not_fit_are_found(folder: Path, hardware: str) -> None:
    robot = {"transport.motors": [*range(11), 3]}
    result = check(folder, None, {"platform": hardware}, robot)
    assert "12 motor slots, 11 of them different, for 12 joints" in text_of(result, "joints.motors")


def test_a_period_in_milliseconds_is_found(folder: Path) -> None:
    line = text_of(check(folder, {"period": 20}), "timing.period")
    assert "20 s (0.05 Hz); give the control period in [s]" in line


def test_a_rate_that_is_not_the_policys_is_found(folder: Path) -> None:
    line = text_of(check(folder, None, {"rate": 25}), "build")
    assert "does not divide the workflow's rate of 25 Hz" in line


def test_commands_beyond_the_trained_ones_are_found(folder: Path) -> None:
    fast = {"commands": [{"velocity_command": {"constant": [1.5, 0.0, 0.0]}}]}
    line = text_of(check(folder, None, fast), "command.range")
    assert "lin_vel_x 1.5 is outside [-1, 1], for which policy 'walk' was trained" in line
    assert "toy.yaml:" in line
    limited = {"constant": [1.5, 0.0, 0.0], "limits": [[-1.0, 1.0]] * 3}
    assert check(folder / "b", None, {"commands": [{"velocity_command": limited}]}).clean


def test_a_default_pose_outside_the_limits_is_found(folder: Path) -> None:
    pose = list(STAND)
    pose[2] = pose[5] = -0.2
    pose[8] = pose[11] = -0.2
    result = check(folder, {"default_joint_pos": pose})
    line = text_of(result, "pose.limits")
    assert "FL_calf_joint is -0.2 rad, its limits are [-2.723, -0.8378] (4 joints)" in line


def test_a_default_pose_of_one_side_only_is_found(folder: Path) -> None:
    pose = list(STAND)
    pose[1] += 0.2
    line = text_of(check(folder, {"default_joint_pos": pose}), "pose.symmetry")
    assert "FL_thigh_joint has 1 and FR_thigh_joint has 0.8; bring default_joint_pos" in line


def test_names_in_another_order_than_the_figures_are_told_first(folder: Path) -> None:
    names = [JOINTS[leg * 3 + depth] for depth in range(3) for leg in range(4)]
    scale = [0.1, 0.25, 0.25] * 4
    result = check(folder, {"joints": names, "action.scale": scale})
    first = result.findings[0]
    assert first.code == "joints.order"
    assert first.culprit == "policy 'walk', joints (or default_joint_pos, action.scale)"
    told = "in the joint order of the other kind of simulator (FL_thigh_joint for FR_hip_joint, "
    assert told in first.evidence
    assert {"pose.symmetry", "pose.limits"} <= {*codes(result)[1:]}


def test_what_was_taken_from_the_model_is_told(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_workflow(folder, {"joints": None})
    given = "policies.walk={path: ./policy, given: {joints: {from: model}}}"
    told = "joints is taken from the depth first order of go2.xml: FR_hip_joint, FR_thigh_joint, "
    assert told in note_of(check_workflow(path, [given]), "policy.source")
    assert main(["show", str(path), "--set", given]) == 0
    assert f"note: {told}" in capsys.readouterr().out


def test_two_exchanged_names_are_told_alone(folder: Path) -> None:
    names = list(JOINTS)
    names[1], names[5] = names[5], names[1]  # of other legs
    first = check(folder, {"joints": names}).findings[0]
    assert first.code == "joints.order"
    assert first.evidence == (
        "default_joint_pos is not the same on both sides; with FR_calf_joint and FL_thigh_joint "
        "exchanged all of it is"
    )
    assert first.remedy == ("exchange FR_calf_joint and FL_thigh_joint in joints, or their figures")


def test_one_odd_figure_is_no_other_order(folder: Path) -> None:
    pose = list(STAND)
    pose[1] += 0.2
    result = check(folder, {"default_joint_pos": pose})
    assert codes(result)[0] == "pose.symmetry"
    assert "joints.order" not in codes(result)


def test_a_pose_that_kneels_is_found(folder: Path) -> None:
    pose = [0.0, 3.0, -2.7] * 4  # folded: the knees are below the feet
    line = "\n".join(map(str, check(folder, {"default_joint_pos": pose}).findings))
    assert "pose.feet" in line
    assert "below the lowest foot" in line or "the centre of mass" in line


def test_a_simulation_that_begins_in_the_air_or_the_floor_is_found(folder: Path) -> None:
    def start(height: float) -> dict[str, Any]:
        return {"scene": {"initial_pose": "default", "initial_height": height}}

    assert "inside the floor; raise initial_height" in text_of(
        check(folder / "a", None, start(0.1)), "pose.floor"
    )
    assert "above the floor; lower initial_height" in text_of(
        check(folder / "b", None, start(1.5)), "pose.floor"
    )


def test_a_network_that_is_not_the_contracts_is_found(folder: Path) -> None:
    line = text_of(check(folder, {"sha256": "0" * 64}), "build")
    assert "policy.onnx has sha256" in line
    assert "import it again" in line


def test_an_unbuildable_workflow_gives_its_error_as_a_finding(folder: Path) -> None:
    result = check(folder, None, {"robot": "go3"})
    assert text_of(result, "build").startswith("robot: ")
    assert "unknown robot 'go3'; did you mean" in str(result.findings[0])


def test_an_unknown_workflow_is_a_finding() -> None:
    result = check_workflow("go2_stnd")
    assert "unknown workflow 'go2_stnd'" in text_of(result, "build")


def test_a_wrong_graph_is_a_finding(folder: Path) -> None:
    flow = {"flow": {"zip": [{"policy": "walk"}, {"hold": {"duration": 1.0}}]}}
    line = text_of(check(folder, None, flow), "build")
    assert "block 'hold' writes" in line
    assert "a state has one writer" in line


def test_all_mistakes_of_a_built_graph_are_listed(folder: Path) -> None:
    from unicon_core.check.graph import check_blocks
    from unicon_core.check.result import CheckResult
    from unicon_core.check.subject import build_subject
    from unicon_core.flow import Block, Zip
    from unicon_core.workflow.document import load_document

    subject = build_subject(load_document(write_workflow(folder)))
    late = [Block(name, lambda: None, writes=("joint_pos_target",)) for name in ("second", "third")]
    subject.program.root = Zip(subject.program.root, *late)
    result = CheckResult("toy")
    check_blocks(subject, result)
    assert set(codes(result)) == {"graph"}
    assert len(result.findings) > 1
    assert "second" in result.text()
    assert "third" in result.text()


TILTED = """
from unicon_core.platforms import fake

def make(states, robot, period) -> fake.FakePlatform:
    platform = fake.make(states, robot, period)
    plain = platform.recv

    def recv():
        plain()
        states["base_quat"][...] = (0.0, 0.38268, 0.0, 0.92388)  # x, y, z, w of a pitch

    platform.recv = recv
    return platform
"""


def test_an_orientation_that_contradicts_gravity_is_found(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "toy_tilted.py").write_text(TILTED, encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    result = check(folder, None, {"platform": "toy_tilted:make"})
    line = text_of(result, "observation.frame")
    assert "and projected_gravity says [0.0, 0.0, -1.0]; deliver base_quat as w, x, y, z" in line


def test_an_accepted_finding_is_a_note(folder: Path) -> None:
    accept = {"check": {"accept": ["gains.damping"]}}
    result = check(folder, {"damping": [0.0] * 12}, accept)
    assert result.clean, result.text()
    assert "accepted by the workflow" in note_of(result, "gains.damping")


def test_an_unknown_code_to_accept_is_a_finding(folder: Path) -> None:
    result = check(folder, None, {"check": {"accept": ["gains.dampin"]}})
    assert "did you mean 'gains.damping'?" in text_of(result, "check.settings")


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        ({"durations": 3.0}, "check: unknown key 'durations'; did you mean 'duration'?"),
        ({"duration": 0.1}, "check.duration is 0.1; write a number from 1 [s]"),
        ({"command": [1.0]}, "check.command is [1.0]; write [vx, vy, wz]"),
    ],
)
def test_wrong_settings_are_told(folder: Path, settings: dict[str, Any], told: str) -> None:
    result = check(folder, None, {"check": settings})
    assert told in str(result.findings[0])


def test_the_result_is_written_as_json(folder: Path, tmp_path: Path) -> None:
    result = check(folder, {"damping": [0.0] * 12})
    result.write(tmp_path / "out" / "result.json")
    values = json.loads((tmp_path / "out" / "result.json").read_text(encoding="utf-8"))
    assert values["clean"] is False
    assert values["findings"][0]["code"] == "gains.damping"
    assert set(values["findings"][0]) == {
        "code",
        "culprit",
        "evidence",
        "remedy",
        "where",
        "severity",
    }
    assert values["sections"][0]["title"] == "Joints"


def test_every_code_that_is_used_is_explained() -> None:
    import re

    used = set()
    ours = (ROOT / "unicon_core" / "check").rglob("*.py")
    for path in (*ours, ROOT / "unicon_ros" / "bridge" / "map_fit.py"):
        text = path.read_text(encoding="utf-8")
        used |= set(re.findall(r"\.(?:find|find_error|note)\(\s*\"([a-z0-9_.]+)\"", text))
    assert used <= set(CODES)
    by_a_variable = {"twin.fall", "twin.command"} | {c for c in CODES if c.endswith(".symmetry")}
    assert used >= set(CODES) - LIVE - by_a_variable


def test_a_check_loads_nothing_heavy_when_it_is_imported() -> None:
    code = (
        "import sys, unicon_core.check; "
        "print([m for m in ('mujoco', 'onnxruntime', 'rclpy') if m in sys.modules])"
    )
    out = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT
    )
    assert out.stdout.strip() == "[]"


def test_the_command_line_exits_with_1_on_findings(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from unicon_ros.cli.main import main

    good = write_workflow(folder / "good")
    assert main(["check", str(good)]) == 0
    assert capsys.readouterr().out.rstrip().endswith("clean")
    bad = write_workflow(folder / "bad", {"damping": [0.0] * 12})
    assert main(["check", str(bad), "--json", str(tmp_path / "r.json")]) == 1
    assert capsys.readouterr().out.rstrip().endswith("1 finding")
    assert (tmp_path / "r.json").is_file()
