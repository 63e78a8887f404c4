"""`unicon bench faults`: one fault at a time in real runs, and what the motors still got.

A recording platform logs every command that leaves into a file that survives the process. Faults
come from the platform, from other processes and from what the run writes to. Cases run two at a
time; figures are of one run each, not percentiles.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor, as_completed
from importlib.util import find_spec
from pathlib import Path

from unicon_core.errors import UniconError, alternatives
from unicon_ros.bench.faults import cases_data, cases_output, cases_program, cases_ros
from unicon_ros.bench.faults.case import Case, Measured
from unicon_ros.bench.faults.fault_report import FaultBench, write_table
from unicon_ros.bench.faults.fault_run import FaultRun
from unicon_ros.bench.faults.measure import measure

__all__ = ["CASES", "run"]

CASES: tuple[Case, ...] = (
    *cases_data.CASES,
    *cases_program.CASES,
    *cases_output.CASES,
    *cases_ros.CASES,
)
AT_A_TIME = 2


def run(
    rounds: int | None = None,
    *,
    quick: bool = False,
    only: str = "",
    document: str = "",
) -> FaultBench:
    """Run the cases.

    Args:
        rounds: how often, 1 unless told; every one must hold, the last one's figures are told.
        quick: a handful of cases only.
        only: cases only whose group or name has this in it.
        document: Markdown file whose table of faults is replaced.

    Raises:
        UniconError: no such case, or the document has no place for a table.
    """
    chosen = [case for case in CASES if only in case.row]
    if not chosen:
        groups = dict.fromkeys(case.group for case in CASES)
        raise UniconError(f"--only {only!r}: no such case; {alternatives(only, groups)}")
    if quick:
        chosen = [case for case in chosen if case.quick]
    missing = {name for case in chosen for name in case.needs if find_spec(name) is None}
    able = [case for case in chosen if not missing & case.needs]
    bench = FaultBench("faults", seed=0, rounds=rounds or 1)
    for _ in range(bench.rounds):
        _round(bench, able)
    if missing:
        names = ", ".join(sorted(missing))
        bench.facts[f"left out, without {names}"] = len(chosen) - len(able)
    bench.conclude([case.row for case in able])
    if document:
        write_table(bench, Path(document))
    return bench


def _round(bench: FaultBench, cases: Iterable[Case]) -> None:
    with ThreadPoolExecutor(AT_A_TIME) as pool:
        runs = {pool.submit(_measured, case): case for case in cases}
        try:
            for done in as_completed(runs):
                missed = bench.fault(runs[done], done.result())
                word = "holds" if not missed else f"MISSED: {'; '.join(missed)}"
                print(f"{runs[done].row}: {word}", file=sys.stderr, flush=True)
        except BaseException:  # Ctrl-C: those that run end by themselves
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def _measured(case: Case) -> Measured:
    with tempfile.TemporaryDirectory() as folder:
        fault_run = FaultRun(case, Path(folder))
        return measure(fault_run, fault_run.run())
