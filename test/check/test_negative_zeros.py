"""No zero has a minus sign in what `check`, `show`, `robots`, `policies` and `preflight` print."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest
from check_helpers import STAND, check, write_workflow

from unicon_core.policies import load_policy, policy_names
from unicon_core.policies.table import policy_table
from unicon_core.preflight.wiggle import Moved, verdicts
from unicon_core.robots import load_robot, robot_names, robot_table
from unicon_core.text_table import figure, span
from unicon_ros.cli.main import main

NEGATIVE_ZERO = re.compile(r"(?<![\w.])-0(\.0*)?(?![\w.])")
ZERO = -1e-9
POLICY = {
    "default_joint_pos": [ZERO if i % 3 == 0 else value for i, value in enumerate(STAND)],
    "stiffness": [-0.0, *[40.0] * 11],
    "damping": [-0.0, *[1.0] * 11],
    "action.scale": [-0.0, *[0.25] * 11],
    "action.clip": [-0.0, 8.0],
    "observation.terms.0.clip": [-0.0, 8.0],
    "observation.terms.4.scale": -0.0,
    "command_ranges": {"lin_vel_x": [-0.0, 1.0]},
}


@pytest.mark.parametrize(
    ("value", "form", "text"),
    [
        (-0.0, "g", "0"),
        (-1e-9, ".2f", "0.00"),
        (-0.004, ".2f", "0.00"),
        (-0.006, ".2f", "-0.01"),
        (-0.0, "+.1f", "+0.0"),
        (-0.0001, ".0%", "0%"),
        (-0.0, "", "0.0"),
        (-0.5, "g", "-0.5"),
        (np.float32(-0.0), ".4g", "0"),
        (np.float32(0.1), "g", "0.1"),
        (-10.0, "g", "-10"),
        (math.nan, "g", "?"),
        (-math.inf, "g", "-inf"),
    ],
)
def test_a_figure(value: float, form: str, text: str) -> None:
    assert figure(value, form) == text


def test_a_range_has_figures_at_both_ends() -> None:
    assert span(-0.0, 1.0) == "0 … 1"
    assert span(-1.0, -0.004, "…", ".2f") == "-1.00…0.00"
    assert span(math.nan, 1.0, ", ") == "?, 1"


def test_check_show_and_policies_print_none(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("mujoco")
    result = check(tmp_path / "toy", POLICY)
    assert result.sections, result.text()
    assert not NEGATIVE_ZERO.search(result.text())
    assert not NEGATIVE_ZERO.search(str(result.to_json()))
    path = str(tmp_path / "toy" / "toy.yaml")
    assert main(["show", path]) == 0
    assert main(["policies", str(tmp_path / "toy" / "policy")]) == 0
    told = capsys.readouterr().out
    assert "0…8" in told
    assert not NEGATIVE_ZERO.search(told)


def test_a_robot_is_printed_without(tmp_path: Path) -> None:
    joint = {f"joints.0.{key}": -0.0 for key in ("lower", "default", "rest", "damping")}
    zeros = {**joint, "imu.position": [-0.0, 0.0, -0.0], "transport.vel_stop": -0.0}
    write_workflow(tmp_path / "toy", robot=zeros)
    told = robot_table(load_robot(tmp_path / "toy" / "go2.yaml"))
    assert "vel_stop         0.0" in told
    assert not NEGATIVE_ZERO.search(told)


@pytest.mark.parametrize("name", robot_names())
def test_no_shipped_robot_prints_one(name: str) -> None:
    assert not NEGATIVE_ZERO.search(robot_table(load_robot(name)))


@pytest.mark.parametrize("name", policy_names())
def test_no_shipped_policy_prints_one(name: str) -> None:
    assert not NEGATIVE_ZERO.search(policy_table(load_policy(name)))


def test_a_wiggle_prints_none() -> None:
    (row,) = verdicts([Moved("a", "a", -1e-6)], 0.05)
    assert row[2:4] == ("+0.0 of 50 mrad", "+0.00")
