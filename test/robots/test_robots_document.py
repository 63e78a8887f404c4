"""docs/reference/robots.md and hardware.md agree with robot files, platforms and the ledger."""

from __future__ import annotations

import inspect
import re
from pathlib import Path

from unicon_base.errors import UniconError
from unicon_core.evidence import load_evidence
from unicon_core.robots import load_robot, robot_names
from unicon_core.workflow.registry import find_factory

ROOT = Path(__file__).resolve().parents[2]
REFERENCE = ROOT / "docs" / "reference"
TEXT = (REFERENCE / "robots.md").read_text(encoding="utf-8")
HARDWARE = (REFERENCE / "hardware.md").read_text(encoding="utf-8")
NONE = "none: refused"


def rows() -> dict[str, list[str]]:
    """Return protocol, platform and level of evidence, by robot file; a row may name several."""
    table = TEXT.split("| robot file |", 1)[1].split("\n\n", 1)[0].splitlines()[2:]
    cells = [[cell.strip() for cell in line.strip("| ").split("|")] for line in table]
    listed = [(name, line[1:]) for line in cells for name in re.findall(r"`(\w+)`", line[0])]
    assert len(dict(listed)) == len(listed)
    return dict(listed)


def entry_points() -> dict[str, str]:
    """Return platforms and where they stand, as setup.py registers them."""
    text = (ROOT / "setup.py").read_text(encoding="utf-8")
    listed = text.split('"unicon.platforms": [', 1)[1].split("]", 1)[0]
    return dict(re.findall(r'"(\w+) = ([\w.]+):', listed))


def named() -> set[str]:
    """Return the platforms of the table."""
    return {platform.strip("`") for _, platform, _ in rows().values() if platform != NONE}


def test_every_robot_file_has_a_row_with_its_protocol() -> None:
    assert sorted(rows()) == sorted(robot_names())
    for robot, (protocol, platform, level) in rows().items():
        assert protocol == f"`{load_robot(robot).transport['protocol']}`", robot
        assert re.fullmatch(r"`\w+`", platform) or platform == NONE, robot
        assert level == load_evidence()["robot", robot].level, robot


def test_every_platform_of_the_table_exists() -> None:
    assert named() <= set(entry_points())


def test_every_driver_of_ours_has_a_row_and_a_section() -> None:
    drivers = {name for name, at in entry_points().items() if ".hardware." in at}
    assert drivers <= named()
    sections = HARDWARE.split("\n## ")[1:]
    for driver in drivers:
        assert any(re.search(rf"[Pp]latform `.*\b{driver}\b", each) for each in sections), driver
    for section in sections:
        for what in ("Needs", "Protects", "Open", "Sources"):
            assert f"- **{what}**: " in section, section.splitlines()[0]


OTHER = {"mode_machine", "rate", "ros2", "sdk"}
"""Quoted in lines of options, and none of a platform."""


def test_every_option_that_a_section_names_exists() -> None:
    for section in HARDWARE.split("\n## ")[1:]:
        platforms = re.findall(r"[Pp]latform `(?:{child: )?(\w+)", section)
        factories = [find_factory("platforms", name, UniconError) for name in platforms]
        known = {option for each in factories for option in inspect.signature(each).parameters}
        lines = re.findall(r"^- \*\*Options\*\*: (.*)$", section, re.MULTILINE)
        told = {name for line in lines for name in re.findall(r"`(\w+)(?:: \w+)?`", line)}
        assert told <= known | OTHER, section.splitlines()[0]


def test_nothing_claims_a_real_robot_that_the_ledger_does_not_know() -> None:
    on_hardware = any(each.level == "hardware" for each in load_evidence().values())
    assert ("Nothing here has moved a real robot yet." in TEXT) is not on_hardware


def test_a_robot_that_is_refused_has_a_reason_that_the_file_knows() -> None:
    for robot, (_, platform, _) in rows().items():
        if platform == NONE:
            assert load_robot(robot).missing_facts(), robot


def test_every_unknown_fact_has_a_line_that_says_who_could_tell_it() -> None:
    text = TEXT.split("### What no public source says", 1)[1].split("\n## ", 1)[0]
    told: dict[str, set[str]] = {}
    for line in text.splitlines():
        if line.startswith("| `"):
            robots, facts, who = line.strip("| ").split("|", 2)
            assert who.strip(), line
            unsaid = set(re.findall(r"`(.+?)`", facts))
            told |= dict.fromkeys(re.findall(r"`(.+?)`", robots), unsaid)
    unknown = {name: set(load_robot(name).unknown) for name in robot_names()}
    assert told == {name: facts for name, facts in unknown.items() if facts}
