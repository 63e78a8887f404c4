"""Runs that are cut off, and the replay of their records in a program that was built anew."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from unicon_core.errors import Fault
from unicon_core.flow import Block, Stage
from unicon_core.runtime import Report, Runner, RunOptions
from unicon_core.runtime.tick_ring import memory_of
from unicon_core.workflow import Program, load_document
from unicon_ros.fault_record import FaultRecord
from unicon_ros.recording import Record, open_record

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
) -> Told:
    """Run a workflow with sensors that are noise, and let it be cut off in a tick.

    Args:
        workflow: its name or path.
        ticks: that end; the next one does not.
        noise: of the sensors' floats.
        overrides: of the workflow.
        part: of a divided workflow.
        inputs: makes what writes states from outside in stage `input`, such as a topic.
    """
    rng = np.random.default_rng(ticks)
    record = FaultRecord(str(folder), warn=_unwanted)

    def outside(program: Program) -> dict[Stage, list[Block]]:
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
            stages[Stage.INPUT] = [Block("given", inputs(program, rng))]
        return stages

    program = _program(workflow, overrides, [outside, record.hook], part)
    runner = Runner(program, RunOptions(speed="max", warn=str))
    record.attach(runner)
    report = runner.run()
    path = record.write(report)
    assert path is not None, report.faults
    return Told(path, report, open_record(path))


def replay(
    workflow: str | Path, record: Record, overrides: Mapping[str, Any] | None = None, part: str = ""
) -> list[str]:
    """Feed what a record's ticks received to a fresh program; return in what it differs."""
    feed = Feed(record)
    program = _program(workflow, overrides, [feed.hook], part)
    runner = Runner(program, RunOptions(speed="max", warn=str))
    memory, graphs = memory_of(program, runner), runner.graphs()
    before = {each["before"]: each for each in record.memories}
    try:
        for row in range(len(record.ticks)):
            if row in before and (row == 0 or before[row]["anew"]):
                memory.restore(before[row])
            if record.ended[row]:
                graph = graphs[record.phases[row]]
                graph.step()
                graph.deferred()
    finally:
        program.close()
    assert feed.row == record.ended.sum()
    return feed.differences


@dataclass
class Feed:
    """Puts what was received into the states, and compares what comes of it."""

    record: Record
    row: int = 0
    differences: list[str] = field(default_factory=list)
    told: dict[tuple[str, str], Any] = field(default_factory=dict)

    def hook(self, program: Program) -> dict[Stage, list[Block]]:
        record, states = self.record, program.states
        assert states.layout.hash == record.layout.hash

        def put(moment: str) -> Callable[[], None]:
            def tick() -> None:
                if moment != "received":
                    self.compare(program, moment, before=True)
                record.feed(moment, self.row, states)

            return tick

        def sent() -> None:
            self.compare(program, "sent")
            self.row += 1

        names = {Stage.RECV: "received", Stage.INPUT: "input", Stage.TUNE: "tuned"}
        stages = {s: [Block(f"feed {m}", put(m))] for s, m in names.items() if m in record.moments}
        return stages | {Stage.OBSERVE: [Block("compare", sent)]}

    def compare(self, program: Program, moment: str, before: bool = False) -> None:
        for name in self.record.kept[moment]:
            if before and name in GIVEN:  # what came from outside is fed, not foretold
                continue
            if (name, moment) not in self.told:
                self.told[name, moment] = self.record.states(name, moment)
            if program.states[name].tobytes() != self.told[name, moment][self.row].tobytes():
                self.differences.append(f"{moment} of row {self.row}: {name}")


GIVEN = ("velocity_command", "joint_stiffness", "joint_damping")


def _program(
    workflow: str | Path, overrides: Mapping[str, Any] | None, hooks: list[Any], part: str
) -> Program:
    document = load_document(workflow, {"platform": "fake"} | dict(overrides or {}))
    return Program(document, hooks=hooks, part=part)


def _unwanted(message: str) -> None:
    raise AssertionError(message)
