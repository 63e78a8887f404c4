"""`unicon bench faults`: one fault at a time in real runs, and what the motors still got.

In MuJoCo, in this process: each fault in a go2 and in a g1, at random ticks of a walk, against the
safety blocks that a robot has. As processes: a recording platform logs every command that leaves
into a file that survives the process; faults come from the platform, from other processes and from
what the run writes to. Those run two at a time; their figures are of one run each.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from importlib.util import find_spec
from pathlib import Path

from faults import (
    cases_data,
    cases_latches,
    cases_mujoco,
    cases_output,
    cases_program,
    cases_ros,
    cases_simulated,
)
from faults.case import TICKS, Case, Measured
from faults.fault_report import FaultBench
from faults.fault_run import FaultRun
from faults.measure import measure
from faults.simulated_case import ROBOTS, SimulatedCase, able
from faults.simulated_run import run_case
from unicon_base.errors import UniconError, alternatives
from unicon_core.page import write_file

CASES: tuple[Case, ...] = (
    *cases_data.CASES,
    *cases_program.CASES,
    *cases_output.CASES,
    *cases_ros.CASES,
    *cases_latches.CASES,
    *cases_mujoco.CASES,
)
AT_A_TIME = 2
ATTEMPTS = 3
STOOD_STILL = "(pacing.hang)"
"""In the reason of a run that was stopped or starved between two ticks."""


def run(
    rounds: int | None = None,
    *,
    quick: bool = False,
    only: str = "",
    ticks: int = TICKS,
    markdown: str = "",
) -> FaultBench:
    """Run the cases.

    Args:
        rounds: how often, 1 unless told, each with other ticks; every one must hold, the last
            one's figures are told.
        quick: a handful of cases only, each at one tick.
        only: cases only whose group or name has this in it.
        ticks: at so many random ticks at most, each fault that has no moment of its own.
        markdown: file to which the tables of what was run are written.

    Raises:
        UniconError: no such case, no number of ticks, or the file cannot be written.
    """
    if not 1 <= ticks <= TICKS:
        raise UniconError(f"--ticks {ticks}: give a number from 1 to {TICKS}")
    ticks = 1 if quick else ticks
    chosen = [case for case in CASES if only in case.row]
    simulated = [case for case in cases_simulated.CASES if only in case.row]
    if not chosen and not simulated:
        groups = dict.fromkeys(
            [*(case.group for case in cases_simulated.CASES), *(case.group for case in CASES)]
        )
        raise UniconError(f"--only {only!r}: no such case; {alternatives(only, groups)}")
    if quick:
        chosen = [case for case in chosen if case.quick]
        simulated = [case for case in simulated if case.quick]
    missing = {name for case in chosen for name in case.needs if find_spec(name) is None}
    processes = [case for case in chosen if not missing & case.needs]
    bench = FaultBench("faults", seed=0, rounds=rounds or 1)
    absent = {robot: able(robot) for robot in ROBOTS}
    robots = [robot for robot, what in absent.items() if not what]
    for seed in range(bench.rounds):
        _simulated(bench, simulated, robots, seed, ticks)
        _as_processes(bench, [each for case in processes for each in case.drawn(seed, ticks)])
    if missing:
        names = ", ".join(sorted(missing))
        bench.facts[f"left out, without {names}"] = len(chosen) - len(processes)
    for robot, what in absent.items():
        if what and simulated:
            bench.facts[f"left out of {robot}, without {what}"] = len(simulated)
    names_in = [case.name_in(robot) for case in simulated for robot in robots]
    bench.conclude([*names_in, *(case.row for case in processes)])
    if markdown:
        write_file(Path(markdown), bench.markdown().encode(), folders=True)
    return bench


def _simulated(
    bench: FaultBench,
    cases: Iterable[SimulatedCase],
    robots: Sequence[str],
    seed: int,
    ticks: int,
) -> None:
    for case in cases:
        for robot in robots:
            came = [(at, run_case(case, robot, at)) for at in case.at(robot, seed)[:ticks]]
            _tell(case.name_in(robot), bench.simulated(case, robot, came))


def _as_processes(bench: FaultBench, cases: Iterable[Case]) -> None:
    with ThreadPoolExecutor(AT_A_TIME) as pool:
        runs = {pool.submit(measured, case): case for case in cases}
        try:
            for done in as_completed(runs):
                _tell(runs[done].row, bench.fault(runs[done], done.result()))
        except BaseException:  # Ctrl-C: those that run end by themselves
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _tell(row: str, missed: list[str]) -> None:
    word = "holds" if not missed else f"MISSED: {'; '.join(missed)}"
    print(f"{row}: {word}", file=sys.stderr, flush=True)


def measured(case: Case) -> Measured:
    """Return what came of a run; one that a busy machine ended before its fault is repeated.

    So is one that stood still and is stopped for that, where another reason is wanted.
    """
    for _ in range(ATTEMPTS):
        with tempfile.TemporaryDirectory() as folder:
            fault_run = FaultRun(case, Path(folder))
            got = measure(fault_run, fault_run.run())
        reached = got.reached or not case.wants.closed
        if reached and (case.wants.reason in got.reason or STOOD_STILL not in got.reason):
            break
    return got
