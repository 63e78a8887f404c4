"""`unicon sweep SWEEP.yaml`: runs a workflow thousands of times, each time a little otherwise.

`unicon sweep report FOLDER` writes the report anew, `unicon sweep compare A B` compares two.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import TYPE_CHECKING

from unicon_base import MissingDependencyError, UniconError
from unicon_core.signals import SIGNALS
from unicon_ros.cli.console import Console, note, warn
from unicon_ros.cli.options import FORCE, OVERRIDES, REPEATED, argument, command, flag, whole

if TYPE_CHECKING:
    from unicon_lab.sweep.engines import Wish
    from unicon_lab.sweep.folder import Folder
    from unicon_lab.sweep.plan import Plan
    from unicon_lab.sweep.results import Results
    from unicon_lab.sweep.sweep_file import Gate

MOST_WORKERS = 1024
EVERY = 0.5
"""Time in [s] between two status lines."""
SHOWN = 5
"""Rows that `--dry` shows."""


def _sweep(arguments: argparse.Namespace) -> int:
    """Run the command.

    Exit status: 0; 1 where a gate is broken, or for bad input; 3 where a row has no result.
    """
    from unicon_lab.sweep.results import Results
    from unicon_lab.sweep.sweep_file import read_gate

    what, gates = arguments.what, [read_gate(text) for text in arguments.gate]
    if what[0] == "report" and len(what) == 2:
        return _ended(Results(Path(what[1])), gates)
    if what[0] == "compare" and len(what) == 3:
        from unicon_lab.sweep.report import comparison

        print(comparison(Results(Path(what[1])), Results(Path(what[2]))))
        return 0
    if len(what) != 1:
        raise UniconError(
            f"sweep: {' '.join(what)!r} is not a sweep; write SWEEP.yaml, report FOLDER, or "
            "compare A B"
        )
    return _run(arguments, gates)


def _run(arguments: argparse.Namespace, gates: list[Gate]) -> int:
    from unicon_lab.sweep.engines import Wish, require_ray
    from unicon_lab.sweep.folder import Folder, require_pyarrow
    from unicon_lab.sweep.plan import Plan
    from unicon_lab.sweep.results import Results
    from unicon_lab.sweep.sweep_file import read_sweep

    sweep = read_sweep(arguments.what[0], arguments.overrides)
    engine = arguments.engine or sweep.said.engine
    wish = Wish(engine, arguments.workers, arguments.batch, arguments.address)
    for gate in gates:
        gate.check([each.path for each in sweep.parameters])
    if sweep.keep and engine == "ray":  # rows run on other machines
        raise UniconError(
            f"{sweep.path}: keep is of engine local or batch; take it out, or --engine local"
        )
    plan = Plan(sweep)
    program = _checked(plan, arguments.force)
    if arguments.dry:
        print(_dry(plan))
        return 0
    require_pyarrow()
    if engine == "ray":
        require_ray()
    out = Path(arguments.out or f"{sweep.path.stem}.sweep")
    folder = Folder(out, plan, program)
    console = Console()
    try:
        with SIGNALS.guard():
            _rows(plan, folder, wish, console)
            folder.flush()
    finally:
        console.close()
        folder.close()
    status = _ended(Results(out), [*sweep.gates, *gates])
    if SIGNALS.asked:
        note("unicon sweep: run the same command again to go on")
    SIGNALS.check()
    return status


def _checked(plan: Plan, force: list[str]) -> str:
    """Refuse what `unicon check` calls an error; return the hash of the first row's program."""
    from unicon_core.check import refuse_errors
    from unicon_core.workflow import Program
    from unicon_lab.analysis.run import read_run
    from unicon_lab.sweep.figures import columns_of, reference_for
    from unicon_lab.sweep.worker import program_sha256

    program = Program(plan.document)
    try:
        for line in refuse_errors(program, force):
            warn(line)
        columns_of(program.states, plan.sweep.keep)
        if plan.sweep.reference is not None:
            reference_for(read_run(plan.sweep.reference), program.robot, program.period)
        return program_sha256(program)
    finally:
        program.close()


