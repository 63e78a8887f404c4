"""Arguments that several commands share."""

from __future__ import annotations

import argparse

__all__ = ["add_overrides", "add_workflow", "positive"]


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
        help="override a value, such as platform=fake, safety.0=finite or "
        "policies.walk.given.action.scale=0.5 (repeatable)",
    )


def positive(text: str) -> float:
    """Return an argument that is a number > 0, such as a duration in [s] or a rate in [Hz]."""
    value = float(text)
    if not 0.0 < value < float("inf"):
        raise argparse.ArgumentTypeError(f"{text} is not a number > 0")
    return value
