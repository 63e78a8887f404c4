"""`unicon bench NAME`: side by side comparisons in one run; ratios, never absolute promises."""

from __future__ import annotations

import argparse
from importlib import import_module
from pathlib import Path
from typing import Any

from unicon_core.errors import UniconError

__all__ = ["BENCHES", "add", "bench"]

BENCHES = {
    "tick": "unicon_ros.bench.tick",
}


def add(commands: Any) -> None:
    """Add the command to the parser."""
    parser = commands.add_parser("bench", help="compare side by side", description=__doc__)
    parser.add_argument("bench", choices=sorted(BENCHES), metavar="NAME", help=", ".join(BENCHES))
    parser.add_argument("--rounds", type=int, help="interleaved rounds")
    parser.add_argument("--json", metavar="FILE", help="write the result as JSON")
    parser.add_argument(
        "--assert", action="store_true", dest="strict", help="exit 1 where a ratio misses its bar"
    )
    parser.set_defaults(function=bench)


def bench(arguments: argparse.Namespace) -> int:
    """Run the command."""
    result = import_module(BENCHES[arguments.bench]).run(rounds=arguments.rounds)
    print(result.table())
    if arguments.json:
        try:
            Path(arguments.json).write_text(result.to_json() + "\n", encoding="utf-8")
        except OSError as error:
            raise UniconError(f"cannot write {arguments.json}: {error.strerror}") from error
    return 1 if arguments.strict and not result.holds else 0
