"""`unicon bench sloc`: edits that are made, counted and run."""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path
from typing import Any

import pytest

from benchmarks import sloc
from benchmarks.sloc import Transfer, difference, edited, lines_of, transferred
from unicon_base.errors import UniconError

H1 = "h1_stand"
AD_HOC: dict[str, dict[str, Any]] = sloc.TABLE["ad_hoc"]


def test_docstrings_comments_and_blank_lines_are_no_code() -> None:
    head = '"""Doc\n\nlong."""\n\n# comment\n'
    text = head + 'x = """a\nb"""  # two lines\n\n\ndef f():\n    "doc"\n    return 1\n'
    assert sloc.code_of(text) == ['x = """a', 'b"""  # two lines', "def f():", "    return 1"]


def test_yaml_counts_lines_with_content() -> None:
    assert lines_of("a: 1\n\n# no\n  - b  # yes\n") == 2


def test_an_edit_changes_the_word_of_a_key_alone() -> None:
    text = "name: robot\n# robot: x\nrobot: h1\nplatform: mujoco   # robot: y\nflow: {robot: z}\n"
    new = edited(text, {"robot": "g1", "platform": "ros"})
    assert difference(text, new) == (
        "-robot: h1",
        "-platform: mujoco   # robot: y",
        "+robot: g1",
        "+platform: ros   # robot: y",
    )


@pytest.mark.parametrize("key", ["flow", "rate", "ro.ot"])
def test_an_edit_that_cannot_be_made_is_told(key: str) -> None:
    with pytest.raises(UniconError, match=f"the workflow has no line '{key}: WORD' to edit"):
        edited("robot: h1\nflow: {hold: {}}\n", {key: "x"})


@pytest.mark.slow
def test_what_is_edited_is_run_and_counted() -> None:
    outcome = transferred(Transfer("a", "b", H1, {}, {"platform": "fake_robot"}))
    assert outcome.ran, outcome.told
    assert (outcome.lines, outcome.words) == (1, 1)
    assert [line[0] for line in outcome.difference] == ["-", "+"]
    assert outcome.told.startswith("100 ticks, ")


def test_a_transfer_that_fails_is_told_with_its_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    wrong = Transfer("G1", "Go2", "g1_walk", {}, {"robot": "nobody"})
    monkeypatch.setattr(sloc, "_missing", lambda values: "")
    outcome = transferred(wrong)
    assert outcome.ran is False
    assert "unknown robot 'nobody'" in outcome.told


def test_a_robot_that_does_not_begin_is_told_with_its_reason() -> None:
    with (
        pytest.raises(UniconError, match=r"no robot: .*nobody"),
        sloc.emulated("unitree", "go2", ("--face", "nobody")),
    ):
        pass


def test_a_robot_stands_behind_topics() -> None:
    pytest.importorskip("rclpy")
    with sloc.emulated("ros", "go2", ()) as robot:
        assert int(robot.environment["ROS_DOMAIN_ID"]) > 0


def test_what_this_machine_lacks_is_told_and_not_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sloc, "assets_root", lambda: None)
    outcome = transferred(Transfer("a", "b", H1, {}, {"robot": "t1"}))
    assert outcome.ran is None
    assert outcome.told == "there are no assets; set UNICON_ASSETS"
    monkeypatch.setattr(sloc, "find_spec", lambda name: None)
    for platform, module in (("ros", "rclpy"), ("unitree", "cyclonedds"), ("mujoco", "mujoco")):
        outcome = transferred(Transfer("a", "b", H1, {"platform": platform}))
        assert outcome.told == f"{module} is not installed"


def test_a_robot_that_cannot_be_emulated_is_told_with_the_reason(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(sloc, "AGAIN", 0)
    monkeypatch.setattr(sloc, "_missing", lambda values: "")
    nobody = Transfer("a", "b", H1, {}, {"platform": "unitree"}, ("--face=nobody",))
    outcome = transferred(nobody)
    assert outcome.ran is False
    assert outcome.told.startswith("no robot: unicon: error: unknown face 'nobody'; ")


def test_a_robot_that_falls_has_failed(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("mujoco")
    told = {"faults": [], "fell": True, "ticks": 100, "base_displacement_m": [0.01, 0.0, 0.0]}

    def ran(command: list[str], **_: Any) -> subprocess.CompletedProcess[str]:
        Path(command[command.index("--report") + 1]).write_text(json.dumps(told), "utf-8")
        return subprocess.CompletedProcess(command, 0, "", "")

    monkeypatch.setattr(subprocess, "run", ran)
    outcome = transferred(Transfer("a", "b", H1, {}, {"robot": "go2"}))
    assert (outcome.ran, outcome.told) == (False, "100 ticks, +0.01 m ahead, and fell")
    told["fell"] = False
    assert transferred(Transfer("a", "b", H1, {}, {"robot": "go2"})).ran is True


def test_every_move_of_the_paper_has_its_ad_hoc_code() -> None:
    moves = [f"{each.source} → {each.target}" for each in sloc.TRANSFERS]
    assert set(moves[:4]) <= set(AD_HOC) <= set(moves)
    assert len(sloc.TABLE["paper"]) == 4


@pytest.mark.slow
@pytest.mark.parametrize("move", AD_HOC)
def test_public_code_has_the_lines_that_are_told(move: str) -> None:
    clones = os.environ.get("UNICON_CLONES")
    if not clones:
        pytest.skip("set UNICON_CLONES to a folder with git clones, as OWNER/NAME, of sloc.yaml's")

    def code(repository: str, path: str) -> list[str]:
        name, _, commit = repository.partition("@")
        show = ["git", "-C", f"{clones}/{name}", "show", f"{commit}:{path}"]
        text = subprocess.run(show, capture_output=True, text=True, check=True).stdout
        return (
            sloc.code_of(text) if path.endswith(".py") else [*filter(lines_of, text.splitlines())]
        )

    found, gym = AD_HOC[move], AD_HOC["H1 → H1"]["repository"]
    lines = new = 0
    for path, made_of in found["files"].items():
        mine, theirs = code(found["repository"], path), code(gym, made_of) if made_of else []
        plus = difference(*("\n".join(map(str.strip, each)) for each in (theirs, mine)))
        lines, new = lines + len(mine), new + sum(line[0] == "+" for line in plus)
    assert (lines, new) == (found["lines"], found["new"])


@pytest.mark.slow
@pytest.mark.alone
@pytest.mark.timeout(900)
def test_every_transfer_of_the_table_runs(assets: Path) -> None:
    pytest.importorskip("mujoco")
    bench = sloc.run()
    moves = {name: value for name, value in bench.facts.items() if "→" in name}
    assert len(moves) == len(sloc.TRANSFERS)
    failed = {name: value for name, value in moves.items() if "FAILED" in value}
    assert failed == {}
    counted = {name: value.partition(";")[0] for name, value in moves.items()}
    assert counted.pop("H1 → H1") == "0 lines, 0 words"
    assert counted.pop("G1 → Adam") == "2 lines, 2 words"  # another robot, of another maker
    assert set(counted.values()) == {"1 line, 1 word"}
    for name in ("G1 walks", "Go2 walks"):  # behind Unitree's protocol
        told = moves[f"{name} in MuJoCo → {name}"]
        assert "not run" in told or float(told.split(" m ahead")[0].split()[-1]) > 1.0
    (ratio,) = bench.ratios.values()
    tried = [value for value in moves.values() if "not run here" not in value]
    assert tried
    assert ratio["value"] == 1.0
    assert bench.holds
