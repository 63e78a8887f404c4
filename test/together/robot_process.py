"""One robot of a synchronised start: runs a workflow again and again, and says when its flow began.

    python robot_process.py WORKFLOW RUNS [path=value …]

A line for each run: monotonic time in [ns] of the flow's first tick as a block of the flow saw it,
when it was due, the largest step of a joint's target from one command to the next in [rad], and the
faults.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping, Sequence

import numpy as np

from unicon_base.errors import UniconError
from unicon_core.flow import Block, Tick
from unicon_core.flow.block import Stage
from unicon_core.runtime import Runner, RunOptions, phases
from unicon_core.workflow import Program, load_workflow

BEGAN: list[int] = []
phases.DAMPING_TIME = 0.1  # how each begins is looked at, not how it ends


def note() -> Tick:
    """Build a block of the flow that notes when it is ticked first."""
    BEGAN.clear()

    def noting() -> None:
        if not BEGAN:
            BEGAN.append(time.monotonic_ns())

    return noting


class Steps:
    """Watches what is sent."""

    def __init__(self) -> None:
        self.largest, self._last = 0.0, None

    def hook(self, program: Program) -> Mapping[Stage, Sequence[Block]]:
        states, send = program.states, program.platform.send

        def watched() -> bool | None:
            target = np.array(states["joint_pos_target"])
            before = states["joint_pos"] if self._last is None else self._last
            self.largest = max(self.largest, float(np.abs(target - before).max()))
            self._last = target
            return send()

        program.platform.send = watched  # type: ignore[method-assign]
        return {}


def main(workflow: str, runs: int, overrides: Sequence[str]) -> None:
    for _ in range(runs):
        steps = Steps()
        try:
            program = load_workflow(workflow, overrides, hooks=[steps.hook])
            options = RunOptions(warn=lambda line: print(f"# {line}", flush=True))
            report = Runner(program, options).run()
        except UniconError as error:
            print(f"refused: {error}", flush=True)
            continue
        began = BEGAN[0] if BEGAN else 0
        faults = "; ".join(report.faults) or "-"
        told = report.extra.get("start", {})
        due = round(told["first_tick_ns"] - 1e3 * told["late_us"]) if told else 0
        print(f"{began} {due} {steps.largest:.4f} {faults}", flush=True)


if __name__ == "__main__":
    sys.modules["robot_process"] = sys.modules["__main__"]  # the workflow's block is of this module
    main(sys.argv[1], int(sys.argv[2]), sys.argv[3:])
