"""`unicon replay BAG [WORKFLOW]`: runs recorded ticks again and compares them to the bit."""

from __future__ import annotations

import argparse
from typing import Any

from unicon_ros.cli.workflow_arguments import add_overrides

__all__ = ["add", "replay"]


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
    parser.add_argument(
        "--verify",
        action="store_true",
        help="compare every state of every tick with the recorded; exit status 1 where one differs",
    )
    parser.set_defaults(function=replay)


def replay(arguments: argparse.Namespace) -> int:
    """Run the command; exit status 0 done or equal, 1 different."""
    return _verify(arguments)


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
    rows += [("note", note) for note in verdict.notes]
    print("\n".join(aligned(rows, underlined=False)))
    print(count)
    return 0 if verdict.first is None else 1
