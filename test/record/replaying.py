"""Runs that are cut off, and in what the replay of their records differs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from unicon_base.errors import Fault
from unicon_core.flow import Block, Stage
from unicon_core.runtime import Report, Runner, RunOptions
from unicon_core.workflow import HookBlocks, Program, load_document
from unicon_lab.fault_record import FaultRecord
from unicon_lab.recording import Record, open_record
from unicon_lab.replay import verify, workflow_of

__all__ = ["Told", "cut_off", "replay"]


@dataclass
class Told:
    """A run that was cut off."""

    path: Path
    report: Report
    record: Record


def cut_off(
    workflow: str | Path,
    folder: Path,
    ticks: int,
    *,
    noise: float = 0.05,
    overrides: Mapping[str, Any] | None = None,
    part: str = "",
    inputs: Callable[[Program, np.random.Generator], Callable[[], object]] | None = None,
    amends: str = "velocity_command",
    native: bool = False,
) -> Told:
    """Run a workflow with sensors that are noise, and let it be cut off in a tick.

    Args:
        workflow: its name or path.
        ticks: that end; the next one does not.
        noise: of the sensors' floats.
        overrides: of the workflow.
        part: of a divided workflow.
        inputs: makes what writes states from outside in stage `input`, such as a topic.
        amends: the state that it writes.
        native: as `RunOptions.native`.
    """
    rng = np.random.default_rng(ticks)
    record = FaultRecord(str(folder), warn=_unwanted)

    def outside(program: Program) -> HookBlocks:
        measured = [program.states[name] for name in program.platform.facts.writes]
        measured = [view for view in measured if view.dtype.kind == "f"]
        count = 0

        def disturb() -> None:
            for view in measured:
                view += rng.normal(0.0, noise, view.shape).astype(np.float32)

        def trip() -> None:
            nonlocal count
            count += 1
            if count > ticks:
                raise Fault("tripped by the test")

        stages = {Stage.RECV: [Block("noise", disturb)], Stage.SAFETY: [Block("trip", trip)]}
        if inputs is not None:
            stages[Stage.INPUT] = [Block("given", inputs(program, rng), amends=(amends,))]
        return stages

    document = load_document(workflow, {"platform": "fake"} | dict(overrides or {}))
    program = Program(document, hooks=[outside, record.hook], part=part)
    runner = Runner(program, RunOptions(speed="max", warn=str, native=native))
    record.attach(runner)
    report = runner.run()
    path = record.write(report)
    assert path is not None, report.faults
    return Told(path, report, open_record(path))


def replay(
    record: Record,
    workflow: str | Path | None = None,
    overrides: Mapping[str, Any] | None = None,
    native: bool = False,
) -> list[str]:
    """Replay a record, with the workflow in it unless another is given; return what differs."""
    verdict = verify(record, workflow_of(record, workflow, overrides or {}), native)
    assert verdict.ticks == record.ended.sum()
    found = [] if verdict.first is None else [f"{k}: {v}" for k, v in verdict.first.lines(1.0)]
    return [*found, *verdict.notes]


def _unwanted(message: str) -> None:
    raise AssertionError(message)
