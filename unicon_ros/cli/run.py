"""`unicon run WORKFLOW`: builds and runs it, with or without ROS 2."""

from __future__ import annotations

import argparse
import os
import select
import sys
import threading
import time
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from unicon_base import AnyDict, TextSink, UniconError
from unicon_base.packages import loaded
from unicon_core.non_blocking_writer import relayed_stderr
from unicon_core.page import refuse_unwritable
from unicon_core.signals import SIGNALS, Guard
from unicon_core.text_table import alarming, fitted
from unicon_ros.attachments import Asked, Attachment, File, attached, said_at_end
from unicon_ros.cli.console import Console
from unicon_ros.cli.options import RUN_OPTIONS, WORKFLOW, Adder, command

if TYPE_CHECKING:
    from unicon_core.runtime import Report, Runner
    from unicon_core.workflow import Hook
    from unicon_core.workflow.document import WorkflowDocument
    from unicon_ros.bridge import RosSession

LOOK = 0.2
"""How long Enter is waited for before the phase is looked at, in [s]."""


def run(arguments: argparse.Namespace) -> int:
    """Run the command; exit status 0 done, 3 fault."""
    # Imported here so that `unicon --help` stays fast and free of optional packages.
    from unicon_core.workflow import load_document

    document = load_document(arguments.workflow, arguments.overrides)
    if arguments.fetch is not None:
        from unicon_ros.cli.assets import fetch_for

        fetch_for(document, arguments.fetch or None)
    return run_document(arguments, document)


def run_document(arguments: argparse.Namespace, document: WorkflowDocument) -> int:
    """Run a workflow that was read, as the options say."""
    console = Console()
    # From here on a signal ends what is open, one step after the other, and is never lost.
    with ExitStack() as stays:
        try:
            with relayed_stderr(), SIGNALS.guard() as guard:
                ended = _run(arguments, document, console, guard, stays)
        finally:
            console.close()
        status = _tell(arguments, ended)
        with suppress(OSError):  # reported at the end; a page may stay for hours, and run again
            sys.stdout.flush()
        with SIGNALS.guard():
            while not SIGNALS.asked and any(each.watched() for each in ended.attachments):
                time.sleep(0.1)
    if ended.session is not None:
        close_session(ended.session, status)
    for each in ended.attachments:
        if each.again and not SIGNALS.asked:
            os.execv(sys.executable, [sys.executable, "-m", "unicon_ros", *each.again])
    return status


@dataclass(frozen=True)
class _Ended:
    """What a run leaves."""

    report: Report
    runner: Runner
    attachments: list[Attachment]
    session: Any
    lines: list[str]


def _run(
    arguments: argparse.Namespace,
    document: WorkflowDocument,
    console: Console,
    guard: Guard,
    stays: ExitStack,
) -> _Ended:
    from unicon_core.check import refuse_errors
    from unicon_core.check.check import little_seen
    from unicon_core.runtime import Runner, RunOptions
    from unicon_core.runtime.phases import never_ends
    from unicon_core.workflow import Program

    for extension in loaded("run").values():
        extension.refuse(arguments)
    map_name = arguments.map or document.get("map")
    hooks: list[Hook] = []
    session = None
    if uses_ros(arguments, document):
        session = ros_session(arguments, map_name, console.warn)
        hooks.append(session.hook)
    try:
        asked = Asked(vars(arguments), document, map_name, session, console.warn)
        attachments = attached(asked)
        for path in filter(None, (arguments.report, arguments.trace)):
            refuse_unwritable(Path(path))
        hooks += [each.hook for each in attachments]
        program = Program(document, hooks=hooks, part=arguments.part, silent=arguments.dry)
        guard.damp = program.damp_now
        shown = console.status_of(arguments)

        def status(facts: AnyDict) -> None:
            before: AnyDict = {}
            for each in attachments:
                before |= each.status()
            if shown is not None:
                shown(before | facts)

        run_options = RunOptions(
            detail=bool(arguments.trace),
            duration=arguments.duration,
            speed=arguments.speed,
            warn=console.warn,
            status=None if shown is None else status,
            operator=not arguments.yes,
            native=arguments.native,
            returns=all(each.returns for each in attachments),
        )
        with ExitStack() as closes:
            for each in attachments:
                (stays if each.stays else closes).callback(each.close)
            try:
                for line in refuse_errors(program, arguments.force):
                    console.warn(line)
                if not program.platform.facts.simulated:
                    for evidence in little_seen(program.platform.facts, program.robot):
                        if evidence.level in ("never", "stand_in"):
                            console.say(f"{evidence.kind} {evidence.name}: {evidence}")
                if arguments.speed == "max" and never_ends(program, run_options):
                    console.say(
                        f"{program.name} never ends by itself: Ctrl-C does, or --duration S"
                    )
                runner = Runner(program, run_options)
                if session is not None:
                    session.attach(runner)
                for each in attachments:
                    each.attach(runner)
                    if each.label:
                        console.say(f"{each.label}: {each.address}")
                if runner.asks:
                    _listen(runner, session is not None or any(a.drives for a in attachments))
                SIGNALS.check()
            except BaseException:
                program.close()
                raise
            report = runner.run()
            guard.damp = None
        if session is not None:
            report.bridge = session.counts()
        lines = [f"{name:<14}{text}" for name, text in said_at_end(attachments, report)]
    except BaseException:
        if session is not None:
            session.close()
        raise
    return _Ended(report, runner, attachments, session, lines)


