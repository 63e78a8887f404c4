"""The preflight twin on a Go2 that stands still, and what makes it complain."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("mujoco", reason="the twin runs in MuJoCo")
pytest.importorskip("onnxruntime", reason="the policies need onnxruntime")
pytest.importorskip("onnx", reason="the test networks are written with onnx")

from check_helpers import JOINTS, STAND, WORKFLOW, codes, section, text_of, write_workflow

from unicon_core.check import check_workflow
from unicon_core.check.subject import on_platform
from unicon_core.check.twin.perturb import Change
from unicon_core.check.twin.session import TwinSession
from unicon_core.workflow.document import load_document


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "toy"


@pytest.mark.slow
def test_a_policy_that_does_not_move_is_found(folder: Path) -> None:
    result = check_workflow(write_workflow(folder), ["check.duration=2"], twin=True)
    line = text_of(result, "twin.command")
    assert line.startswith("policy 'walk': it stays up, but moves at vx ")
    assert "where vx 0.60, vy 0.00 m/s, wz 0.00 rad/s is commanded" in line
    assert line.split("  [")[0].endswith("; if it only stands: check: {command: [0, 0, 0]}")
    assert codes(result) == ["twin.command"]


@pytest.mark.parametrize("said", ["workflow", "check"])
def test_a_policy_that_is_to_stand_is_not_suspect(folder: Path, said: str) -> None:
    stand = {"commands": [{"velocity_command": {"constant": [0.0, 0.0, 0.0]}}]}
    path = write_workflow(folder, None, stand)
    changes = ["check.duration=2", *(["check.command=[0, 0, 0]"] if said == "check" else [])]
    result = check_workflow(path, changes, twin=True)
    assert result.clean, result.text()
    notes = [str(note) for note in result.notes if note.code == "twin.suspect"]
    assert len(notes) == 1
    assert notes[0].startswith("policy 'walk': it rests, and with ")
    assert "the network hardly responds, so the twin cannot tell" in notes[0]
    commands = [str(note) for note in result.notes if note.code == "twin.command"]
    assert len(commands) == (said == "workflow")
    assert all("let it walk by check: {command: [0.6, 0, 0]}" in note for note in commands)


def test_a_contract_that_may_be_broken_at_will_is_suspect_and_standing_proves_nothing(
    folder: Path,
) -> None:
    terms = [
        {"name": "gravity", "state": "projected_gravity"},
        {"name": "joint_vel", "state": "joint_vel", "scale": 0.05},
    ]
    path = write_workflow(folder, {"observation.terms": terms}, inputs=15)
    result = check_workflow(path, ["check.duration=2"], twin=True)
    assert result.clean, result.text()
    [note] = [str(note) for note in result.notes if note.code == "twin.suspect"]
    assert "gravity upside down" in note
    assert "the network hardly responds, so the twin cannot tell whether the contract is right" in (
        note
    )


def test_a_fall_is_found_and_no_cause_is_made_up(folder: Path) -> None:
    path = write_workflow(folder, gain=3.0)  # random actions
    result = check_workflow(path, ["check.duration=1"], twin=True)
    line = text_of(result, "twin.fall")
    assert "and none of the usual mistakes explains it" in line
    assert "compare default pose, gains" in line


def test_joints_that_the_policy_does_not_know_and_that_give_way_are_the_culprit(
    folder: Path,
) -> None:
    """The policy stands on one leg of four; the robot holds the others limply."""
    leg = {"joints": list(JOINTS[:3]), "default_joint_pos": list(STAND[:3])}
    leg |= {"stiffness": [40.0] * 3, "damping": [1.0] * 3}
    limp = {f"joints.{i}.stiffness": 0.5 for i in range(12)}
    path = write_workflow(folder, leg, None, limp, inputs=18, outputs=3)
    changes = ["check.duration=2", "check.command=[0.05, 0.0, 0.0]"]  # it stands, as is asked
    line = text_of(check_workflow(path, changes, twin=True), "twin.fall")
    assert line.startswith("policy 'walk', joints of the model that the policy does not know: ")
    assert "with the other joints welded it stays up for 2.0 s" in line
    assert "it neither moves nor sees" in line
    assert "9 of 12 joints, which give way here" in line
    assert "take the model that it was trained on" in line


def test_the_whole_flow_is_run_where_it_has_no_policy() -> None:
    result = check_workflow("go2_stand", twin=True)
    assert result.clean, result.text()
    assert section(result, "Twin on platform mujoco, the whole flow")[0][1] == "stays up for 15.0 s"


def test_a_flow_that_falls_is_found(folder: Path) -> None:
    flow = {
        "flow": {"chain": [{"pose": {"to": "stand", "duration": 0.5}}, {"damp": {"duration": 3.0}}]}
    }
    values = {**flow, "policies": None, "rate": 50, "scene": {"initial_height": 3.0}}
    values |= {"check": {"accept": ["pose.floor"]}, "safety": ["finite", "tilt_stop"]}
    values["scene"] |= {"push": {"every": 0.2, "velocity": 8.0}}
    result = check_workflow(write_workflow(folder, None, values), twin=True)
    assert text_of(result, "twin.fall").startswith("flow: ")


def test_hardware_is_exchanged_for_the_robots_model(folder: Path, tmp_path: Path) -> None:
    document = load_document(write_workflow(folder, None, {"platform": "fake", "scene": None}))
    other = on_platform(document, "mujoco", {"initial_pose": "policy:walk"})
    assert other.values["scene"] == {"initial_pose": "policy:walk"}
    assert document.values["platform"] == "fake"
    session = TwinSession(other)
    assert session.program.platform.facts.name == "mujoco"
    assert session.run(1.0).stands
    session.close()


def test_the_scene_of_the_workflow_is_kept_in_the_twin(folder: Path) -> None:
    document = load_document(write_workflow(folder, None, {"num_robots": 3}))
    other = on_platform(document, "mujoco", {"initial_pose": "keyframe:lie"})
    assert other.values["scene"] == WORKFLOW["scene"]
    assert "num_robots" not in other.values


def test_a_robot_without_a_model_cannot_have_a_twin(folder: Path) -> None:
    path = write_workflow(folder, None, {"platform": "fake", "scene": None}, {"models": {}})
    line = text_of(check_workflow(path, twin=True), "twin.run")
    assert "names no model (mjcf or urdf)" in line


def test_two_runs_of_one_contract_are_equal_and_leave_no_trace(folder: Path) -> None:
    from dataclasses import replace

    session = TwinSession(load_document(write_workflow(folder, gain=0.05)))
    contract = session.contracts["walk"]
    first = session.run(1.0)
    weak = replace(contract, stiffness=0.1 * contract.stiffness)
    assert session.run(1.0, "walk", Change("", "", weak, without="unlimited")) != first
    assert session.run(1.0) == first
    assert session.run(1.0, "walk", Change("", "", contract)) == first
    session.close()


def test_a_slow_workflow_is_given_a_command_that_tells_something(folder: Path) -> None:
    slow = {"commands": [{"velocity_command": {"constant": [0.1, 0.0, 0.0]}}]}
    document = load_document(write_workflow(folder, None, slow))
    session = TwinSession(document)
    assert session.run(1.0).command == pytest.approx((0.6, 0.0, 0.0))
    asked = TwinSession(document, [0.2, 0.0, 0.3])
    assert asked.run(1.0).command == pytest.approx((0.2, 0.0, 0.3))


def test_a_policy_that_the_flow_never_calls_is_told(folder: Path) -> None:
    flow = {"chain": [{"hold": {"duration": 0.5}}, {"damp": {"duration": 0.2}}]}
    switch = {"switch": {"on": "0", "cases": {"stand": flow, "walk": {"policy": "walk"}}}}
    path = write_workflow(folder, None, {"flow": switch})
    result = check_workflow(path, twin=True)
    assert any("the flow never calls it in the twin" in str(note) for note in result.notes)


def test_several_policies_are_broken_one_by_one(folder: Path) -> None:
    both = {"walk": "./policy", "trot": "./policy"}
    chain = [{"loop": {"do": {"policy": name}, "until": {"elapsed": 1.0}}} for name in both]
    terms = [
        {"name": "gravity", "state": "projected_gravity"},
        {"name": "last_action", "state": "action"},
    ]
    changes = {"policies": both, "flow": {"chain": chain}}
    path = write_workflow(folder, {"observation.terms": terms}, changes, inputs=15)
    static = check_workflow(path)
    assert static.clean, static.text()
    titles = [s.title for s in static.sections]
    assert "Observation of policy walk" in titles
    assert "Observation of policy trot" in titles
    result = check_workflow(path, ["check.duration=2"], twin=True)
    rows = section(result, "Twin on platform mujoco")
    assert [row[0] for row in rows].count("walk: gravity upside down") == 1
    assert [row[0] for row in rows].count("trot: gravity upside down") == 1


MINE = """\
from dataclasses import replace

