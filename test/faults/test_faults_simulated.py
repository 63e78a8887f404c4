"""Faults in MuJoCo: the judge of damping commands, the ticks, and a case that does not hold."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from faults import cases_simulated
from faults.case import TICKS
from faults.damping_judge import Commands, beyond_damping
from faults.simulated_case import SimulatedCase, able
from faults.simulated_run import run_case
from unicon_core.platforms.kit.command import BLEND
from unicon_core.robots import load_robot

ROBOT = load_robot("go2")
PERIOD = 0.02
FIRST = 5
CASES = {case.row: case for case in cases_simulated.CASES}


def damped() -> Commands:
    """Five commands, then the damping command for 0.5 s."""
    rows, n = FIRST + 25, ROBOT.num_joints
    time = np.arange(rows) * PERIOD
    share = np.clip(1.0 - np.maximum(np.arange(rows) - FIRST + 1, 0) * PERIOD / BLEND, 0.0, 1.0)
    stiffness = 60.0 * np.where(share < 1e-9, 0.0, share)[:, None] * np.ones(n)
    target = np.tile(ROBOT.default_joint_pos.astype(float), (rows, 1))
    zero = np.zeros((rows, n))
    return Commands(time, target, zero, zero.copy(), stiffness, np.full((rows, n), 3.0))


def judged(commands: Commands) -> list[str]:
    return beyond_damping(commands, FIRST, ROBOT, slack=PERIOD)


def test_the_damping_command_does_not_exceed_itself() -> None:
    assert judged(damped()) == []
    assert beyond_damping(damped(), 30, ROBOT, slack=0.0) == ["no damping command was sent"]


@pytest.mark.parametrize(
    ("column", "row", "value", "said"),
    [
        ("target", 7, 0.5, "targets move (damping command 3)"),
        ("target", 7, np.nan, "targets move (damping command 3)"),
        ("speed", 6, 0.1, "velocity targets are not 0 (damping command 2)"),
        ("effort", 6, np.nan, "feed-forward is not 0 (damping command 2)"),
        ("stiffness", 5, 61.0, "stiffness rises (damping command 1)"),
        ("stiffness", 8, -1.0, "stiffness is not finite, or below 0 (damping command 4)"),
        ("stiffness", 29, 0.5, "stiffness is not gone after 0.3 s (damping command 25)"),
        ("damping", 9, 201.0, "damping is out of bounds (damping command 5)"),
        ("damping", 9, np.inf, "damping is out of bounds (damping command 5)"),
    ],
)
def test_each_way_to_exceed_the_damping_command_is_named(
    column: str, row: int, value: float, said: str
) -> None:
    commands = damped()
    getattr(commands, column)[row, 4] = value
    assert said in judged(commands)


def test_targets_beyond_the_limits_are_clamped_when_it_damps() -> None:
    commands = damped()
    commands.target[:, 3] = ROBOT.upper[3]
    commands.target[:FIRST, 3] += 1.0
    assert judged(commands) == []
    commands.target[FIRST:, 3] += 1.0
    assert judged(commands) == ["targets move (damping command 1)"]


def test_ticks_are_random_and_the_same_for_a_seed() -> None:
    case = CASES["sensors: nan in joint_pos"]
    assert case.at("go2") == case.at("go2")
    assert case.at("go2") != case.at("go2", 1)
    assert case.at("go2") != case.at("g1")
    for each in CASES.values():
        for robot in ("go2", "g1"):
            ticks = each.at(robot)
            assert len(set(ticks)) >= TICKS
            assert each.ticks[0] <= min(ticks) <= max(ticks) <= each.ticks[1]


def test_there_are_more_than_forty_faults() -> None:
    assert len(CASES) >= 40


@pytest.fixture
def case() -> SimulatedCase:
    if missing := able("go2"):
        pytest.skip(f"needs {missing}")
    return CASES["sensors: stamps stand still"]


def test_a_fault_is_found_in_time_and_damps(case: SimulatedCase) -> None:
    came = run_case(case, "go2", 40)
    assert came.missed == []
    assert came.reaction == 5  # its command has left, for it looks behind `send`
    assert "stale" in came.reason


def test_a_fault_that_nobody_finds_is_told(case: SimulatedCase) -> None:
    blind = replace(case, workflow={"safety": ["finite"]})
    assert run_case(blind, "go2", 40).missed == [
        "reaction 35 ticks, wanted at most 7",
        "no damping command was sent",
        "0 damping commands, wanted 25",
        "it ended by duration, wanted fault",
        "reason lacks 'stale'",
    ]


def test_a_fault_that_is_found_late_is_told(case: SimulatedCase) -> None:
    assert run_case(replace(case, within=1), "go2", 40).missed == [
        "reaction 5 ticks, wanted at most 3"
    ]


def test_a_case_leaves_nothing_latched(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if missing := able("go2"):
        pytest.skip(f"needs {missing}")
    monkeypatch.setenv("UNICON_LATCHES", str(tmp_path))
    for row in ("~/estop: in wait", "~/estop: in the approach"):
        case = CASES[row]
        assert run_case(case, "go2", case.ticks[0]).missed == []
    assert list(tmp_path.iterdir()) == []
    assert os.environ["UNICON_LATCHES"] == str(tmp_path)
