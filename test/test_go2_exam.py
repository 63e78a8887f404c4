"""The exam of the Go2 policy by direction: what its marks say, and that a walk gets them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from trainer import trainer

pytest.importorskip("onnxruntime")
pytest.importorskip("mujoco")
ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "config" / "policies" / "go2_velocity"


@pytest.fixture(scope="module")
def tools() -> Any:
    return trainer("exam", "evaluate")


def marks(exam: Any, lin: float, ang: float, falls: int) -> list[Any]:
    good = exam.Marks("forward", (0.5, 0.0, 0.0), np.array([0.5, 0.0, 0.0]), 0.02, 0.03, 0, 90.0)
    poor = exam.Marks("left", (0.0, 0.4, 0.0), np.array([0.0, 0.3, 0.0]), lin, ang, falls, 95.0)
    still = exam.Marks("stand", (0.0, 0.0, 0.0), np.zeros(3), 0.5, 0.5, 0, 0.0)
    return [good, poor, still]


def test_the_worst_direction_decides_and_standing_is_line_4(tools: Any) -> None:
    exam, evaluate = tools
    held = evaluate.exam_lines(marks(exam, 0.08, 0.09, 0), 20)
    assert [line.holds for line in held] == [True, True, True]
    missed = evaluate.exam_lines(marks(exam, 0.12, 0.14, 1), 20)
    assert [line.measured.split()[0] for line in missed] == ["0.120", "0.140", "1.000"]
    assert [line.holds for line in missed] == [False, False, False]


def test_the_table_has_one_row_for_each_command(tools: Any) -> None:
    exam, _ = tools
    rows = exam.table(marks(exam, 0.12, 0.14, 1), 20).splitlines()
    assert "| left | 0, 0.4, 0 | +0.00, +0.30, +0.00 | 0.120 m/s | 0.140 rad/s | 1 | 95 N |" in rows


def test_commands_are_eight_directions_both_turns_and_standing(tools: Any) -> None:
    exam, _ = tools
    told = np.array(list(exam.COMMANDS.values()))
    angles = np.degrees(np.arctan2(told[:8, 1], told[:8, 0])) % 360
    np.testing.assert_allclose(angles, np.arange(0, 360, 45), atol=1e-6)
    assert not told[:8, 2].any()
    np.testing.assert_array_equal(told[8:, 2], [1.0, -1.0, 0.0])
    assert not told[8:, :2].any()


def test_robots_that_do_nothing_have_the_error_of_their_command(tools: Any) -> None:
    exam, _ = tools
    found = exam.examine(lambda obs, fresh: np.zeros((len(obs), 12), np.float32), 1, seconds=3.0)
    assert [x.falls for x in found] == [0] * len(exam.COMMANDS)
    for x in found:
        assert abs(x.lin - np.hypot(*x.command[:2])) < 0.1, x.name
        assert abs(x.ang - abs(x.command[2])) < 0.1, x.name


def test_a_robot_that_starts_anew_remembers_nothing(tools: Any) -> None:
    exam, _ = tools
    policy = exam.load_policy(FOLDER)
    rng = np.random.default_rng(0)
    first, second = rng.normal(size=(2, 2, 45)).astype(np.float32)
    begun = policy(second[:1], np.array([True]))
    policy = exam.load_policy(FOLDER)
    policy(first, np.array([True, True]))
    after = policy(np.repeat(second[:1], 2, axis=0), np.array([True, False]))
    np.testing.assert_allclose(after[0], begun[0], atol=1e-5)
    assert np.abs(after[1] - begun[0]).max() > 1e-3


@pytest.mark.slow
def test_the_shipped_policy_goes_where_it_is_told(tools: Any) -> None:
    exam, _ = tools
    found = exam.examine(exam.load_policy(FOLDER), 3, seed=7000)
    assert sum(x.falls for x in found) == 0
    for x in found:
        np.testing.assert_allclose(x.mean, x.command, atol=0.08, err_msg=x.name)
        assert x.lin < 0.1, x.name
        assert x.ang < 0.1, x.name
