"""Block `reach` in workflows: an arm in a simulator, a member of a robot, what a check tells."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from welder import write_arm

from unicon_base.errors import RobotError, WorkflowError
from unicon_core.check import check_workflow, refuse_errors
from unicon_core.runtime import Runner, RunOptions
from unicon_core.workflow import load_workflow

pytest.importorskip("daqp", reason="daqp is not installed: pip install 'unicon_ros[ik]'")

WORKFLOW = """
robot: ./welder.yaml
platform: mujoco
rate: 50
commands:
  - moving_target: {effector: tool, radius: 0.05, frequency: 0.4}
  - reach: {effectors: [tool], moves: [arm]}
flow: {forward_command: {max_rate: 2.0}}
safety: [finite, joint_limits]
"""

MEMBER = """
robot: {base: ./welder.yaml, other: ./welder.yaml}
platform: {base: fake, other: fake}
rate: 50
commands:
  - {of: other, moving_target: {effector: tool, radius: 0.05, frequency: 0.4}}
  - {of: other, reach: {effectors: [tool], moves: [arm]}}
flow:
  zip:
    - {of: base, hold: {}}
    - {of: other, forward_command: {max_rate: 2.0}}
safety: [finite, joint_limits]
"""


def written(folder: Path, text: str = WORKFLOW, **changes: str) -> Path:
    write_arm(folder, **changes)
    path = folder / "welding.yaml"
    path.write_text(text)
    return path


def ticked(path: Path, ticks: int) -> Any:
    """Run a workflow; return its states, and the last tick's error of the tool in [m]."""
    runner = Runner(load_workflow(path), RunOptions(speed="max"))
    for i in range(ticks):
        runner.tick(i * 20_000_000)
    states = runner.program.states
    runner.close()
    return states


def test_a_simulated_arm_follows_a_circle(tmp_path: Path) -> None:
    states = ticked(written(tmp_path), 150)
    assert states.tool_reachable == 1
    assert states.tool_error[0] < 2e-3
    np.testing.assert_allclose(states.joint_pos_target, states.joint_pos_command, atol=1e-6)


def test_a_member_of_a_robot_is_moved_alone(tmp_path: Path) -> None:
    states = ticked(written(tmp_path, MEMBER), 150)
    assert np.isnan(states.joint_pos_command[:6]).all()
    assert not np.isnan(states.joint_pos_command[6:]).any()
    assert states.tool_reachable == 1


def test_nobody_has_to_tell_how_fast_a_target_is(tmp_path: Path) -> None:
    """A topic that writes a pose alone, or nobody at all: NaN, and the arm is not commanded."""
    alone = WORKFLOW.replace(
        "  - moving_target: {effector: tool, radius: 0.05, frequency: 0.4}\n", ""
    )
    states = ticked(written(tmp_path, alone), 3)
    assert np.isnan(states.joint_pos_command).all()
    assert check_workflow(tmp_path / "welding.yaml").findings == []


def test_in_the_flow_it_reaches_what_came_in_the_same_tick(tmp_path: Path) -> None:
    inside = WORKFLOW.replace("  - reach: {effectors: [tool], moves: [arm]}\n", "").replace(
        "flow: {forward_command: {max_rate: 2.0}}",
        "flow:\n  zip:\n    - reach: {effectors: [tool], moves: [arm]}\n"
        "    - forward_command: {max_rate: 2.0}",
    )
    assert ticked(written(tmp_path, inside), 150).tool_reachable == 1


def test_two_blocks_that_move_a_joint_are_refused(tmp_path: Path) -> None:
    twice = WORKFLOW.replace("flow:", "  - reach: {effectors: [tool], moves: [hand]}\nflow:")
    with pytest.raises(WorkflowError) as caught:
        load_workflow(written(tmp_path, twice))
    assert "both move pitch, roll, twist: take them from one of the two" in str(caught.value)


def test_a_good_one_is_clean(tmp_path: Path) -> None:
    result = check_workflow(written(tmp_path))
    assert [found.code for found in result.findings] == []
    assert "reach.apart" not in [note.code for note in result.notes]


def test_what_is_not_kept_apart_is_a_note(tmp_path: Path) -> None:
    path = written(tmp_path, **{"to: [0, 0, 0.1], radius: 0.06": "to: [0, 0, 0.1], radius: 0.5"})
    notes = [note for note in check_workflow(path).notes if note.code == "reach.apart"]
    assert [note.culprit for note in notes] == ["block 'reach'"] * 2
    assert notes[1].evidence.startswith(
        "capsules pillar and hand are not kept apart: at the default pose they are -"
    )


def test_a_body_that_the_model_lacks_and_no_block_uses_is_a_note(tmp_path: Path) -> None:
    plain = "\n".join(line for line in WORKFLOW.splitlines() if "  - " not in line)
    plain = plain.replace("commands:\n", "").replace("forward_command: {max_rate: 2.0}", "hold: {}")
    path = written(tmp_path, plain, **{"hand: {body: flange": "hand: {body: flanje"})
    result = check_workflow(path)
    assert result.clean, result.text()
    (found,) = (note for note in result.notes if note.code == "model.bodies")
    assert found.culprit == "robot welder"
    assert found.evidence == (
        f"capsule 'hand' is on body 'flanje', which model {tmp_path / 'welder.xml'} lacks"
    )
    assert found.remedy == (
        "no block uses it; did you mean 'flange'? known: flange, forearm, knuckle, plate, post, "
        "upper_arm, wrist"
    )
    refuse_errors(load_workflow(path))  # as a run does


def test_a_body_that_a_block_needs_is_refused_by_check_and_run_alike(tmp_path: Path) -> None:
    path = written(tmp_path, **{"hand: {body: flange": "hand: {body: flanje"})
    (found,) = check_workflow(path).findings
    assert (found.code, found.culprit) == ("build", "robot")
    with pytest.raises(RobotError) as caught:
        load_workflow(path)
    assert str(caught.value) == f"{found.evidence}; {found.remedy}"
