"""Safety blocks that look at nothing, or now and then, are errors; accepted errors are told."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

pytest.importorskip("mujoco", reason="the checks import it")

from toy_workflows import codes, note_of

from unicon_core.check import check_workflow
from unicon_ros.cli.main import main

WORKFLOW = """
robot: go2
platform: fake
rate: 50
flow: {{pose: {{to: stand, duration: 0.2}}}}
states: {{still: {{shape: [3], initial: -1.0}}, slow: {{shape: [12], initial: 0.1}}}}
safety: {safety}
check: {check}
"""

BLIND = {
    "[{when: {if: tick > 1000, do: finite}}]": "'finite': it stands under 'when'",
    "[{every: {n: 1000, do: finite}}]": "'finite': it stands under 'every'",
    "[{loop: {do: finite, until: tick > 2}}]": "'finite': it stands under 'loop'",
    "[{switch: {on: tick, cases: {a: finite}}}]": "'finite': it stands under 'switch'",
    "[finite, {zip: [{when: {if: tick > 9, do: joint_limits}}]}]": "it stands under 'when'",
    "[{finite: {states: {joint_pos_target: joint_vel_target}}}]": "does not look at joint_pos",
    "[finite, {joint_limits: {states: {joint_pos_target: joint_vel_target}}}]": "not joint_pos_tar",
    "[finite, {joint_limits: {states: {joint_pos_target: slow}}}]": "slow, which is not sent",
    "[finite, {tilt_stop: {states: {projected_gravity: still}}}]": "nothing writes still",
    "[finite, {velocity_stop: {states: {joint_vel: slow}}}]": "nothing writes slow",
}
SEES = [
    "[finite, joint_limits, tilt_stop]",
    "[{zip: [finite, joint_limits]}]",
    "[{every: {n: 1, do: finite}}, {loop: {do: joint_limits}}]",
    "[finite, effort_limits, rate_limit, velocity_stop, fade_in]",
]


def written(folder: Path, safety: str, check: str = "{}") -> Path:
    path = folder / "attack.yaml"
    path.write_text(WORKFLOW.format(safety=safety, check=check), encoding="utf-8")
    return path


@pytest.mark.parametrize("safety", BLIND)
def test_a_block_that_sees_nothing_or_now_and_then_is_an_error_of_check_and_run(
    tmp_path: Path, safety: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = written(tmp_path, safety)
    found = check_workflow(path).findings
    assert {each.code for each in found} == {"safety.partial"}
    assert BLIND[safety] in str(found[0])
    assert main(["run", str(path), "--speed", "max", "--quiet"]) == 1
    assert BLIND[safety] in capsys.readouterr().err


@pytest.mark.parametrize("safety", SEES)
def test_blocks_that_see_every_command_are_fine(tmp_path: Path, safety: str) -> None:
    result = check_workflow(written(tmp_path, safety))
    assert [str(found) for found in result.findings] == []
    assert "safety.none" not in {note.code for note in result.notes}


def test_safety_that_looks_at_no_command_is_told_as_none(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = written(tmp_path, "[{elapsed: 1.0}]")
    assert "no block looks at commands" in note_of(check_workflow(path), "safety.none")
    assert main(["run", str(path), "--speed", "max", "--quiet"]) == 0
    assert "commands are sent as they are" in capsys.readouterr().err


def test_an_error_that_the_workflow_accepts_is_told_and_reported_by_every_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = written(tmp_path, "[{every: {n: 2, do: finite}}]", "{accept: [safety.partial]}")
    report = tmp_path / "report.json"
    assert check_workflow(path).clean
    assert main(["run", str(path), "--speed", "max", "--quiet", "--report", str(report)]) == 0
    assert "accepted by the workflow: safety block 'finite'" in capsys.readouterr().err
    assert json.loads(report.read_text(encoding="utf-8"))["forced"] == ["safety.partial"]


@pytest.mark.parametrize("code", ["build", "robot.facts", "timing.catch_up", "graph"])
def test_what_a_run_cannot_begin_with_is_neither_accepted_nor_forced(
    tmp_path: Path, code: str, capsys: pytest.CaptureFixture[str]
) -> None:
    safety = "[nonsense]" if code == "build" else "[finite]"
    path = written(tmp_path, safety, f"{{accept: [{code}]}}")
    assert "check.settings" in codes(check_workflow(path))
    good = written(tmp_path, "[finite]")
    assert main(["run", str(good), "--quiet", "--force", code]) == 1
    assert f"a run cannot begin with '{code}'" in capsys.readouterr().err
