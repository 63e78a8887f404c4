"""`unicon states --header FILE.h WORKFLOW`: the groups of a workflow's states for C and C++."""

from __future__ import annotations

import argparse

from unicon_core.errors import StateError
from unicon_core.states.c_header import write_header
from unicon_core.states.groups import Groups, groups_of
from unicon_core.workflow import Program, load_workflow


def header(arguments: argparse.Namespace) -> int:
    """Run the command."""
    other = any(
        getattr(arguments, name) for name in ("watch", "rate", "duration", "csv", "json", "clean")
    )
    if not arguments.header or not arguments.name or other:
        raise StateError(
            "states: --header takes a workflow, --part and --set, and they go with it alone: "
            "unicon states --header FILE.h WORKFLOW"
        )
    program = load_workflow(arguments.name, arguments.overrides)
    try:
        groups = _published(program, arguments.part)
    finally:
        program.close()
    part = f", part {arguments.part}" if arguments.part else ""
    write_header(arguments.header, groups, arguments.name + part)
    print(arguments.header)
    return 0


def _published(program: Program, part: str) -> Groups:
    """Return what a run of the program publishes in one segment."""
    layout, parts = program.states.layout, program.parts
    if parts is not None and part in parts.parts:
        return parts.groups(part, layout)
    if parts is not None:
        raise StateError(
            f"states: {f'no part {part!r}' if part else 'each part publishes its own states'}; "
            f"give --part {' or --part '.join(parts.parts)}"
        )
    if part:
        raise StateError(f"states: --part {part}: the workflow has no parts; leave it out")
    return groups_of(layout)
