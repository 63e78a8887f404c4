"""`unicon run WORKFLOW`: builds and runs it, with or without ROS 2."""

from __future__ import annotations

import argparse
import sys
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from unicon_core.errors import UniconError
from unicon_core.outlet import relayed_stderr
from unicon_core.page import refuse_unwritable
from unicon_core.signals import SIGNALS, Guard
from unicon_ros.cli.console import Console
from unicon_ros.cli.operator import listen
from unicon_ros.cli.run_options import add_options
from unicon_ros.cli.workflow_arguments import (
    add_workflow,
    view_options,
)
from unicon_ros.view import LOCAL

if TYPE_CHECKING:
    from unicon_core.flow import Block, Stage
    from unicon_core.runtime import Report, Runner
    from unicon_core.workflow import Hook, Program
    from unicon_core.workflow.document import WorkflowDocument


def add(commands: Any) -> None:
    """Add the command to the parser."""
    parser = commands.add_parser("run", help="run a workflow", description=__doc__)
    add_workflow(parser)
    add_options(parser)
    parser.set_defaults(function=run)


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
    try:
        with relayed_stderr(), SIGNALS.guard() as guard:
            ended = _run(arguments, document, console, guard)
    finally:
        console.close()
    status = _tell(arguments, ended)
    if ended.session is not None:
        close_session(ended.session, status)
    return status


@dataclass(frozen=True)
class _Ended:
    """What a run leaves."""

    report: Report
    runner: Runner
    pictured: Any
    recording: Any
    session: Any
    fault: Path | None


def _run(
    arguments: argparse.Namespace, document: WorkflowDocument, console: Console, guard: Guard
) -> _Ended:
    from unicon_core.check import refuse_errors
    from unicon_core.check.seen import little_seen
    from unicon_core.runtime import Runner, RunOptions
    from unicon_core.runtime.options import never_ends
    from unicon_core.workflow import Program
    from unicon_ros.fault_record import FaultRecord

    hooks: list[Hook] = []
    with_ros = document.get("ros", False) if arguments.ros is None else arguments.ros
    session: Any = None
    pictured: Any = None
    recording: Any = None
    view: Any = None
    metered: Any = None
    if with_ros:
        from unicon_ros.bridge import RosSession

        session = RosSession(
            map=arguments.map or document.get("map"),
            node_name="unicon",
            namespace=arguments.namespace,
            ros_args=arguments.ros_args,
            warn=console.warn,
            frame_prefix=arguments.frame_prefix,
        )
        hooks.append(session.hook)
    try:
        if arguments.record == "":  # as of a variable that is not set
            raise UniconError("--record has no name; give FILE.mcap or FOLDER/")
        if arguments.record_split and not arguments.record:
            raise UniconError("--record-split goes with --record FOLDER/; add it")
        if arguments.record_frames and not arguments.record:
            raise UniconError("--record-frames goes with --record FILE.mcap; add it")
        if arguments.record_jpeg and not arguments.record_frames:
            raise UniconError("--record-jpeg goes with --record-frames all; add it")
        if arguments.record:
            from unicon_ros.run_recording import Recording, names_in

            map_name = arguments.map or document.get("map")
            patient = arguments.speed == "max"
            recording = Recording(
                arguments.record,
                map_name,
                session,
                console.warn,
                patient,
                arguments.record_split,
                arguments.namespace or "",
                arguments.frame_prefix,
                names_in(arguments.record_frames),
                arguments.record_jpeg,
            )
            hooks.append(recording.hook)
        for path in filter(None, (arguments.report, arguments.picture, arguments.trace)):
            refuse_unwritable(Path(path))
        with_page = bool(arguments.report) and arguments.report.lower().endswith(".html")
        if arguments.picture or with_page:
            from unicon_ros.report.run_page import Pictured

            pictured = Pictured(arguments.picture, arguments.report if with_page else "")
            hooks.append(pictured.hook)
        if arguments.view == "window":
            hooks.append(_window)
        elif arguments.view:
            from unicon_ros.view.view import View

            view = View(
                view_options(arguments),
                session,
                arguments.map or document.get("map"),
                arguments.frame_prefix,
                console.warn,
            )
            view.declare(document)
            hooks.append(view.hook)
        elif arguments.view_token or arguments.view_host != LOCAL:
            raise UniconError("--view-host and --view-token go with --view; add it")
        if arguments.metrics is not None:
            from unicon_ros.view.metered import Metered

            metered = Metered(arguments.metrics, session, console.warn)
            hooks.append(metered.hook)
        record = FaultRecord(arguments.faults, console.warn, recording)
        hooks.append(record.hook)  # the last one: it looks behind the others
        program = Program(document, hooks=hooks, part=arguments.part, silent=arguments.dry)
        guard.damp = program.damp_now
        options = RunOptions(
            detail=bool(arguments.trace),
            duration=arguments.duration,
            speed=arguments.speed,
            warn=console.warn,
            status=None if arguments.quiet or not console.terminal else console.status,
            operator=not arguments.yes,
        )
        try:
            for line in refuse_errors(program, arguments.force):
                console.warn(line)
            if not program.platform.facts.simulated:
                for evidence in little_seen(program.platform.facts, program.robot):
                    if evidence.level in ("never", "stand_in"):
                        console.say(f"{evidence.kind} {evidence.name}: {evidence}")
            if arguments.speed == "max" and never_ends(program, options):
                console.say(f"{program.name} never ends by itself: Ctrl-C does, or --duration S")
            runner = Runner(program, options)
            if session is not None:
                session.attach(runner)
            if view is not None:
                view.attach(runner)
                console.say(f"view: {view.address}")
            if metered is not None:
                metered.attach(runner)
                console.say(f"metrics: {metered.address}")
            if runner.asks:
                listen(runner, session is not None or view is not None)
            record.attach(runner)
            if pictured is not None:
                pictured.attach(runner)
            SIGNALS.check()
        except BaseException:
            program.close()
            raise
        report = runner.run()
        guard.damp = None
        for each in (view, metered):
            if each is not None:
                each.close()
        if session is not None:
            report.bridge = session.counts()
        if recording is not None:
            report.extra["recording"] = recording.counts()
        fault = record.write(report)
        if fault is not None:
            report.extra["fault_record"] = str(fault)
    except BaseException:
        for each in (view, metered):
            if each is not None:
                each.close()
        if session is not None:
            session.close()
        raise
    return _Ended(report, runner, pictured, recording, session, fault)


