"""Each broken robot file in `bad/` gets the message that stands beside it, exactly."""

from __future__ import annotations

from pathlib import Path

import pytest

from unicon_core.errors import RobotError
from unicon_core.robots import load_robot

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
