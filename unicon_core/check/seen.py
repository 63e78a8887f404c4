"""What a workflow's platform and robots last ran against: said where it is little."""

from __future__ import annotations

from unicon_core.check.result import CheckResult
from unicon_core.check.subject import Subject
from unicon_core.evidence import LEVELS, Evidence, load_evidence
from unicon_core.platforms.platform import Facts
from unicon_core.robots import Robot

ENOUGH = {"simulator": "vendor", "robot": "hardware"}
"""Levels from which nothing is said."""


def little_seen(facts: Facts, robot: Robot) -> list[Evidence]:
    """Return what was hardly run of a workflow's platform, or of the robots that it drives.

    Args:
        facts: of the platform.
        robot: of the workflow.
    """
    robots = [("robot", each.name) for each in (robot.members.values() or (robot,))]
    ledger, levels = load_evidence(), list(LEVELS)
    found = [
        ledger.get(key) for key in ([("simulator", facts.name)] if facts.simulated else robots)
    ]
    return [
        each
        for each in found
        if each is not None and levels.index(each.level) < levels.index(ENOUGH[each.kind])
    ]


def check_seen(subject: Subject, result: CheckResult) -> None:
    """Note what the workflow's platform was hardly run against."""
    for each in little_seen(subject.platform, subject.robot):
        result.note("evidence", f"{each.kind} {each.name}", str(each))
