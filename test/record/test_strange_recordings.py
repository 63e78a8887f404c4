"""Recordings of another machine, of two runs at once, copied, or still being written: one line."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rosbags")

from test_recorded_runs import recorded, written

from unicon_lab.recording import McapFile
from unicon_ros.cli.main import main


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    """A recording of 20 ticks."""
    recorded(written(tmp_path, duration=0.4), tmp_path / "run.mcap")
    return tmp_path / "run.mcap"


def refused(capsys: pytest.CaptureFixture[str], *arguments: Any) -> str:
    """Run a command, which is refused in one line; return that."""
    assert main([*map(str, arguments)]) == 1
    told = capsys.readouterr().err.splitlines()
    told = [line for line in told if not line.startswith("unicon analyze: reading")]
    assert len(told) == 1, told
    return told[0]


def every_reader(path: Path, out: Path) -> list[tuple[Any, ...]]:
    return [
        ("bag", "info", path),
        ("bag", "export", path, out / "x.csv"),
        ("replay", path, "--verify"),
        ("replay", path, "--speed", "max", "--no-ros"),
        ("replay", path, "--play", "--no-ros"),
        ("analyze", path, path, "--out", out / "gap"),
        ("analyze", path, "--fit", "--out", out / "fit"),
    ]


def test_a_folder_of_two_runs(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "two"
    folder.mkdir()
    bag.rename(folder / "two_0.mcap")
    recorded(written(tmp_path, duration=0.4), folder / "two_1.mcap")
    for arguments in every_reader(folder, tmp_path):
        told = refused(capsys, *arguments)
        assert "two_1.mcap is of another run than two_0.mcap (run): a folder is read" in told
    assert "move it to a folder of its own" in refused(capsys, "bag", "recover", folder)
    assert not (folder / "metadata.yaml").exists()


def test_a_folder_with_a_copy(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "copied"
    folder.mkdir()
    for number in range(2):
        shutil.copy(bag, folder / f"copied_{number}.mcap")
    for arguments in every_reader(folder, tmp_path):
        told = refused(capsys, *arguments)
        assert "copied_1.mcap has ticks that another file of its folder has, too" in told


def test_files_that_stayed_on_another_machine(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    there = tmp_path / "there"
    there.mkdir()
    overlay = "schema: unicon.robot/1\nextends: go2\nsimulated: {}\n"
    (there / "mine.yaml").write_text(overlay, "utf-8")
    path = tmp_path / "run.mcap"
    recorded(written(there, robot="./mine.yaml", duration=0.4), path)
    there.rename(tmp_path / "elsewhere")
    for arguments in (("--verify",), ("--speed", "max", "--no-ros")):
        told = refused(capsys, "replay", path, *arguments)
        assert f"the recorded workflow has robot: ./mine.yaml, which was in {there}" in told
        assert "give another: --set robot=NAME, or a WORKFLOW" in told
    told = refused(capsys, "analyze", path, "--fit", "--out", tmp_path / "fit")
    assert f"run.mcap: its robot 'go2' is not here (./mine.yaml was in {there})" in told
    assert "--robot" in told
    assert main(["replay", str(path), "--verify", "--set", "robot=go2"]) == 0
    assert "0 of 20 ticks differ" in capsys.readouterr().out
    policy = ("--set", "robot=go2", "--set", "policies.walk=./gone")
    told = refused(capsys, "replay", path, "--verify", *policy)
    assert "policy './gone': no such file" in told


@pytest.mark.parametrize("name", ["x" * 300, "~nobody-of-this-name/x.mcap", "a/b.mcap"])
def test_names_that_no_file_has(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for arguments in [*every_reader(Path(name), tmp_path), ("bag", "recover", name)]:
        assert name in refused(capsys, *arguments)
    replays: list[dict[str, Any]] = [
        {"platform": "replay", "platforms": {"replay": {"bag": name}}},
        {"flow": {"recorded": {"bag": name}}},
    ]
    for options in replays:
        workflow = written(tmp_path, **options)
        assert name in refused(capsys, "run", workflow, "--no-ros", "--speed", "max")


@pytest.mark.parametrize("start", [1e308, -1.0, 0.41])
def test_a_start_that_is_not_in_it(
    start: float, bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    platforms = {"replay": {"bag": str(bag), "start": start}}
    workflow = written(tmp_path, platform="replay", platforms=platforms)
    told = refused(capsys, "run", workflow, "--no-ros", "--speed", "max")
    assert "the record is 0.38 s long; give less, from 0 on" in told


def test_what_is_being_written(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    raw = bag.read_bytes()
    bag.unlink()
    file = McapFile(bag)  # which holds the lock, as a run does
    file.partial.write_bytes(raw)
    for arguments in every_reader(bag, tmp_path):
        assert f"a run writes it, or was cut off: give {file.partial}" in refused(
            capsys, *arguments
        )
    for path in (bag, tmp_path / "nope.mcap"):
        assert f"cannot read {path}: there is no such file" in refused(
            capsys, "bag", "recover", path
        )
    told = refused(capsys, "bag", "recover", file.partial)
    assert "is being written by another run; let that end first" in told
    assert file.partial.read_bytes() == raw
    assert main(["replay", str(file.partial), "--verify"]) == 0  # what is whole by now
    assert "0 of 20 ticks differ" in capsys.readouterr().out
    file.leave()
