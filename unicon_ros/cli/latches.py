"""`unicon latches`: emergency stops and faults that keep robots and nodes from being started."""

from __future__ import annotations

import argparse

from unicon_base.errors import UniconError, cannot
from unicon_core.latches import Latched, latch_folder, latches
from unicon_ros.cli.console import print_table
from unicon_ros.cli.options import argument, command

HEAD = ("node or robot", "domain", "latched", "since", "reason")


def _latches(arguments: argparse.Namespace) -> int:
    if arguments.clear is not None:
        return _clear(arguments.clear, arguments.domain)
    if arguments.domain is not None:
        raise UniconError("latches: --domain goes with --clear NAME; add it, or leave it out")
    found = [each for _, each in latches()]
    if not found:
        print(f"nothing is latched in {latch_folder()}")
        return 0
    rows = [
        (e.owner, str(e.domain) if e.node else "-", e.kind, e.at or "?", e.reason) for e in found
    ]
    print_table([HEAD, *rows], underlined=True)
    return 0


def _said(latched: Latched) -> str:
    return f"{latched.node} (domain {latched.domain})" if latched.node else latched.robot


def _clear(name: str, domain: int | None) -> int:
    """Let go of what a node or a robot has latched, and what the other has by the same press."""
    found = latches()
    named = [e for _, e in found if name in (e.owner, *e.robots)]
    named = [e for e in named if domain is None or e.domain == domain]
    robots = {robot for each in named for robot in each.robots}
    chosen = [(p, e) for p, e in found if e in named or (not e.node and e.robot in robots)]
    if not chosen:
        known = ", ".join(dict.fromkeys(_said(e) for _, e in found))
        where = f"of domain {domain} " if domain is not None else ""
        raise UniconError(
            f"no latch of {name!r} {where}in {latch_folder()}; latched: {known or 'nothing'}"
        )
    for path, each in chosen:
        with cannot(f"remove {path}", "do so by hand"):
            path.unlink(missing_ok=True)
        print(f"{_said(each)}: {each.kind} cleared")
    print("a node that runs keeps its emergency stop until ~/clear_estop")
    return 0


add = command(
    "latches",
    _latches,
    "list emergency stops that are latched, or let go",
    __doc__,
    argument(
        "--clear",
        "NAME",
        "let go: the node NAME, such as /robot1/unicon, or the robot may be started again",
    ),
    argument("--domain", "N", "of --clear: in this ROS domain", type=int),
)