def _dry(plan: Plan) -> str:
    """Return what would be run."""
    sweep = plan.sweep
    sample, repeat = sweep.said.sample, sweep.said.repeat
    repeated = f", {repeat} times each" if repeat > 1 else ""
    lines = [
        f"{plan.document.name}: {len(plan)} rollouts of {plan.duration:g} s at most: {sample}"
        f" of {sweep.points} points{repeated}",
        *(f"  {each.path}: {each.words}" for each in sweep.parameters),
        f"SHA-256 {plan.sha256}",
    ]
    shown = range(min(SHOWN, len(plan)))
    lines += [f"row {index}: {' '.join(plan.row(index).settings)}" for index in shown]
    if len(plan) > SHOWN:
        lines.append(f"… and {len(plan) - SHOWN} more")
    return "\n".join(lines)


def _rows(plan: Plan, folder: Folder, wish: Wish, console: Console) -> None:
    """Run what is not done yet."""
    from unicon_lab.sweep.engines import engine_of

    todo = (row for row in plan if row.index not in folder.done)
    left = len(plan) - len(folder.done)
    if not left:
        return
    if folder.done:
        console.say(f"{len(folder.done)} of {len(plan)} rollouts are done; going on")
    engine = engine_of(plan, wish, left, folder.path)
    began, fell, why_not = time.monotonic(), 0, ""
    try:
        for done, result in enumerate(engine.run(todo), 1):
            folder.know(result.facts)
            folder.add(result.index, result.figures)
            fell += bool(result.figures.get("fell"))
            if result.why_not not in ("", why_not):
                why_not = result.why_not
                console.say(f"each rollout is built anew, some 60 ms: {why_not}")
            if console.due(EVERY):
                rate = done / max(time.monotonic() - began, 1e-9)
                there = f"{len(plan) - left + done}/{len(plan)}"
                rest = f"{(left - done) / rate:.0f} s"
                console.status({there: f"{rate:.1f}/s", "fell": fell, "left": rest})
    finally:
        engine.close()


def _ended(results: Results, gates: list[Gate]) -> int:
    """Print the summary, write the report, ask the gates; return the exit status."""
    from unicon_lab.sweep.report import summary

    print(summary(results))
    try:
        from unicon_lab.sweep.report import write_report

        print(f"report {write_report(results)}")
    except MissingDependencyError as error:
        warn(f"no report: {error}")
    for gate in gates:
        print(results.verdict(gate))
    if not all(results.holds(gate) for gate in gates):
        return 1
    return 3 if results.failed else 0


add = command(
    "sweep",
    _sweep,
    "run a workflow thousands of times, varied",
    __doc__,
    argument(
        "what",
        "SWEEP.yaml | report FOLDER | compare A B",
        "a sweep to run or to go on with; or what to do with folders of sweeps",
        nargs="+",
    ),
    OVERRIDES,
    argument("--out", "DIR", "folder of the results (default: NAME.sweep, here)"),
    argument(
        "--workers",
        "N",
        "processes (default: one for each core)",
        type=whole("a number", 1, MOST_WORKERS),
    ),
    argument(
        "--engine",
        "NAME",
        "local (processes here), batch (several rows side by side in each) or ray (a "
        "cluster); the file's unless told, else local",
    ),
    argument(
        "--address",
        "HOST:PORT",
        "head node of a Ray cluster to join (default: a Ray of its own, here)",
        default="",
    ),
    argument(
        "--batch",
        "N",
        "rows side by side in each process, with --engine batch (default: 4)",
        type=whole("a number", 1, MOST_WORKERS),
    ),
    argument(
        "--gate",
        "CONDITION",
        "exit 1 where it does not hold, such as 'fall<0.01' (repeatable)",
        **REPEATED,
    ),
    FORCE,
    flag("--dry", "tell what would be run"),
)
