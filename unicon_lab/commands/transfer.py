"""`unicon transfer WORKFLOW`: runs it in several simulators, and compares them as a table."""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from unicon_base import AnyDict, UniconError, cannot
from unicon_core.signals import SIGNALS
from unicon_ros.cli.console import Console, note
from unicon_ros.cli.options import WORKFLOW, argument, command, positive, whole

if TYPE_CHECKING:
    from unicon_lab.transfer.results import Results
    from unicon_lab.transfer.rollout import Plan

TIMEOUT = 600.0
"""Wall time in [s] that a run may take, the compilation of an engine included."""
MOST_SEEDS = 1000
BAR = 24
"""Characters of the progress bar."""
EVERY = 0.2
"""Time in [s] between two looks of it."""
JSON = "transfer.json"
BAD = {"crashed", "timeout", "fault"}
"""Outcomes of which the exit status tells."""


def _transfer(arguments: argparse.Namespace) -> int:
    """Run the command.

    Exit status: 0; 1 where no simulator could be run; 3 where a run ended with a fault, in a crash
    or not at all.
    """
    from unicon_lab.transfer.rollout import make_plan

    plan = make_plan(
        arguments.workflow,
        arguments.overrides,
        arguments.platforms,
        arguments.seeds,
        arguments.duration,
        arguments.timeout,
    )
    if arguments.out is None:
        with tempfile.TemporaryDirectory(prefix="unicon_transfer_") as folder:
            return _run(plan, Path(folder), None)
    return _run(plan, *_new_folder(arguments.out))


def _new_folder(text: str) -> tuple[Path, Path]:
    """Return the folder and the JSON in it, which is there from now on and was not before."""
    from unicon_core.drawing import require

    require("unicon transfer --out")
    folder = Path(text)
    if not text:  # as of a variable that is not set
        raise UniconError("--out has no name; give a folder")
    with cannot(f"write in {folder}", "give another to --out"):
        try:
            folder.mkdir(parents=True, exist_ok=True)
            (folder / JSON).touch(exist_ok=False)
        except FileExistsError as error:
            what = "has a transfer already" if folder.is_dir() else "is not a folder"
            raise UniconError(f"{folder} {what}; give another to --out") from error
    return folder, folder / JSON


def _run(plan: Plan, folder: Path, out: Path | None) -> int:
    from unicon_lab.transfer.results import Results, table

    results = Results(plan, folder)
    console = Console()
    with SIGNALS.guard():
        try:
            _all_runs(results, console, out)
        finally:
            console.close()
        result = results.to_json()
        problem = _write(result, out)
    left_out = ", ".join(results.left_out())
    if not result["platforms"]:
        raise UniconError(
            f"no simulator is installed; --platforms {left_out.replace(' ', '')} tells how each is"
        )
    if left_out:
        note(
            f"unicon transfer: not installed, so left out: {left_out} (--platforms tells how each "
            "is installed)"
        )
    print(table(result))
    if problem:
        raise UniconError(problem)
    if out is not None:
        from unicon_lab.transfer.report import write_report

        print(f"\nreport  {write_report(result, folder)}")
    SIGNALS.check()
    if not BAD.isdisjoint(each["outcome"] for each in result["platforms"]):
        return 3
    return 0 if any(each["runs_done"] for each in result["platforms"]) else 1


def _bar(console: Console, plan: Plan, done: int, name: str) -> Callable[[float], None]:
    """Return what shows the progress of one run, on a terminal alone.

    It takes how many seconds are simulated by now; 0 as long as the engine is made ready.

    Args:
        console: that shows it.
        plan: of the transfer.
        done: runs before it.
        name: of the run.
    """
    whole = len(plan.seeds) * len(plan.platforms)
    began = time.monotonic()

    def show(seconds: float) -> None:
        if not console.due(EVERY):
            return
        full = round(BAR * (done + min(seconds / plan.longest, 1.0)) / whole)
        doing = f"{seconds:.1f} s simulated" if seconds else "starting"
        what = f"[{'#' * full}{'.' * (BAR - full)}] {done}/{whole}"
        console.status({what: f" {name}: {doing}, {time.monotonic() - began:.0f} s"})

    return show


def _all_runs(results: Results, console: Console, out: Path | None) -> None:
    """Run all."""
    from unicon_lab.transfer.rollout import run_one

    plan = results.plan
    _write(results.to_json(), out)  # whatever happens, it can be read
    for row in plan.rows():
        platform, seed = row.values
        if results.hopeless(platform):
            continue
        bar = _bar(console, plan, row.index, f"{platform}, seed {seed}")
        run = run_one(plan, row, results.folder / "runs", bar)
        results.add(platform, run)
        if run["outcome"] == "interrupted":
            results.interrupted = True
            return
        _write(results.to_json(), out)


def _write(result: AnyDict, out: Path | None) -> str:
    """Write what there is so far; return what went wrong: a full disk ends no run."""
    if out is None:
        return ""
    from unicon_core.page import write_json

    try:
        write_json(out, result)
    except UniconError as error:
        return str(error)
    return ""


add = command(
    "transfer",
    _transfer,
    "run a workflow in several simulators and compare",
    __doc__,
    *WORKFLOW,
    argument(
        "--platforms",
        "A,B,…",
        "simulators; the others are compared with the first (default: all that are installed)",
    ),
    argument(
        "--seeds",
        "N",
        "runs of each platform, with N seeds of the scene's noise and pushes (default: 3; 1 "
        "where the scene has neither)",
        type=whole("a number", 1, MOST_SEEDS),
    ),
    argument("--duration", "S", "end each run after S s", type=positive),
    argument(
        "--timeout",
        "S",
        f"end a run that takes S s of wall time (default: {TIMEOUT:g})",
        type=positive,
        default=TIMEOUT,
    ),
    argument("--out", "DIR", "new folder for transfer.json, report.html and the runs"),
)
