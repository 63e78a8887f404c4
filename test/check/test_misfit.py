"""An observation that does not fit the network: the one thing that explains it, or the terms."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from check_helpers import POLICY, check, text_of

pytest.importorskip("mujoco", reason="the workflow simulates")


def terms(key: str, value: Any, *which: int) -> dict[str, Any]:
    return {f"observation.terms.{i}.{key}": value for i in which}


def without(*which: int) -> dict[str, Any]:
    return {f"observation.terms.{i}": None for i in sorted(which, reverse=True)}


def told(folder: Path, changes: dict[str, Any], inputs: int, outputs: int = 12) -> str:
    line = text_of(check(folder / "toy", changes, inputs=inputs, outputs=outputs), "build")
    assert line.endswith("; correct observation.terms in policy.yaml  [build]")
    assert f"and the network's input 'obs' takes {inputs}" in line
    return line.split(f"takes {inputs}")[1].split("; correct")[0]


ELEVEN = list(range(11))
JOINTS = "joint_pos, joint_vel, last_action"


@pytest.mark.parametrize(
    ("changes", "inputs", "why"),
    [
        (terms("index", ELEVEN, 3, 4, 5), 45, f"it has 11 of 12 joints in {JOINTS}"),
        (terms("index", ELEVEN, 4), 45, "it has 11 of 12 joints in joint_vel"),
        (terms("index", ELEVEN, 3, 4), 44, "it has 11 of 12 joints in 1 of joint_pos, joint_vel"),
        (
            terms("index", ELEVEN, 3, 4, 5) | terms("history", 2, 3, 4),
            69,
            f"it has 11 of 12 joints in {JOINTS}",
        ),
        ({}, 225, "it would fit with a history of 5, and has 1"),
        (terms("history", 6, *range(6)), 135, "it would fit with a history of 3, and has 6"),
        (without(0), 45, "it would fit with a term of base_ang_vel (3 values)"),
        (without(1), 45, "it would fit with a term of projected_gravity (3 values)"),
        (without(2), 45, "it would fit with a term of velocity_command (3 values)"),
        ({}, 47, "it would fit with a term of gait_phase (2 values)"),
        (terms("history", 2, *range(6)), 94, "it would fit with a term of gait_phase (2 values)"),
        ({}, 48, "it would fit with a term of base_lin_vel (3 values)"),
    ],
)
def test_one_explanation_is_told(
    changes: dict[str, Any], inputs: int, why: str, tmp_path: Path
) -> None:
    assert told(tmp_path, changes, inputs) == f": {why}"


@pytest.mark.parametrize("number", [11, 13])
def test_a_wrong_number_of_joints_is_told_before_the_size(tmp_path: Path, number: int) -> None:
    line = text_of(check(tmp_path / "toy", {}, inputs=9 + 3 * number, outputs=number), "build")
    assert f"joints has 12 names, the network's output 'actions' {number} values: " in line
    assert "; correct joints in policy.yaml" in line
    assert "observation" not in line


def test_the_number_of_joints_that_the_network_moves_is_plausible(tmp_path: Path) -> None:
    moved = {"action.joints": POLICY["joints"][:8]}
    why = "it has 12 joints, not 8, in joint_pos, joint_vel"
    assert told(tmp_path, moved, 33, outputs=8) == f": {why}"


@pytest.mark.parametrize(
    ("changes", "inputs"),
    [
        ({}, 44),  # nothing fits
        (without(0, 1), 42),  # either of them
        (terms("index", ELEVEN, 3, 4, 5) | without(2), 42),  # joints, or the command
    ],
)
def test_the_terms_are_listed_where_nothing_or_more_than_one_thing_fits(
    changes: dict[str, Any], inputs: int, tmp_path: Path
) -> None:
    assert told(tmp_path, changes, inputs).startswith("; terms: ")