def close_session(session: Any, status: int) -> None:
    """Take ROS down, after all is written and told: it may fail or never end."""
    from unicon_ros.ending import exits_within

    try:
        with exits_within(status):
            session.close()
    except Exception as error:
        with suppress(OSError):
            line = f"unicon: warning: closing ROS failed: {type(error).__name__}: {error}"
            print(line, file=sys.stderr)


def _window(program: Program) -> dict[Stage, list[Block]]:
    from unicon_core.flow import Stage, as_block
    from unicon_core.platforms.platform import Viewable

    platform = program.platform
    if not isinstance(platform, Viewable):
        raise UniconError(f"platform {platform.facts.name!r} has no window; give --view alone")
    return {Stage.OBSERVE: [as_block(platform.viewer())]}


def _tell(arguments: argparse.Namespace, ended: _Ended) -> int:
    """Write the files, then print; a fault stays a fault whatever becomes of the output."""
    report, runner = ended.report, ended.runner
    status = 3 if report.faults else 0
    written, problems = _write(arguments, ended)
    try:
        if not arguments.quiet:
            print(runner.statistics.table(runner.program.period * 1e6))
            print()
        print("\n".join([report.summary(), *written]))
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
    """Write trace, report and picture; return a line for each, and what went wrong."""
    report, runner = ended.report, ended.runner
    written: list[str] = []
    problems: list[str] = []
    told = partial(report.write, arguments.report)
    if ended.pictured is not None and ended.pictured.page is not None:
        told = partial(ended.pictured.page.write, report)
    trace = partial(runner.statistics.write_trace, arguments.trace, f"unicon {report.workflow}")
    for name, path, write, hint in (
        ("trace", arguments.trace, trace, " (open it in ui.perfetto.dev)"),
        ("report", arguments.report, told, ""),
        ("picture", arguments.picture, lambda: ended.pictured.draw(report), ""),
    ):
        if not path:
            continue
        if path.endswith(".html") and sys.stderr.isatty():  # its pictures take seconds
            print(f"unicon: writing {path}", file=sys.stderr)
        try:
            write()
            written.append(f"{name:<14}{path}{hint}")
        except OSError as error:
            problems.append(
                f"cannot write {error.filename or path}: {error.strerror}; give a path in a "
                "writable folder"
            )
        except UniconError as error:
            problems.append(str(error))
    if ended.fault is not None:
        written.append(f"fault record  {ended.fault}")
    if ended.recording is not None:
        written.append(f"recording     {ended.recording.summary()}")
    return written, problems
