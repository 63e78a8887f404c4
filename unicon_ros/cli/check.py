"""`unicon check WORKFLOW`: preflight; every finding with culprit, evidence and remedy."""

from __future__ import annotations

import argparse
from typing import Any

from unicon_ros.cli.workflow_arguments import add_workflow

__all__ = ["add", "check"]


def add(commands: Any) -> None:
    """Add the command to the parser."""
    parser = commands.add_parser("check", help="check a workflow before a motor moves")
    add_workflow(parser)
    parser.add_argument(
        "--twin", action="store_true", help="also run it in MuJoCo, and broken twins"
    )
    parser.add_argument("--json", metavar="FILE", help="write the findings as JSON")
    parser.set_defaults(function=check)


def check(arguments: argparse.Namespace) -> int:
    """Run the command; exit status 0 clean, 1 findings."""
    from unicon_core.check import check_workflow

    result = check_workflow(arguments.workflow, arguments.overrides, twin=arguments.twin)
    print(result.text())
    if arguments.json:
        result.write(arguments.json)
    return 1 if result.findings else 0
