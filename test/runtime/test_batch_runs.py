"""Batches: robot k of 64 does what it does alone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from policy_workflows import write_workflow

from unicon_core.flow import Block, Stage
from unicon_core.runtime import Runner, RunOptions
from unicon_core.workflow import HookBlocks, Program, load_workflow

ROBOTS = 64
TICKS = 110
WATCHED = ("joint_pos", "joint_vel", "joint_pos_target", "joint_stiffness", "joint_damping")

POSTURES = """\
robot: go2
platform: fake
scene: {initial_pose: rest}
platforms: {fake: {time_constant: 0.04}}
rate: 50
flow:
  chain:
    - pose: {to: stand, duration: 0.3, fade_in: 0.2}
    - hold: {duration: 0.1}
    - sway: {duration: 0.8, gains: {"*_hip_joint": [0.3, 0.2, 0.1], "F*_calf_joint": [0, 0, 0.5]}}
    - pose: {to: {"*_thigh_joint": 1.2}, duration: 0.8}
    - damp: {duration: 0.2}
safety: [fade_in, finite, joint_limits, {effort_limits: {scale: 0.05}}, rate_limit, tilt_stop]
"""


def commands(ticks: int) -> NDArray[np.float32]:
    """What each robot is told, shape (ticks, ROBOTS, 3): every one something else."""
    steps = np.random.default_rng(3).normal(0.0, 0.05, (ticks, ROBOTS, 3))
    return np.cumsum(steps, axis=0).astype(np.float32)


def runner(path: Path, told: NDArray[np.float32], robots: int | None) -> Runner:
    """A run whose velocity command is `told[tick]`."""

    def hook(workflow: Program) -> HookBlocks:
        command, tick = workflow.states["velocity_command"], workflow.states["tick"]

        def tell() -> None:
            command[...] = told[int(tick.flat[0])]

        return {Stage.INPUT: [Block("tell", tell, writes=("velocity_command",))]}

    overrides: dict[str, Any] = {"commands": []}
    if robots is not None:
        overrides["num_robots"] = robots
    return Runner(load_workflow(path, overrides, hooks=[hook]), RunOptions(speed="max"))


def test_without_a_policy_every_bit_is_that_of_a_single_run(tmp_path: Path) -> None:
    path = tmp_path / "postures.yaml"
    path.write_text(POSTURES, encoding="utf-8")
    told = commands(TICKS)
    many = runner(path, told, ROBOTS)
    record = {name: [] for name in WATCHED}  # type: dict[str, list[Any]]
    for _ in range(TICKS):
        many.tick(0)
        for name, seen in record.items():
            seen.append(many.program.states[name].copy())
    for k in range(ROBOTS):
        one = runner(path, told[:, k], None)
        for tick in range(TICKS):
            one.tick(0)
            for name, seen in record.items():
                alone = one.program.states[name].tobytes()
                assert seen[tick][k].tobytes() == alone, (name, k, tick)
        one.close()
    many.close()
    moved = np.array(record["joint_pos_target"])
    assert np.ptp(moved[-40:], axis=1).max() > 0.05  # robots do differ


@pytest.mark.parametrize("kind", ["plain", "history"])
def test_with_a_policy_each_action_is_within_1e_5(tmp_path: Path, kind: str) -> None:
    path = write_workflow(tmp_path, kind)
    told = commands(TICKS)
    many = runner(path, told, ROBOTS)
    actions, targets = [], []
    for _ in range(TICKS):
        many.tick(0)
        actions.append(many.program.states["action"].copy())
        targets.append(many.program.states["joint_pos_target"].copy())
    for k in range(0, ROBOTS, 7):
        one = runner(path, told[:, k], None)
        for tick in range(TICKS):
            one.tick(0)
            np.testing.assert_allclose(one.program.states["action"], actions[tick][k], atol=1e-5)
            target = one.program.states["joint_pos_target"]
            np.testing.assert_allclose(target, targets[tick][k], atol=1e-5)
        one.close()
    many.close()
    assert np.ptp(np.array(actions), axis=1).max() > 0.1
