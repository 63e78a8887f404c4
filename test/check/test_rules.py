"""The list of rules: its page, `unicon explain`, and tests that raise every code."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import pytest

from unicon_core.check import CheckResult, check_workflow
from unicon_core.check.graph import check_parts
from unicon_core.check.observation import check_clock
from unicon_core.check.result import PolicyResult
from unicon_core.check.rules import CODES, FIRM, LIVE, RULES, markdown
from unicon_core.platforms.fake import FakePlatform
from unicon_core.platforms.kit.scene import Scene
from unicon_core.platforms.platform import Facts
from unicon_core.policies.contract import PhaseSpec
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_core.states.links import Silent, Store
from unicon_core.workflow.parts import Part, Parts
from unicon_ros.cli.main import main

ROOT = Path(__file__).resolve().parents[2]


def test_the_page_is_generated() -> None:
    page = (ROOT / "docs" / "reference" / "rules.md").read_text("utf-8")
    assert page == markdown(), "run: unicon explain --markdown > docs/reference/rules.md"


def test_codes_are_unique_and_every_rule_says_all() -> None:
    assert len(CODES) == len(RULES) == len({rule.what for rule in RULES})
    assert set(CODES) > FIRM
    for rule in RULES:
        assert rule.needs
        assert all((rule.what, rule.why, rule.remedy)), rule.code


def test_the_remedy_of_a_finding_is_its_rules_unless_it_has_one_of_its_own() -> None:
    result = CheckResult("walk")
    for remedy in (None, "mend it", ""):
        result.find("gains.swapped", "policy 'walk'", "kp 1, kd 40", remedy)
    remedies = [finding.remedy for finding in result.findings]
    assert remedies == ["exchange stiffness and damping", "mend it", ""]


@pytest.mark.parametrize("code", CODES)
def test_a_test_raises_every_code(code: str) -> None:
    texts = (path.read_text("utf-8") for path in (ROOT / "test").rglob("test_*.py"))
    assert any(re.search(rf"\b{re.escape(code)}\b", text) for text in texts)


SOUND = ("go2_walk", "go2_stand", "g1_walk")


@cache
def found_in_sound_workflows() -> dict[str, set[str]]:
    results = {name: check_workflow(name) for name in SOUND}
    assert not any(result.findings for result in results.values())
    return {name: {note.code for note in result.notes} for name, result in results.items()}


@pytest.mark.parametrize("code", [code for code in CODES if code not in LIVE])
def test_a_sound_workflow_does_not_raise_it(code: str, assets: Path) -> None:
    """Live rules have that in test_live_rules; twins of sound contracts in test_check_twin."""
    assert any(code not in found for found in found_in_sound_workflows().values())


def test_explain(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["explain", "gains.swapped"]) == 0
    told = capsys.readouterr().out
    assert "exchange stiffness and damping" in told
    assert re.search("^  why ", told, re.MULTILINE)
    assert main(["explain", "map.fit"]) == 0
    assert "cannot be accepted or forced" in capsys.readouterr().out
    assert main(["explain"]) == 0
    assert set(CODES) <= set(capsys.readouterr().out.split())
    assert main(["explain", "gains.swaped"]) == 1
    assert "did you mean 'gains.swapped'?" in capsys.readouterr().err
    assert main(["explain", "--markdown"]) == 0
    assert capsys.readouterr().out == markdown()


def part(name: str, **said: object) -> SimpleNamespace:
    block = {"reads": (), "amends": (), "writes": (), "where": "", "part": ""}
    return SimpleNamespace(name=name, **(block | said))


def test_two_parts_that_write_one_state_are_found() -> None:
    parts = Parts(
        {name: Part(name, (), Silent(then="hold")) for name in ("robot", "desk")}, Store("shm", "w")
    )
    platform = SimpleNamespace(facts=Facts("fake", writes=("joint_pos",)), name="fake")
    program = SimpleNamespace(parts=parts, part="", platform=platform)
    document = SimpleNamespace(where=lambda *path: "w.yaml:1")
    for writes, found in (("joint_pos", ["parts.writers"]), ("mode", [])):
        program.blocks = [part("theirs", part="desk", writes=(writes,)), part("ours")]
        result = CheckResult("w")
        subject = SimpleNamespace(program=program, platform=platform, document=document)
        check_parts(subject, result)  # type: ignore[arg-type]
        assert [finding.code for finding in result.findings] == found


@pytest.mark.parametrize(
    ("phase", "found"),
    [
        (PhaseSpec(0.8, (0.0, 3.1)), []),
        (PhaseSpec(0.8, (0.0, 180.0)), ["timing.clock"]),
        (PhaseSpec(800.0, (0.0, 3.1)), ["timing.clock"]),
        (None, []),
    ],
)
def test_a_clock_in_another_unit_is_found(phase: PhaseSpec | None, found: list[str]) -> None:
    result = CheckResult("w")
    contract = SimpleNamespace(phase=phase, path=Path("policy.yaml"))
    check_clock(PolicyResult(result, "walk", contract))  # type: ignore[arg-type]
    assert [finding.code for finding in result.findings] == found


def test_a_pose_of_the_policys_own_is_noted(assets: Path) -> None:
    """`pose.differ` stands beside g1_walk, and not beside go2_walk."""
    for workflow, noted in (("g1_walk", True), ("go2_walk", False)):
        codes = {note.code for note in check_workflow(workflow).notes}
        assert ("pose.differ" in codes) is noted


class Guessed(FakePlatform):
    """A platform that says what its opening alone would show."""

    facts = replace(FakePlatform.facts, name="guessed", notes=("its clock was not looked at",))


def guessed(states: States, robot: Robot, period: float) -> Guessed:
    return Guessed(states, robot, period, Scene(), 0.05)


def test_what_the_opened_platform_alone_can_tell_is_noted() -> None:
    result = check_workflow("go2_stand", {"platform": f"{__name__}:guessed"})
    assert [n.evidence for n in result.notes if n.code == "platform.open"] == [
        "its clock was not looked at"
    ]
    assert not [n for n in check_workflow("go2_stand").notes if n.code == "platform.open"]
