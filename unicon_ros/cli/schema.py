"""`unicon schema [KIND]`: JSON Schema of documents, by which editors complete and check them."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

from unicon_base.errors import UniconError, alternatives
from unicon_base.packages import registered
from unicon_core.page import write_file
from unicon_ros.cli.options import argument, command

KINDS = {
    "workflow": ("unicon_core.workflow.file:Workflow",),
    "policy": ("unicon_core.policies.file:PolicyFile",),
    "map": ("unicon_msgs_map.mapfile.document:MapDocument",),
    "robot": ("unicon_core.robots.file:RobotFile", "unicon_core.robots.file:Overlay"),
} | {name: (entry.value,) for name, entry in registered("documents").items()}
"""Kind of document to its classes."""


def schema_of(kind: str) -> dict[str, Any]:
    """Return the JSON Schema of a kind of document.

    Raises:
        UniconError: there is no such kind.
    """
    from unicon_base.schema.read import json_schema

    if kind not in KINDS:
        raise UniconError(f"schema: unknown kind {kind!r}; {alternatives(kind, KINDS)}")
    return json_schema(*map(resolve_name, KINDS[kind]))


def schema(arguments: argparse.Namespace) -> int:
    """Run the command."""
    kinds = [arguments.kind] if arguments.kind else list(KINDS)
    if arguments.kind is None and arguments.out is None:
        raise UniconError(f"schema: give one of {', '.join(KINDS)}, or --out FOLDER for all")
    for kind in kinds:
        text = json.dumps(schema_of(kind), indent=1, ensure_ascii=False) + "\n"
        if arguments.out is None:
            print(text, end="")
            continue
        path = Path(arguments.out) / f"{kind}.json"
        write_file(path, text.encode(), folders=True)
        print(path)
    return 0


add = command(
    "schema",
    schema,
    "JSON Schema of documents, for editors",
    __doc__,
    argument("kind", "KIND", f"one of {', '.join(KINDS)}", nargs="?"),
    argument("--out", "FOLDER", "write KIND.json, or all of them, there"),
)
