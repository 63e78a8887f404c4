"""`unicon doctor`: what of this machine a run depends on, with remedies; first thing in a report.

Exit status 1 where something keeps runs from working; warnings and notes are no failure.
"""

from __future__ import annotations

import argparse
from dataclasses import asdict

from unicon_core.text_table import aligned
from unicon_ros.cli.console import print_json
from unicon_ros.cli.options import command, flag

MARKS = {"ok": "", "note": "·", "warning": "!", "error": "✗"}


def _doctor(arguments: argparse.Namespace) -> int:
    from unicon_ros.doctor import examine

    found = [*examine()]
    if arguments.json:
        print_json([asdict(each) for each in found])
    else:
        rows = [(MARKS[e.level], e.area, e.name, e.said) for e in found]
        for line, each in zip(aligned(rows, underlined=False), found):
            print(line.rstrip())
            if each.remedy:
                print(f"     {each.remedy}")
        worse = [each for each in found if each.level in ("warning", "error")]
        print(f"\n{len(worse)} of {len(found)} need a look" if worse else "\nnothing is wrong")
    return int(any(each.level == "error" for each in found))


add = command(
    "doctor",
    _doctor,
    "examine this machine: packages, ROS, network, clock, permissions",
    __doc__,
    flag("--json", "print JSON"),
)
