"""`unicon replay BAG [WORKFLOW]`: recorded sensors drive a workflow; or compares, or plays."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from unicon_base import UniconError
from unicon_ros.cli.console import Console, print_table
from unicon_ros.cli.options import OVERRIDES, argument, command, exclusive, flag, positive, seconds
from unicon_ros.cli.run import close_session, ros_session, run_document, run_options

OWN = ("bag", "verify", "play", "command", "function", "parser", "quiet", "verbose")
"""What every form has."""

PLAYS = ("start", "loop", "rate", "duration", "ros", "map", "namespace", "frame_prefix")
"""Options that go with `--play`, besides those of ROS."""


def replay(arguments: argparse.Namespace) -> int:
    """Run the command; exit status 0 done or equal, 1 different, 3 fault."""
    if arguments.verify:
        _refuse_others(arguments, ("workflow", "overrides", "native"), "--verify")
        return _verify(arguments)
    if arguments.play:
        _refuse_others(arguments, (*PLAYS, "ros_args"), "--play")
        return _play(arguments)
    if arguments.rate is not None:
        raise UniconError("replay: --rate goes with --play; a workflow has --speed")
    return _run(arguments)


def _refuse_others(arguments: argparse.Namespace, known: Sequence[str], form: str) -> None:
    """Refuse what would be left alone in silence."""
    own = (*OWN, *known)
    for name, value in vars(arguments).items():
        if name not in own and value != arguments.parser.get_default(name):
            word = {"workflow": "WORKFLOW", "overrides": "--set"}.get(name)
            allowed = ", ".join(f"--{each.replace('_', '-')}" for each in known if each in PLAYS)
            raise UniconError(
                f"replay: {word or '--' + name.replace('_', '-')} does not go with {form}; "
                f"{f'it takes {allowed}' if allowed else 'leave it out'}"
            )


def _run(arguments: argparse.Namespace) -> int:
    from unicon_lab.recording import open_record
    from unicon_lab.replay import workflow_of
    from unicon_lab.replay.platform import replayed_on

    document = workflow_of(open_record(arguments.bag), arguments.workflow, arguments.overrides)
    replayed_on(document, arguments.bag, start=arguments.start, loop=arguments.loop)
    arguments.faults = arguments.faults or "off"  # the folder is for what happens
    return run_document(arguments, document)


def _play(arguments: argparse.Namespace) -> int:
    from unicon_lab.replay.player import HELP, play

    console, session, status = Console(), None, 1
    keys = console.terminal and sys.stdin is not None and sys.stdin.isatty()
    try:
        if arguments.ros is not False:
            session = ros_session(arguments, arguments.map, console.warn)
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
            status=console.status_of(arguments),
        )
        status = 3 if report.faults else 0
    finally:
        console.close()
        if session is not None:
            close_session(session, status)
    print(report.summary())
    return status


def _verify(arguments: argparse.Namespace) -> int:
    from unicon_lab.recording import open_record
    from unicon_lab.replay import verify, workflow_of

    record = open_record(arguments.bag)
    document = workflow_of(record, arguments.workflow, arguments.overrides)
    verdict = verify(record, document, arguments.native)
    rows = [("workflow", f"{document.name}, recorded on {record.facts.get('platform', '?')}")]
    count = f"{verdict.differing} of {verdict.ticks} ticks differ"
    if verdict.first is not None:
        count += f"; in commands {verdict.commands}"
        rows += verdict.first.lines(verdict.period)
    rows += [("fault", verdict.fault)] if verdict.fault else []
    rows += [("note", note) for note in verdict.notes]
    print_table(rows)
    print(count)
    return 0 if verdict.first is None else 1


add = command(
    "replay",
    replay,
    "run a recording again",
    __doc__,
    argument("bag", "BAG", "record of a fault, or recording of a run"),
    argument(
        "workflow",
        "WORKFLOW",
        "name in config/workflows/, or a path (default: the recorded one)",
        nargs="?",
    ),
    OVERRIDES,
    exclusive(
        flag(
            "--verify",
            "compare every state of every tick with the recorded; exit status 1 where one differs",
        ),
        flag(
            "--play", "publish the recorded states to ROS topics, with /clock; nothing is computed"
        ),
    ),
    argument("--start", "S", "leave S s out", type=seconds, default=0.0),
    flag("--loop", "begin anew at the end"),
    argument("--rate", "X", "with --play: X times faster", type=positive),
    *run_options(),
    lambda parser: parser.set_defaults(parser=parser),  # which knows what was not given
)
