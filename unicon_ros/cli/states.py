"""`unicon states --header FILE.h WORKFLOW`: the groups of a workflow's states for C and C++."""

from __future__ import annotations

import argparse
from typing import Any

from unicon_core.errors import UniconError
from unicon_ros.cli.workflow_arguments import add_overrides

__all__ = ["add", "states"]


def add(commands: Any) -> None:
    """Add the command to the parser."""
    parser = commands.add_parser("states", help="states for other programs", description=__doc__)
    parser.add_argument("name", nargs="?", metavar="NAME", help="with --header: the workflow")
    parser.add_argument("--header", metavar="FILE.h", help="write its groups as a header of C")
    add_overrides(parser)
    parser.set_defaults(function=states)


def states(arguments: argparse.Namespace) -> int:
    """Run the command."""
    if not arguments.header or not arguments.name:
        raise UniconError(
            "states: give a file and a workflow: unicon states --header FILE.h WORKFLOW"
        )
    return _header(arguments.header, arguments.name, arguments.overrides)


def _header(file: str, workflow: str, overrides: list[str]) -> int:
    from unicon_core.states.c_header import write_header
    from unicon_core.states.groups import groups_of
    from unicon_core.workflow import load_workflow

    program = load_workflow(workflow, overrides)
    try:
        write_header(file, groups_of(program.states.layout), workflow)
    finally:
        program.close()
    print(file)
    return 0
