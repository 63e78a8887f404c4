"""`unicon preflight WORKFLOW`: looks at the live robot, sends nothing; pass or fail, with remedy.

It opens the platform to receive only. With `--wiggle` it then moves each joint a little, after an
explicit yes, to prove order and signs: the robot hangs on a gantry or lies.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from unicon_base import AnyDict, CheckError, Fault, UniconError
from unicon_core.latches import clearing
from unicon_core.signals import SIGNALS
from unicon_ros.cli.console import print_table, warn
from unicon_ros.cli.options import MAP, WORKFLOW, argument, command, flag, option, positive
from unicon_ros.cli.run import uses_ros

if TYPE_CHECKING:
    from unicon_core.preflight.look import PreflightResult
    from unicon_core.workflow import Program
    from unicon_core.workflow.document import WorkflowDocument

SHORTEST = 1.0
"""Of `--seconds`: the gates look at half a second, and at a whole one for what is frozen."""
LONGEST = 600.0

QUESTION = (
    "Every joint of robot {robot} will move by {angle:g} rad, one after the other. It hangs on a "
    "gantry or lies, and nobody is near it. Type yes to go on: "
)


def preflight(arguments: argparse.Namespace) -> int:
    """Run the command; exit status 0 all in order, 1 something fails, 3 fault."""
    # Imported here so that `unicon --help` stays fast and free of optional packages.
    from unicon_core.preflight.look import PreflightResult
    from unicon_core.preflight.wiggle import LARGEST, SMALLEST
    from unicon_core.workflow import load_document

    if not SMALLEST <= arguments.angle <= LARGEST:
        raise UniconError(f"--angle {arguments.angle:g}: give {SMALLEST:g} to {LARGEST:g}")
    if not SHORTEST <= arguments.seconds <= LONGEST:
        raise UniconError(f"--seconds {arguments.seconds:g}: give {SHORTEST:g} to {LONGEST:g}")
    document = load_document(arguments.workflow, arguments.overrides)
    result = _looked(arguments, document)
    print(result.text(), flush=True)
    told = result.to_dict()
    status = 3 if result.fault else 0 if result.ok else 1
    if arguments.wiggle and status:
        print("\nno joint is moved before all of this passes")
    elif arguments.wiggle:
        status = _wiggle(arguments, document, told)
    if arguments.json:
        PreflightResult.write(told, arguments.json)
    return status


@contextmanager
def _opened(document: WorkflowDocument, **options: Any) -> Iterator[Program]:
    """Build a program, which a second signal damps and the end of the block closes."""
    from unicon_core.workflow import Program

    with SIGNALS.guard() as guard:
        program = Program(document, **options)
        guard.damp = program.damp_now
        program.warn = warn
        try:
            yield program
        finally:
            program.close()
            guard.damp = None


def _looked(arguments: argparse.Namespace, document: WorkflowDocument) -> PreflightResult:
    from unicon_core.preflight.look import look

    session: Any = None
    if uses_ros(arguments, document):
        from unicon_ros.bridge import RosSession

        session = RosSession(map=arguments.map or document.get("map"), warn=warn)
    try:
        hooks = [] if session is None else [session.hook]
        with _opened(document, hooks=hooks, silent=True) as program:
            result = look(program, arguments.seconds)
            _static(program, result)
            _latched(document, program, result)
            if session is not None:
                _estop(session, program, result)
    finally:
        if session is not None:
            session.close()
    return result


def _static(program: Program, result: PreflightResult) -> None:
    """What `unicon run` would refuse, and what it would tell at its start."""
    from unicon_core.check import refuse_errors
    from unicon_core.check.check import little_seen

    try:
        told = refuse_errors(program)
    except CheckError as error:
        for finding in error.findings:
            result.add("check", False, finding)
        return
    result.add("check", True, "no error that a run would refuse")
    for line in told:
        result.add("check", None, line)
    for evidence in little_seen(program.platform.facts, program.robot):
        result.add("evidence", None, f"{evidence.kind} {evidence.name}: {evidence}")


def _latched(document: WorkflowDocument, program: Program, result: PreflightResult) -> None:
    """Whether an emergency stop keeps the robots from being driven."""
    from unicon_core.latches import of_robot
    from unicon_core.workflow.platforms import latch_keys

    for key in latch_keys(document, program.robot):
        found = of_robot(key)
        said = "none is latched" if found is None else f"latched: {found.reason} ({found.at})"
        remedy = "" if found is None else f"; when it is safe: {clearing(found.robot)}"
        result.add("estop", found is None, f"robot {key}: {said}{remedy}")


def _estop(session: Any, program: Program, result: PreflightResult) -> None:
    node = session.node.get_fully_qualified_name()
    if not program.platform.facts.simulated:
        session.estop.keep()  # as a run does
    told = "somebody presses it; let go, then call ~/clear_estop"
    if session.estop.restored:
        told = f"latched since {session.estop.restored}; when it is safe: {clearing(node)}"
    latched = bool(session.estop.refusal())
    result.add("estop", not latched, f"{node}/estop: {told if latched else 'not pressed'}")


def _wiggle(arguments: argparse.Namespace, document: WorkflowDocument, told: AnyDict) -> int:
    """Move each joint and tell what followed; exit status."""
    from unicon_core.preflight.look import look
    from unicon_core.preflight.wiggle import verdicts, wiggle

    if not arguments.yes and not _agreed(str(told["robot"]), arguments.angle):
        print("no joint was moved")
        return 1
    try:
        with _opened(document) as program:
            again = look(program, SHORTEST)  # the yes may have taken its time
            if not again.ok:
                print(again.text())
                return 3 if again.fault else 1
            moved = wiggle(program, arguments.angle)
    except Fault as fault:
        print(f"fault: {fault}; the platform damped")
        told["fault"] = str(fault)
        return 3
    heads = ("moved", "followed", "by", "share", "verdict")
    print()
    print_table([heads, *verdicts(moved, arguments.angle)], underlined=True)
    told["wiggle"] = [{**vars(each), "wrong": each.wrong} for each in moved]
    SIGNALS.check()
    return int(any(each.wrong for each in moved))


def _agreed(robot: str, angle: float) -> bool:
    """Ask on the terminal.

    Raises:
        UniconError: there is none.
    """
    if not sys.stdin.isatty():
        raise UniconError(
            "--wiggle moves the robot and asks on the terminal, and standard input is none; give "
            "--yes if the robot hangs or lies and nobody is near it"
        )
    return input(QUESTION.format(robot=robot, angle=angle)).strip().lower() == "yes"


add = command(
    "preflight",
    preflight,
    "look at the live robot, sending nothing",
    __doc__,
    *WORKFLOW,
    argument("--seconds", "S", "receive for S seconds (3)", type=positive, default=3.0),
    option(
        "--ros",
        action=argparse.BooleanOptionalAction,
        default=None,
        help="also open the node of a run, with its topics and ~/estop (default: what the "
        "workflow says, else no)",
    ),
    MAP,
    argument("--json", "FILE", "write all of it as JSON"),
    flag("--wiggle", "then move each joint a little, after a yes"),
    argument("--angle", "RAD", "of these moves (0.05)", type=positive, default=0.05),
    flag("--yes", "do not ask before them"),
)
