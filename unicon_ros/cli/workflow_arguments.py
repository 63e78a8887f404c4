"""Arguments that every command on a workflow shares."""

from __future__ import annotations

import argparse

__all__ = ["add_overrides", "add_workflow"]


def add_workflow(parser: argparse.ArgumentParser) -> None:
    """Add WORKFLOW and `--set`."""
    parser.add_argument("workflow", metavar="WORKFLOW", help="name in config/workflows/, or a path")
    add_overrides(parser)


def add_overrides(parser: argparse.ArgumentParser) -> None:
    """Add `--set`."""
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="PATH=VALUE",
        dest="overrides",
        help="override a value, such as platform=fake or policies.walk.path=FILE (repeatable)",
    )
