"""`unicon doctor`: what of this machine a run depends on, with remedies; first thing in a report.

Exit status 1 where something keeps runs from working; warnings and notes are no failure.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from typing import Any

from unicon_core.aligned import aligned

MARKS = {"ok": "", "note": "·", "warning": "!", "error": "✗"}


def add(commands: Any) -> None:
    """Add the command to the parser."""
    parser = commands.add_parser(
        "doctor",
        help="examine this machine: packages, ROS, network, clock, permissions",
        description=__doc__,
    )
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.set_defaults(function=_doctor)


def _doctor(arguments: argparse.Namespace) -> int:
    from unicon_ros.doctor import examine

    found = [*examine()]
    if arguments.json:
        print(json.dumps([asdict(each) for each in found], indent=2, ensure_ascii=False))
    else:
        rows = [(MARKS[e.level], e.area, e.name, e.said) for e in found]
        for line, each in zip(aligned(rows, underlined=False), found):
            print(line.rstrip())
            if each.remedy:
                print(f"     {each.remedy}")
        worse = [each for each in found if each.level in ("warning", "error")]
        print(f"\n{len(worse)} of {len(found)} need a look" if worse else "\nnothing is wrong")
    return int(any(each.level == "error" for each in found))
