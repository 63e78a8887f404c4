"""docs/howto/transfer.md: its commands run, and its tables say what there is."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from unicon_lab.transfer.results import COLUMNS, OUTCOMES, SCHEMA, heads
from unicon_ros.cli.main import main

TEXT = (Path(__file__).resolve().parents[2] / "docs" / "howto" / "transfer.md").read_text("utf-8")


def test_its_columns_are_those_of_the_table(capsys: pytest.CaptureFixture[str]) -> None:
    told = re.findall(r"^\| ([a-zA-Z ]+) \| ", TEXT, re.MULTILINE)
    assert set(told) == {"column", "falls", "outcome"} | {name for name, *_ in COLUMNS.values()}
    printed = next(line for line in TEXT.splitlines() if line.startswith("platform  "))
    assert re.split(r"  +", printed) == heads()
    words = re.search(r"became of a run: (.*) \|", TEXT)
    assert words is not None
    assert sorted(words.group(1).split(", ")) == sorted(OUTCOMES.values())
    assert f"schema `{SCHEMA}`" in TEXT
    with pytest.raises(SystemExit):
        main(["transfer", "--help"])
    options = set(re.findall(r"--[a-z-]+", capsys.readouterr().out))
    assert set(re.findall(r"--[a-z]+", TEXT)) <= options


@pytest.mark.slow
def test_its_commands_run_and_go2_walks_in_both(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for package in ("pybullet", "matplotlib"):
        pytest.importorskip(package)
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"```sh\n(.*?)```", TEXT, re.DOTALL)
    lines = "".join(blocks).replace("\\\n", " ").splitlines()
    commands = [shlex.split(line, comments=True) for line in lines]
    assert [command[:2] for command in commands] == [
        ["unicon", "transfer"],
        ["unicon", "transfer"],
        ["unicon", "analyze"],
    ]
    for command in commands[1:]:  # the first one takes every simulator that is installed
        assert main(command[1:]) == 0, command
        printed = capsys.readouterr().out
        if command[1] == "analyze":
            assert "No joint stands out" in printed  # both are the same sound robot
            continue
        rows = [line.split() for line in printed.splitlines() if "3/3" in line]
        assert [row[0] for row in rows] == ["mujoco", "pybullet"]
        for row in rows:
            distance, share = float(row[2]), float(row[5])
            assert share == pytest.approx(100.0 * distance / 7.7, rel=0.01)
            assert 90.0 < share < 115.0
            assert row[-2:] == ["0", "done"]