def uses_ros(arguments: argparse.Namespace, document: WorkflowDocument) -> bool:
    """Return whether states are mirrored to ROS: as `--ros` says, else the workflow."""
    return bool(document.get("ros", False) if arguments.ros is None else arguments.ros)


def ros_session(arguments: argparse.Namespace, map_name: str | None, warn: TextSink) -> RosSession:
    """Return the node of a run, as the options say."""
    from unicon_ros.bridge import RosSession

    return RosSession(
        map=map_name,
        namespace=arguments.namespace,
        ros_args=arguments.ros_args,
        warn=warn,
        frame_prefix=arguments.frame_prefix,
    )


def _listen(runner: Runner, with_ros: bool) -> None:
    """Take the Enter key for the operator's go.

    Raises:
        UniconError: nobody could say it.
    """
    if not sys.stdin or not sys.stdin.isatty():
        if with_ros:
            return
        raise UniconError(
            f"platform {runner.program.platform.facts.name!r} is a robot, which waits for the "
            "operator's go, and standard input is not a terminal: add --yes to let it move once "
            "its gates hold, or --ros and call ~/start"
        )

    from unicon_core.runtime.phases import Phase

    moving = (Phase.APPROACH, Phase.RUN, Phase.SOFT, Phase.DAMP)

    def wait() -> None:
        with suppress(OSError):
            while runner.phase not in moving:  # then keys are the workflow's
                if not select.select([0], [], [], LOOK)[0]:
                    continue
                if not os.read(0, 1024):
                    return
                if not runner.go() and runner.waits_for:
                    runner.options.warn(f"not yet: it waits for {runner.waits_for}")

    threading.Thread(target=wait, name="operator", daemon=True).start()


def close_session(session: Any, status: int) -> None:
    """Take ROS down, after all is written and told: it may fail or never end."""
    from unicon_ros.process_exit import exit_watchdog

    try:
        with exit_watchdog(status):
            session.close()
    except Exception as error:
        with suppress(OSError):
            line = f"unicon: warning: closing ROS failed: {type(error).__name__}: {error}"
            print(line, file=sys.stderr)


def _tell(arguments: argparse.Namespace, ended: _Ended) -> int:
    """Write the files, then print; a fault stays a fault whatever becomes of the output."""
    report, runner = ended.report, ended.runner
    status = 3 if report.faults else 0
    written, problems = _write(arguments, ended)
    try:
        lines = fitted("\n".join([report.summary(), *written])).split("\n")
        alarms = ("faults ",) * bool(report.faults) + ("base ",) * bool(report.fell)
        print("\n".join(alarming(e, sys.stdout) if e.startswith(alarms) else e for e in lines))
        if arguments.verbose:
            print(f"\n{runner.statistics.table(runner.program.period * 1e6)}")
    except BrokenPipeError:
        pass  # the reader has gone
    except OSError as error:
        problems.append(f"cannot write to standard output: {error.strerror}")
    with suppress(OSError):
        if report.traceback and not arguments.report:
            print(report.traceback, end="", file=sys.stderr)
        for problem in problems:
            print(f"unicon: error: {problem}", file=sys.stderr)
    return status or int(bool(problems))


def _write(arguments: argparse.Namespace, ended: _Ended) -> tuple[list[str], list[str]]:
    """Write trace, report and what else goes with the run; return lines, and what went wrong."""
    report, runner = ended.report, ended.runner
    written: list[str] = []
    problems: list[str] = []
    trace = partial(runner.statistics.write_trace, arguments.trace, f"unicon {report.workflow}")
    files: dict[str, File] = {
        "trace": ("trace", arguments.trace, trace),
        "report": ("report", arguments.report, partial(report.write, arguments.report)),
    }
    # A page takes the place of the JSON.
    files |= {file[0]: file for each in ended.attachments for file in each.files(report) if file[1]}
    for name, path, write in files.values():
        if not path:
            continue
        if path.endswith(".html") and sys.stderr.isatty():  # its pictures take seconds
            print(f"unicon: writing {path}", file=sys.stderr)
        try:
            write()
            hint = " (open it in ui.perfetto.dev)" if name == "trace" else ""
            written.append(f"{name:<14}{path}{hint}")
        except OSError as error:
            problems.append(
                f"cannot write {error.filename or path}: {error.strerror}; give a path in a "
                "writable folder"
            )
        except UniconError as error:
            problems.append(str(error))
    return [*written, *ended.lines], problems


def run_options() -> list[Adder]:
    """Return how a workflow runs, with what other packages add."""
    return [*RUN_OPTIONS, *(o for each in loaded("run").values() for o in each.OPTIONS)]


add = command("run", run, "run a workflow", __doc__, *WORKFLOW, *run_options())
