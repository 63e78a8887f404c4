"""What a workflow's platform and robots last ran against: said where it is little."""

from __future__ import annotations

from collections.abc import Iterable

from unicon_core.check.result import CheckResult
from unicon_core.check.subject import Subject
from unicon_core.evidence import LEVELS, Evidence, load_evidence
from unicon_core.platforms.platform import Facts
from unicon_core.robots import Robot

__all__ = ["check_seen", "little_seen"]

ENOUGH = {"simulator": "vendor", "robot": "hardware"}
"""Levels from which nothing is said."""


def little_seen(facts: Iterable[Facts], robot: Robot) -> list[Evidence]:
    """Return what was hardly run of the platforms and robots of a workflow.

    Args:
        facts: of its platforms.
        robot: its robot.
    """
    ledger, found = load_evidence(), []
    for each in facts:
        names = [name.name for name in (robot.members.values() or (robot,))]
        keys = [("simulator", each.name)] if each.simulated else [("robot", n) for n in names]
        found += [ledger[key] for key in keys if key in ledger]
    levels = list(LEVELS)
    return [e for e in found if levels.index(e.level) < levels.index(ENOUGH[e.kind])]


def check_seen(subject: Subject, result: CheckResult) -> None:
    """Note what the workflow's platform was hardly run against."""
    for each in little_seen([subject.platform], subject.robot):
        result.note("evidence", f"{each.kind} {each.name}", str(each))
