"""Runs of examples/weak_calf.yaml, with the weak leg or as the simulator has it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from unicon_core.flow import Block, Stage
from unicon_core.runtime import Runner, RunOptions
from unicon_core.workflow import HookBlocks, Program, load_document

WORKFLOW = Path(__file__).resolve().parents[2] / "examples" / "weak_calf.yaml"
RL_CALF = 11
KEPT = ("joint_pos", "projected_gravity", "motor_temperature", "twin_flag", "twin_gap")


def walked(weak: bool, seed: int, **overrides: Any) -> tuple[Any, dict[str, Any]]:
    """Return the report of a run, and its states in every tick."""
    rows: dict[str, list[Any]] = {name: [] for name in KEPT}

    def hook(program: Program) -> HookBlocks:
        def look() -> None:
            for name, row in rows.items():
                row.append(program.states[name].copy())

        return {Stage.OBSERVE: [Block("look", look, endless=True)]}

    given = {"scene.seed": seed, **({} if weak else {"scene.joints": {}}), **overrides}
    program = Program(load_document(WORKFLOW, given), hooks=[hook])
    report = Runner(program, RunOptions(speed="max", warn=str)).run()
    return report, {name: np.array(row) for name, row in rows.items()}


def begins_to_fall(told: dict[str, Any]) -> int | None:
    """Return the first tick in which the base leans by more than 0.5 rad; None if it stands."""
    leaning = np.flatnonzero(-told["projected_gravity"][:, 2] < np.cos(0.5))
    return int(leaning[0]) if len(leaning) else None
