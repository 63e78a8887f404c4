"""Runs one fault in MuJoCo at one tick, in this process, and measures what came of it."""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from faults.damping_judge import Commands, beyond_damping
from faults.simulated_case import SimulatedCase
from faults.simulated_platform import LOGGED, FaultySimulator
from unicon_base.errors import UniconError
from unicon_core.platforms.kit.command import DAMPING_TIME
from unicon_core.runtime import Report, Runner, RunOptions
from unicon_core.workflow import Program
from unicon_lab.fault_record import FaultRecord
from unicon_lab.recording import open_record

ROOM = 2
"""Ticks that a reaction may take beyond the detection."""

AFTER = 30
"""Ticks for which a run goes on after a fault should have been found."""

RANGES = (1.0, 1.0, 1.0)
"""Beyond the velocity command of no policy here, [m/s] and [rad/s]."""


@dataclass
class Came:
    """What came of one fault at one tick.

    Attributes:
        reaction: commands that left after it and before the damping ones; None where it never
            began.
        reason: why the run ended, "" for no fault.
        missed: what is not as declared, each in words.
    """

    reaction: int | None = None
    reason: str = ""
    missed: list[str] = field(default_factory=list)


def run_case(case: SimulatedCase, robot: str, at: int) -> Came:
    """Run a case in a robot, with the fault at a tick.

    Args:
        case: which.
        robot: `go2` or `g1`.
        at: the tick.
    """
    with tempfile.TemporaryDirectory() as folder, _latches_in(folder), _clock_kept():
        record = FaultRecord(folder, warn=_silent)
        hooks = [case.mishap] if case.mishap is not None else []
        values = case.described(robot, at)
        program = Program(hooks=[*hooks, record.hook], **values)
        platform = program.platform
        assert isinstance(platform, FaultySimulator)
        reach = case.ticks[1] if case.during != "run" else at
        seconds = (reach + case.detection(robot) + AFTER) * program.period
        speed: Literal["real", "max"] = "real" if case.real else "max"
        runner = Runner(program, RunOptions(duration=seconds, speed=speed, warn=_silent))
        platform.phase = lambda: runner.phase.value
        platform.runner = runner
        record.attach(runner)
        with np.errstate(all="ignore"):  # what cannot be computed is the fault that was put in
            report = runner.run()
        if runner.interrupted:  # somebody wants the bench to end
            raise KeyboardInterrupt
        got = Came(reason="; ".join(report.faults).replace(f"{folder}/", ""))
        _measure(got, case, case.detection(robot), platform, program)
        ended = report.ended
        wanted = "fault" if case.outcome in ("damp", "refuse") else ""
        if wanted and ended != wanted:
            got.missed.append(f"it ended by {ended}, wanted {wanted}")
        if not wanted and report.faults:
            got.missed.append("it ended by a fault")
        if case.reason not in got.reason:
            got.missed.append(f"reason lacks {case.reason!r}")
        if report.overruns < case.overruns:
            got.missed.append(f"{report.overruns} overruns, wanted {case.overruns}")
        _recorded(got, record, report)
        return got


@contextmanager
def _latches_in(folder: str) -> Iterator[None]:
    """Keep what a case latches from the next one, and from robots of the user."""
    before = os.environ.get("UNICON_LATCHES")
    os.environ["UNICON_LATCHES"] = folder
    try:
        yield
    finally:
        if before is None:
            del os.environ["UNICON_LATCHES"]
        else:
            os.environ["UNICON_LATCHES"] = before


def _measure(
    got: Came, case: SimulatedCase, detection: int, platform: FaultySimulator, program: Program
) -> None:
    log, onset, missed = platform.log, platform.onset, got.missed
    if case.outcome == "refuse":
        got.reaction = 0
        if log:
            missed.append(f"{len(log)} commands were sent")
        return
    if onset is None:
        missed.append("the fault was never reached")
        return
    phases = [row[0] for row in log]
    damped = phases.index("damp") if "damp" in phases else len(log)
    after = log[onset:]
    usual = [row for row in after if row[0] not in ("damp", "soft")]
    if case.during == "soft":
        usual = [row for row in after if row[0] == "soft"]
    elif case.during == "damp":
        usual = []
    got.reaction = len(usual)
    for row in usual:
        if not all(np.isfinite(value).all() for value in row[1:]):
            missed.append("a command was not finite")
            break
    if case.outcome in ("damp", "soft"):
        allowed = detection + ROOM
        if got.reaction > allowed:
            missed.append(f"reaction {got.reaction} ticks, wanted at most {allowed}")
    if case.outcome == "damp" and log:
        missed += _damping(log, damped, program)
    if case.outcome == "soft" and "soft" not in phases:
        missed.append("no wind-down")
    if case.outcome in ("go on", "zero command"):
        if len(usual) < AFTER - ROOM:
            missed.append(f"it went on for {len(usual)} ticks only")
        velocity = np.abs([row[-1] for row in usual])
        if len(usual) and case.outcome == "zero command" and velocity.any():
            missed.append("the velocity command is not zero")
        if len(usual) and (velocity > RANGES).any():
            missed.append("the velocity command is beyond what is allowed")


def _damping(log: list[tuple[Any, ...]], first: int, program: Program) -> list[str]:
    columns = [np.array([row[k + 1] for row in log], np.float64) for k in range(len(LOGGED) - 1)]
    times = np.arange(len(log), dtype=np.float64) * program.period
    missed = beyond_damping(Commands(times, *columns), first, program.robot, slack=program.period)
    expected = round(DAMPING_TIME / program.period)
    if len(log) - first < expected:
        missed.append(f"{len(log) - first} damping commands, wanted {expected}")
    return missed


def _recorded(got: Came, record: FaultRecord, report: Report) -> None:
    """See that the record of a fault can be read, and names the reason and the tick."""
    path = record.write(report)
    if path is None:
        if got.reason:
            got.missed.append("there is no fault record")
        return
    try:
        read = open_record(path)
    except UniconError as error:
        got.missed.append(f"the record cannot be read: {error}")
        return
    if not got.reason.startswith(read.facts["reason"][:40]):
        got.missed.append(f"the record says {read.facts['reason']!r}")
    if not len(read.ticks):
        got.missed.append("the record holds no ticks")


def _silent(line: str) -> None:
    """Drop what a run tells: what counts is in the report."""


@contextmanager
def _clock_kept() -> Iterator[None]:
    """Restore the clock of the day, which a mishap may have changed."""
    before = time.time, time.time_ns
    try:
        yield
    finally:
        time.time, time.time_ns = before
