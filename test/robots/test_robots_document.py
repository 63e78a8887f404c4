"""The table of docs/reference/robots.md has every robot file and every platform."""

from __future__ import annotations

import re
from pathlib import Path

from unicon_core.evidence import load_evidence
from unicon_core.robots import load_robot, robot_names

ROOT = Path(__file__).resolve().parents[2]
TEXT = (ROOT / "docs" / "reference" / "robots.md").read_text(encoding="utf-8")
NONE = ("none: refused", "none: not written")


def rows() -> dict[str, list[str]]:
    """Return protocol, platform and what it was run against, by robot file."""
    table = TEXT.split("| robot file |", 1)[1].split("\n\n", 1)[0].splitlines()[2:]
    cells = [[cell.strip() for cell in line.strip("| ").split("|")] for line in table]
    assert len({line[0] for line in cells}) == len(cells)
    return {line[0].strip("`"): line[1:] for line in cells}


def entry_points() -> dict[str, str]:
    """Return platforms and where they stand, as setup.py registers them."""
    text = (ROOT / "setup.py").read_text(encoding="utf-8")
    listed = text.split('"unicon.platforms": [', 1)[1].split("]", 1)[0]
    return dict(re.findall(r'"(\w+) = ([\w.]+):', listed))


def named() -> set[str]:
    """Return the platforms of the table."""
    return {platform.strip("`") for _, platform, _ in rows().values() if platform not in NONE}


def test_every_robot_file_has_a_row_with_its_protocol() -> None:
    assert sorted(rows()) == sorted(robot_names())
    for robot, (protocol, platform, against) in rows().items():
        assert protocol == f"`{load_robot(robot).transport['protocol']}`", robot
        assert re.fullmatch(r"`\w+`", platform) or platform in NONE, robot
        assert against.replace("`", "") == load_evidence()["robot", robot].against, robot


def test_platforms_that_are_not_there_are_said_and_no_others() -> None:
    said = re.search(r"^Not there yet: (.+)\.$", TEXT, re.MULTILINE)
    absent = set(re.findall(r"`(\w+)`", said[1])) if said else set()
    assert absent == named() - set(entry_points()), "correct the line 'Not there yet: …'"


def test_every_driver_of_ours_has_a_row() -> None:
    drivers = {name for name, at in entry_points().items() if ".hardware." in at}
    assert drivers <= named()


def test_a_robot_that_is_refused_has_a_reason_that_the_file_knows() -> None:
    for robot, (_, platform, _) in rows().items():
        if platform == "none: refused":
            assert load_robot(robot).missing_facts(), robot


def test_nothing_claims_a_real_robot() -> None:
    """Who has run one writes so in the first lines, and here."""
    assert "Nothing here has moved a real robot yet." in TEXT
    assert not any("real" in against for _, _, against in rows().values())


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