from unicon_core.platforms.mujoco import MujocoPlatform, make as mujoco

class Mine(MujocoPlatform):
    facts = replace(MujocoPlatform.facts, name="mine")

def make(states, robot, period, scene, blind=False) -> Mine:
    platform = mujoco(states, robot, period, scene=scene)
    told = tuple(n for n in platform.facts.writes if not (blind and n == "base_pos_w"))
    platform.facts = replace(Mine.facts, writes=told)
    return platform
"""


@pytest.fixture
def mine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """Word of a simulator of somebody else."""
    (tmp_path / "simulator_of_mine.py").write_text(MINE, "utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    return "simulator_of_mine:make"


@pytest.mark.slow
def test_the_twin_runs_on_the_simulator_that_the_workflow_names(folder: Path, mine: str) -> None:
    path = write_workflow(folder, None, {"platform": mine, "scene": None})
    result = check_workflow(path, ["check.duration=1"], twin=True)
    assert section(result, "Twin on platform mine")
    assert not any(note.code == "twin.platform" for note in result.notes)


@pytest.mark.slow
def test_that_it_runs_elsewhere_is_told(folder: Path) -> None:
    path = write_workflow(folder, None, {"platform": "fake", "scene": None})
    result = check_workflow(path, ["check.duration=1"], twin=True)
    assert section(result, "Twin on platform mujoco")
    (note,) = [str(note) for note in result.notes if note.code == "twin.platform"]
    assert "it simulates no model: the twin runs in MuJoCo" in note


def test_a_simulator_that_tells_too_little_cannot_judge(folder: Path, mine: str) -> None:
    options = {"platform": mine, "platforms": {mine: {"blind": True}}}
    line = text_of(check_workflow(write_workflow(folder, None, options), twin=True), "twin.run")
    assert "platform 'mine' does not tell base_pos_w, by which the twin judges" in line
