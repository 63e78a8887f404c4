"""Motions of simulated robots whose joints are known, for the tests of identification."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from unicon_core.flow import Block, Stage
from unicon_core.runtime import Runner, RunOptions
from unicon_core.workflow import HookBlocks, Program, load_document
from unicon_lab.diagnose.motion import Motion

WORKFLOW = """\
robot: go2
platform: mujoco
rate: 50
flow:
  excite: {{signal: random, frequency: {quick}, amplitude: 0.1, duration: {seconds}, fade: 0.5}}
"""


def states_of(
    workflow: str | Path, overrides: dict[str, Any], seconds: float | None = None
) -> tuple[dict[str, Any], float]:
    """Return all states of a run in every tick, and its period in [s]."""
    rows: dict[str, list[Any]] = {}

    def hook(program: Program) -> HookBlocks:
        rows.update({name: [] for name in program.states})

        def look() -> None:
            for name, row in rows.items():
                row.append(program.states[name].copy())

        return {Stage.OBSERVE: [Block("look", look, endless=True)]}

    program = Program(load_document(workflow, overrides), hooks=[hook])
    Runner(program, RunOptions(speed="max", warn=str, duration=seconds)).run()
    return {name: np.array(row) for name, row in rows.items()}, program.period


def motion(
    folder: Path,
    joints: dict[str, dict[str, float]],
    seconds: float = 3.0,
    quick: float = 2.0,
    **options: Any,
) -> Motion:
    """Return how a Go2 moved whose joints are not as its model says."""
    path = folder / "excite.yaml"
    path.write_text(WORKFLOW.format(seconds=seconds, quick=quick))
    states, period = states_of(path, {"scene.joints": joints})
    return Motion.of(states, period, np.ones(len(states["tick"]), np.bool_), **options)
