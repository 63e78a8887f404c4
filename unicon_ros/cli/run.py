"""`unicon run WORKFLOW`: builds and runs it, with or without ROS 2."""

from __future__ import annotations

import argparse
import os
import select
import sys
import threading
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from unicon_core.errors import UniconError
from unicon_core.outlet import relayed_stderr
from unicon_core.page import refuse_unwritable
from unicon_core.signals import SIGNALS, Guard
from unicon_ros.cli.console import Console
from unicon_ros.cli.options import (
    RUN_OPTIONS,
    WORKFLOW,
    command,
    view_options,
)
from unicon_ros.view import LOCAL

if TYPE_CHECKING:
    from collections.abc import Callable

    from unicon_core.flow import Block, Stage
    from unicon_core.runtime import Report, Runner
    from unicon_core.workflow import Hook, Program
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
    from unicon_core.check.files import little_seen
    from unicon_core.runtime import Runner, RunOptions
    from unicon_core.runtime.options import never_ends
    from unicon_core.workflow import Program
    from unicon_ros.fault_record import FaultRecord

    _refuse_wrong_use(arguments)
    map_name = arguments.map or document.get("map")
    hooks: list[Hook] = []
    viewers: dict[str, Any] = {}
    session = pictured = recording = None
    if uses_ros(arguments, document):
        session = ros_session(arguments, map_name, console.warn)
        hooks.append(session.hook)
    try:
        if arguments.record:
            from unicon_ros.run_recording import Recording, names_in

            recording = Recording(
                arguments.record,
                map_name,
                session,
                console.warn,
                arguments.speed == "max",
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

            options = view_options(arguments)
            view = View(options, session, map_name, arguments.frame_prefix, console.warn)
            view.declare(document)
            viewers["view"] = view
        if arguments.metrics is not None:
            from unicon_ros.view.view import Metered

            viewers["metrics"] = Metered(arguments.metrics, session, console.warn)
        record = FaultRecord(arguments.faults, console.warn, recording)
        # The record is the last one: it looks behind the others.
        hooks += [*(each.hook for each in viewers.values()), record.hook]
        program = Program(document, hooks=hooks, part=arguments.part, silent=arguments.dry)
        guard.damp = program.damp_now
        run_options = RunOptions(
            detail=bool(arguments.trace),
            duration=arguments.duration,
            speed=arguments.speed,
            warn=console.warn,
            status=console.status_of(arguments),
            operator=not arguments.yes,
        )
        with ExitStack() as shown:
            for each in viewers.values():
                shown.callback(each.close)
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
                for name, viewer in viewers.items():
                    viewer.attach(runner)
                    console.say(f"{name}: {viewer.address}")
                if runner.asks:
                    _listen(runner, session is not None or "view" in viewers)
                record.attach(runner)
                if pictured is not None:
                    pictured.attach(runner)
                SIGNALS.check()
            except BaseException:
                program.close()
                raise
            report = runner.run()
            guard.damp = None
        if session is not None:
            report.bridge = session.counts()
        if recording is not None:
            report.extra["recording"] = recording.counts()
        fault = record.write(report)
        if fault is not None:
            report.extra["fault_record"] = str(fault)
    except BaseException:
        if session is not None:
            session.close()
        raise
    return _Ended(report, runner, pictured, recording, session, fault)


def _refuse_wrong_use(arguments: argparse.Namespace) -> None:
    """Refuse options that go with others, which are not given."""
    if arguments.record == "":  # as of a variable that is not set
        raise UniconError("--record has no name; give FILE.mcap or FOLDER/")
    alone = bool(arguments.view_token) or arguments.view_host != LOCAL
    for option, given, whole, needed in (
        ("--record-split", arguments.record_split, "--record FOLDER/", arguments.record),
        ("--record-frames", arguments.record_frames, "--record FILE.mcap", arguments.record),
        ("--record-jpeg", arguments.record_jpeg, "--record-frames all", arguments.record_frames),
        ("--view-host and --view-token", alone, "--view", arguments.view),
    ):
        if given and not needed:
            verb = "go" if " " in option else "goes"
            raise UniconError(f"{option} {verb} with {whole}; add it")


def uses_ros(arguments: argparse.Namespace, document: WorkflowDocument) -> bool:
    """Return whether states are mirrored to ROS: as `--ros` says, else the workflow."""
    return bool(document.get("ros", False) if arguments.ros is None else arguments.ros)


def ros_session(
    arguments: argparse.Namespace, map_name: str | None, warn: Callable[[str], None]
) -> RosSession:
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
    if ended.pictured is not None and ended.pictured.page:
        told = partial(ended.pictured.write, report)
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


add = command(
    "run",
    run,
    "run a workflow",
    __doc__,
    *WORKFLOW,
    *RUN_OPTIONS,
)
