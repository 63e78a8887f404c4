"""`unicon run WORKFLOW`: builds and runs it, with or without ROS 2."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING, Any

from unicon_core.errors import UniconError
from unicon_ros.cli.workflow_arguments import add_workflow

if TYPE_CHECKING:
    from unicon_core.flow import Block
    from unicon_core.runtime import Report
    from unicon_core.workflow import Hook, Workflow

__all__ = ["add", "run"]


def add(commands: Any) -> None:
    """Add the command to the parser."""
    parser = commands.add_parser("run", help="run a workflow", description=__doc__)
    add_workflow(parser)
    parser.add_argument("--duration", type=_seconds, metavar="S", help="end after S seconds")
    parser.add_argument(
        "--speed",
        choices=("real", "max"),
        default="real",
        help="pace to the wall clock (real) or tick as fast as possible (max, simulators)",
    )
    parser.add_argument(
        "--ros",
        action=argparse.BooleanOptionalAction,
        default=None,
        help="mirror states to ROS 2 topics (default: what the workflow says, else no)",
    )
    parser.add_argument("--map", metavar="MAP", help="message map: name in config/maps/, or a path")
    parser.add_argument("--namespace", metavar="NS", help="ROS namespace")
    parser.add_argument(
        "--frame-prefix",
        metavar="PREFIX",
        default="",
        help="what stands before the names of all ROS frames, such as robot1/",
    )
    parser.add_argument("--record", metavar="FILE.mcap", help="record the states' messages")
    parser.add_argument("--trace", metavar="FILE.json", help="write every block of every tick")
    parser.add_argument("--report", metavar="FILE.json", help="write the report")
    parser.add_argument("--picture", metavar="FILE.png", help="draw path, velocities and joints")
    parser.add_argument("--view", action="store_true", help="open the simulator's viewer")
    parser.add_argument(
        "--force",
        metavar="CODE",
        action="append",
        default=[],
        help="go on with an error of `unicon check` of this code; may be repeated",
    )
    parser.add_argument("--quiet", action="store_true", help="no status line and no block table")
    parser.add_argument(
        "--ros-args",
        nargs=argparse.REMAINDER,
        default=[],
        help="everything after this goes to ROS (remaps, parameters)",
    )
    parser.set_defaults(function=run)


def run(arguments: argparse.Namespace) -> int:
    """Run the command; exit status 0 done, 3 fault."""
    # Imported here so that `unicon --help` stays fast and free of optional packages.
    from unicon_core.check import refuse_errors
    from unicon_core.runtime import Runner, RunOptions
    from unicon_core.workflow import build_workflow, load_document

    document = load_document(arguments.workflow, arguments.overrides)
    inputs: list[Hook] = []
    observers: list[Hook] = []
    with_ros = document.get("ros", bool, False) if arguments.ros is None else arguments.ros
    session: Any = None
    picture: Any = None
    if with_ros:
        from unicon_ros.bridge import RosSession

        session = RosSession(
            map=arguments.map or document.get("map", str),
            node_name="unicon",
            namespace=arguments.namespace,
            ros_args=arguments.ros_args,
            warn=_warn,
            frame_prefix=arguments.frame_prefix,
        )
        inputs.append(session.inputs)
        observers.append(session.observers)
    try:
        if arguments.record:
            from unicon_ros.recorder import recorder_hook

            map_name = arguments.map or document.get("map", str)
            observers.append(recorder_hook(arguments.record, map_name, session))
        if arguments.picture:
            from unicon_ros.picture import Picture

            picture = Picture(arguments.picture)
            observers.append(picture.hook)
        if arguments.view:
            observers.append(_viewer)
        workflow = build_workflow(document, inputs=inputs, observers=observers)
        options = RunOptions(
            duration=arguments.duration,
            speed=arguments.speed,
            warn=_warn,
            status=None if arguments.quiet or not sys.stderr.isatty() else _status,
        )
        try:
            for line in refuse_errors(workflow, arguments.force):
                _warn(line)
            runner = Runner(workflow, options)
            if session is not None:
                session.attach(runner)
        except BaseException:
            workflow.close()
            raise
        report = runner.run()
        if session is not None:
            report.bridge = session.counts()
    finally:
        if session is not None:
            session.close()
    status = _tell(arguments, report, runner)
    if picture is not None:
        picture.draw(f"{report.workflow} on {report.robot} ({report.platform})")
        print(f"picture       {arguments.picture}")
    return status


def _viewer(workflow: Workflow) -> list[Block]:
    from unicon_core.flow import as_block

    make = getattr(workflow.platform, "viewer", None)
    if make is None:
        raise UniconError(f"platform {workflow.platform.name!r} has no viewer; run without --view")
    return [as_block(make())]


def _tell(arguments: argparse.Namespace, report: Report, runner: Any) -> int:
    if not arguments.quiet:
        if sys.stderr.isatty():
            print(file=sys.stderr)
        print(runner.statistics.table(runner.workflow.period * 1e6))
        print()
    print(report.summary())
    try:
        if arguments.trace:
            runner.statistics.write_trace(arguments.trace, f"unicon {report.workflow}")
            print(f"trace         {arguments.trace} (open it in ui.perfetto.dev)")
        if arguments.record:
            print(f"recording     {arguments.record}")
        if arguments.report:
            report.write(arguments.report)
            print(f"report        {arguments.report}")
    except OSError as error:
        raise UniconError(
            f"cannot write {error.filename}: {error.strerror}; give a path in a writable folder"
        ) from error
    return 3 if report.faults else 0


def _seconds(text: str) -> float:
    value = float(text)
    if not 0.0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"{text} is no time > 0 in [s]")
    return value


def _status(values: dict[str, Any]) -> None:
    line = "  ".join(f"{key} {value}" for key, value in values.items())
    print(f"\r{line}\x1b[K", end="", file=sys.stderr, flush=True)


def _warn(message: str) -> None:
    print(f"unicon: warning: {message}", file=sys.stderr)
