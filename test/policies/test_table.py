"""Tables show what would be run."""

from __future__ import annotations

from pathlib import Path

import pytest
from policy_helpers import robot, toy_values, write_linear, write_toy

from unicon_base.errors import PolicyError
from unicon_core.policies import (
    joint_table,
    load_policy,
    observation_table,
    policies_table,
    policy_table,
)

OBSERVATION = """\
term         state                  slice    subtract           scale    clip    history  unit
───────────  ─────────────────────  ───────  ─────────────────  ───────  ──────  ───────  ─────
ang_vel      base_ang_vel           [0:3]    -                  0.25     -       1        rad/s
joint_pos    joint_pos              [3:11]   default_joint_pos  1        -       2        rad
cmd          velocity_command[2,0]  [11:13]  0.5                0.1…0.2  -1…1.5  1        -
last_action  action                 [13:17]  -                  1        -       1        -
17 values, term_major, newest last; term = scale · clip(state − subtract)"""

JOINTS = """\
#  joint   robot    kp       kd       default [rad]  scale  offset [rad]  clip
─  ──────  ───────  ───────  ───────  ─────────────  ─────  ────────────  ────
0  a_hip   1        10       1        0.1            0.25   0.1           -2…3
1  a_knee  2        20       2        0.2            held   -             -
2  b_hip   3        30       3        0.3            0.25   0.3           -2…3
3  b_knee  missing  40       4        0.4            0.25   0.4           -2…3
-  head    0        robot's  robot's  robot's        held   -             -"""


def write(tmp_path: Path) -> Path:
    values = toy_values(
        action={"scale": 0.25, "joints": ["a_hip", "b_hip", "b_knee"], "clip": [-2, 3]}
    )
    terms = values["observation"]["terms"]
    terms[1]["history"] = 2
    terms[2] = {
        "name": "cmd", "state": "velocity_command", "index": [2, 0], "scale": [0.1, 0.2],
        "clip": [-1, 1.5], "subtract": 0.5,
    }  # fmt: skip
    return write_toy(tmp_path, values)


def test_the_joint_table_shows_order_gains_and_held_joints(tmp_path: Path) -> None:
    contract = load_policy(write(tmp_path))
    assert joint_table(contract, robot(("head", "a_hip", "a_knee", "b_hip"))) == JOINTS


def test_a_term_of_another_policys_action_needs_a_workflow(tmp_path: Path) -> None:
    values = toy_values()
    values["observation"]["terms"][1]["state"] = "walk_action"
    contract = load_policy(write_toy(tmp_path, values))
    told = (
        "policy toy: term 'joint_pos': state 'walk_action' is neither standard nor its own; .*; "
        "where a workflow has it, such as another policy's last action: unicon show WORKFLOW"
    )
    with pytest.raises(PolicyError, match=told):
        policy_table(contract)


def test_the_observation_table_shows_sources_slices_and_numbers(tmp_path: Path) -> None:
    path = write(tmp_path)
    text = path.read_text("utf-8").replace("  joints:\n  - a_hip\n  - b_hip\n  - b_knee\n", "")
    path.write_text(text, "utf-8")
    assert observation_table(load_policy(path)) == OBSERVATION


def test_the_policy_table_has_everything(tmp_path: Path) -> None:
    values = toy_values(phase={"period": 1.0, "stand": 3.0}, command_ranges={"lin_vel_x": [0, 1]})
    text = policy_table(load_policy(write_toy(tmp_path, values)))
    for part in (
        "policy toy  (policy.yaml: ",
        "period       0.02 s (50 Hz)",
        "inputs       observation → obs",
        "command      lin_vel_x from 0 to 1",
        "gait phase   period 1 s, offsets 0, 3.142 rad, stands at 3 rad without a command",
        "b_knee",
        "15 values, no history",
    ):
        assert part in text


def test_the_list_of_policies_shows_broken_ones_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_toy(tmp_path / "policies" / "good", toy_values(robot="toy"))
    write_toy(tmp_path / "policies" / "wrong", toy_values(period=-1))
    write_linear(tmp_path / "policies" / "bare" / "policy.onnx", 3, 2)
    monkeypatch.setenv("UNICON_PATH", str(tmp_path))
    text = policies_table()
    good = next(line for line in text.splitlines() if line.startswith("good"))
    assert good.split()[1:5] == ["toy", "50", "4", "policy.yaml"]
    assert "period is -1; write a number from 1e-06 to 1000 [s]" in text
    assert "does not say period" in text
