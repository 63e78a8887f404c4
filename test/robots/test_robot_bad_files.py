"""Each broken robot file in `bad/` gets the message that stands beside it, exactly."""

from __future__ import annotations

from pathlib import Path

import pytest

from unicon_base.errors import RobotError
from unicon_core.robots import load_robot
from unicon_ros.cli.main import main

BAD = Path(__file__).parent / "bad"
FILES = sorted(BAD.glob("*.yaml"))


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_broken_file_gets_its_message(path: Path) -> None:
    with pytest.raises(RobotError) as caught:
        load_robot(path)
    message = str(caught.value)
    assert "\n" not in message
    assert message.replace(f"{BAD}/", "") == path.with_suffix(".txt").read_text("utf-8").rstrip(
        "\n"
    )


MANY = Path(__file__).parent / "many_mistakes.yaml"
"""With `many_mistakes.txt`: all that is wrong with it, in the order of its lines."""
LINES = MANY.with_suffix(".txt").read_text("utf-8").splitlines()


def test_all_mistakes_of_a_file_are_told_at_once(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["robots", str(MANY)]) == 1
    told = capsys.readouterr().err.replace(f"{MANY.parent}/", "").splitlines()
    assert told == [f"unicon: error: {LINES[0]}", *LINES[1:]]
    numbers = [int(line.split(":")[1]) for line in told[1:]]
    assert len(numbers) >= 18
    assert numbers == sorted(numbers)


def test_check_has_a_finding_for_each_mistake(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(MANY.parent)
    assert main(["check", "go2_stand", "--set", f"robot={MANY}"]) == 1
    told = " ".join(capsys.readouterr().out.split())
    assert f"{len(LINES) - 1} findings" in told
    for line in LINES[1:]:
        number, _, finding = line.strip().partition(". ")
        assert f" {number}. robot: {finding} [build]" in told


def test_file_of_another_version_is_told_that_alone(tmp_path: Path) -> None:
    path = tmp_path / "many.yaml"
    path.write_text(MANY.read_text("utf-8").replace("robot/1", "robot/2"), "utf-8")
    with pytest.raises(RobotError) as caught:
        load_robot(path)
    assert str(caught.value) == (f"{path}:1: schema is 'unicon.robot/2'; write unicon.robot/1")


def test_a_file_of_a_thousand_mistakes_is_cut_off(tmp_path: Path) -> None:
    path = tmp_path / "many_mistakes.yaml"
    text = MANY.read_text("utf-8").replace("  - knee\n", "  - knee\n" * 1000)
    path.write_text(text, "utf-8")
    with pytest.raises(RobotError) as caught:
        load_robot(path)
    count = len(LINES) - 1 + 999
    assert len(caught.value.problems) == count
    *_, last = lines = str(caught.value).splitlines()
    assert len(lines) == 1 + RobotError.LISTED + 1
    assert last.endswith(f". … and {count - RobotError.LISTED} more")


def test_overlay_names_every_joint_that_is_absent(tmp_path: Path) -> None:
    path = tmp_path / "weak.yaml"
    path.write_text(
        "schema: unicon.robot/1\nextends: go2\n"
        "simulated:\n  nose: {friction: 1}\n  tail: {friction: 2}\n",
        "utf-8",
    )
    with pytest.raises(RobotError) as caught:
        load_robot(path)
    where = [problem.where for problem in caught.value.problems]
    assert where == [f"{path}:4", f"{path}:5"]


def test_every_broken_file_has_a_message_and_the_reverse() -> None:
    assert {p.stem for p in FILES} == {p.stem for p in BAD.glob("*.txt")}
    assert len(FILES) >= 50


def test_unknown_robot_names_the_close_match_and_the_remedy() -> None:
    with pytest.raises(RobotError) as caught:
        load_robot("g1_29dofs")
    message = str(caught.value)
    assert message.startswith("unknown robot 'g1_29dofs'; did you mean 'g1_29dof'? known: a1, ")
    assert message.endswith("or give a path to a .yaml file")


def test_unknown_path_is_named() -> None:
    with pytest.raises(RobotError, match=r"^no file nowhere/robot\.yaml; give an existing path"):
        load_robot("nowhere/robot.yaml")


def test_file_that_is_no_text_is_named(tmp_path: Path) -> None:
    path = tmp_path / "binary.yaml"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(RobotError, match=r"binary\.yaml: cannot be read: "):
        load_robot(path)
