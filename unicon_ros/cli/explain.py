"""`unicon explain [CODE]`: what a finding of `unicon check` means, why it matters, what to do."""

from __future__ import annotations

import argparse
from typing import Any

from unicon_core.errors import UniconError, alternatives


def add(commands: Any) -> None:
    """Add the command to the parser."""
    parser = commands.add_parser(
        "explain", help="what a finding means and what to do about it", description=__doc__
    )
    parser.add_argument("code", nargs="?", metavar="CODE", help="of a finding; all unless given")
    parser.add_argument("--markdown", action="store_true", help="all rules as a page")
    parser.set_defaults(function=explain)


def explain(arguments: argparse.Namespace) -> int:
    """Run the command."""
    from unicon_core.aligned import aligned
    from unicon_core.check.rules import CODES, markdown

    if arguments.markdown:
        print(markdown(), end="")
    elif arguments.code is None:
        rows = [(code, rule.what) for code, rule in sorted(CODES.items())]
        print("\n".join(aligned(rows, underlined=False)))
    elif arguments.code in CODES:
        print(CODES[arguments.code].text())
    else:
        known = alternatives(arguments.code, CODES, limit=len(CODES))
        raise UniconError(f"explain: no finding has the code {arguments.code!r}; {known}")
    return 0
