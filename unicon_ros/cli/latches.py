"""`unicon latches`: emergency stops and faults that keep nodes of this machine from starting."""

from __future__ import annotations

import argparse
from typing import Any

from unicon_core.aligned import aligned
from unicon_core.errors import UniconError
from unicon_ros.latches import latch_folder, latches

__all__ = ["add"]

HEAD = ("node", "domain", "latched", "since", "reason")


def add(commands: Any) -> None:
    """Add the command to the parser."""
    parser = commands.add_parser(
        "latches", help="list emergency stops that are latched, or let go", description=__doc__
    )
    parser.add_argument(
        "--clear", metavar="NODE", help="let go: NODE, such as /robot1/unicon, may start again"
    )
    parser.add_argument("--domain", type=int, metavar="N", help="of --clear: in this ROS domain")
    parser.set_defaults(function=_latches)


def _latches(arguments: argparse.Namespace) -> int:
    if arguments.clear is not None:
        return _clear(arguments.clear, arguments.domain)
    if arguments.domain is not None:
        raise UniconError("latches: --domain goes with --clear NODE; add it, or leave it out")
    found = [each for _, each in latches()]
    if not found:
        print(f"nothing is latched in {latch_folder()}")
        return 0
    rows = [(e.node, str(e.domain), e.kind, e.at or "?", e.reason) for e in found]
    print("\n".join(aligned([HEAD, *rows])))
    return 0


def _clear(node: str, domain: int | None) -> int:
    found = latches()
    chosen = [e for e in found if e[1].node == node and domain in (None, e[1].domain)]
    if not chosen:
        known = ", ".join(dict.fromkeys(f"{e.node} (domain {e.domain})" for _, e in found))
        where = f"of domain {domain} " if domain is not None else ""
        raise UniconError(
            f"no latch of {node!r} {where}in {latch_folder()}; latched: {known or 'nothing'}"
        )
    for path, each in chosen:
        try:
            path.unlink(missing_ok=True)
        except OSError as error:
            raise UniconError(f"cannot remove {path}: {error.strerror}; do so by hand") from error
        print(f"{each.node} (domain {each.domain}): {each.kind} cleared")
    print("a node that runs keeps its emergency stop until ~/clear_estop")
    return 0
