"""`unicon explain [CODE]`: what a finding of `unicon check` means, why it matters, what to do."""

from __future__ import annotations

import argparse
from typing import Any

from unicon_core.errors import UniconError, alternatives
from unicon_ros.cli.console import print_table
from unicon_ros.cli.options import argument, command, flag


def add(commands: Any) -> None:
    """Add the command to the parser."""
    parser = command(
        commands, "explain", explain, "what a finding means and what to do about it", __doc__
    )
    argument(parser, "code", "CODE", "of a finding; all unless given", nargs="?")
    flag(parser, "--markdown", "all rules as a page")


def explain(arguments: argparse.Namespace) -> int:
    """Run the command."""
    from unicon_core.check.rules import CODES, markdown

    if arguments.markdown:
        print(markdown(), end="")
    elif arguments.code is None:
        rows = [(code, rule.what) for code, rule in sorted(CODES.items())]
        print_table(rows)
    elif arguments.code in CODES:
        print(CODES[arguments.code].text())
    else:
        known = alternatives(arguments.code, CODES, limit=len(CODES))
        raise UniconError(f"explain: no finding has the code {arguments.code!r}; {known}")
    return 0
