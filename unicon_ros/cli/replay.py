"""`unicon replay BAG [WORKFLOW]`: recorded sensors drive a workflow; or compares, or plays."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from functools import partial
from typing import Any

from unicon_core.errors import UniconError
from unicon_ros.cli.run import close_session, run_document
from unicon_ros.cli.run_options import add_options
from unicon_ros.cli.workflow_arguments import add_overrides, positive


def add(commands: Any) -> None:
    """Add the command to the parser."""
    parser = commands.add_parser("replay", help="run a recording again", description=__doc__)
    parser.add_argument("bag", metavar="BAG", help="record of a fault, or recording of a run")
    parser.add_argument(
        "workflow",
        nargs="?",
        metavar="WORKFLOW",
        help="name in config/workflows/, or a path (default: the recorded one)",
    )
    add_overrides(parser)
    form = parser.add_mutually_exclusive_group()
    form.add_argument(
        "--verify",
        action="store_true",
        help="compare every state of every tick with the recorded; exit status 1 where one differs",
    )
    form.add_argument(
        "--play",
        action="store_true",
        help="publish the recorded states to ROS topics, with /clock; nothing is computed",
    )
    parser.add_argument("--start", type=_seconds, default=0.0, metavar="S", help="leave S s out")
    parser.add_argument("--loop", action="store_true", help="begin anew at the end")
    parser.add_argument("--rate", type=positive, metavar="X", help="with --play: X times faster")
    add_options(parser)
    parser.set_defaults(function=partial(replay, parser))


PLAYS = ("start", "loop", "rate", "duration", "ros", "map", "namespace", "frame_prefix")
"""Options that go with `--play`, besides those of ROS."""


def replay(parser: argparse.ArgumentParser, arguments: argparse.Namespace) -> int:
    """Run the command; exit status 0 done or equal, 1 different, 3 fault."""
    if arguments.verify:
        _refuse_others(parser, arguments, ("workflow", "overrides"), "--verify")
        return _verify(arguments)
    if arguments.play:
        _refuse_others(parser, arguments, (*PLAYS, "ros_args"), "--play")
        return _play(arguments)
    if arguments.rate is not None:
        raise UniconError("replay: --rate goes with --play; a workflow has --speed")
    return _run(arguments)


def _refuse_others(
    parser: argparse.ArgumentParser,
    arguments: argparse.Namespace,
    known: Sequence[str],
    form: str,
) -> None:
    """Refuse what would be left alone in silence."""
    own = ("bag", "verify", "play", "command", "function", "quiet", "verbose", *known)
    for name, value in vars(arguments).items():
        if name not in own and value != parser.get_default(name):
            word = {"workflow": "WORKFLOW", "overrides": "--set"}.get(name)
            allowed = ", ".join(f"--{each.replace('_', '-')}" for each in known if each in PLAYS)
            raise UniconError(
                f"replay: {word or '--' + name.replace('_', '-')} does not go with {form}; "
                f"{f'it takes {allowed}' if allowed else 'leave it out'}"
            )


def _seconds(text: str) -> float:
    value = float(text)
    if not 0.0 <= value < float("inf"):
        raise argparse.ArgumentTypeError(f"{text} is not a number of seconds, 0 or more")
    return value


def _run(arguments: argparse.Namespace) -> int:
    from unicon_ros.recording import open_record
    from unicon_ros.replay import workflow_of
    from unicon_ros.replay.platform import replayed_on

    document = workflow_of(open_record(arguments.bag), arguments.workflow, arguments.overrides)
    replayed_on(document, arguments.bag, start=arguments.start, loop=arguments.loop)
    arguments.faults = arguments.faults or "off"  # the folder is for what happens
    return run_document(arguments, document)


def _play(arguments: argparse.Namespace) -> int:
    from unicon_ros.cli.console import Console
    from unicon_ros.replay.keys import HELP
    from unicon_ros.replay.player import play

    console, session, status = Console(), None, 1
    keys = console.terminal and sys.stdin is not None and sys.stdin.isatty()
    try:
        if arguments.ros is not False:
            from unicon_ros.bridge import RosSession

            session = RosSession(
                map=arguments.map,
                node_name="unicon",
                namespace=arguments.namespace,
                ros_args=arguments.ros_args,
                warn=console.warn,
                frame_prefix=arguments.frame_prefix,
            )
        if keys:
            print(HELP)
        report = play(
            arguments.bag,
            rate=arguments.rate or 1.0,
            loop=arguments.loop,
            start=arguments.start,
            duration=arguments.duration,
            session=session,
            keys=keys,
            warn=console.warn,
            status=None if arguments.quiet or not console.terminal else console.status,
        )
        status = 3 if report.faults else 0
    finally:
        console.close()
        if session is not None:
            close_session(session, status)
    print(report.summary())
    return status


def _verify(arguments: argparse.Namespace) -> int:
    from unicon_core.aligned import aligned
    from unicon_ros.recording import open_record
    from unicon_ros.replay import verify, workflow_of

    record = open_record(arguments.bag)
    document = workflow_of(record, arguments.workflow, arguments.overrides)
    verdict = verify(record, document)
    rows = [("workflow", f"{document.name}, recorded on {record.facts.get('platform', '?')}")]
    count = f"{verdict.differing} of {verdict.ticks} ticks differ"
    if verdict.first is not None:
        count += f"; in commands {verdict.commands}"
        rows += verdict.first.lines(verdict.period)
    rows += [("fault", verdict.fault)] if verdict.fault else []
    rows += [("note", note) for note in verdict.notes]
    print("\n".join(aligned(rows, underlined=False)))
    print(count)
    return 0 if verdict.first is None else 1
