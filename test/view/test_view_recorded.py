"""`unicon view BAG`: a recording as a viewer shows it, and what is said where there is none."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from unicon_base.errors import UniconError
from unicon_core.runtime.phases import Phase
from unicon_lab.recording import open_record
from unicon_lab.view.recorded import RecordedSource, shown_in
from unicon_lab.view.source import Snapshot
from unicon_ros.cli.main import main

RUN = ["run", "go2_stand", "--set", "platform=fake", "--no-ros", "--speed", "max", "--quiet"]


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("bag") / "stand.mcap"
    assert main([*RUN, "--duration", "3", "--record", str(file)]) == 0
    return file


@pytest.fixture
def source(bag: Path) -> RecordedSource:
    record = open_record(bag)
    shown, notes = shown_in(record)
    assert notes == []
    return RecordedSource(record, shown)


def test_it_says_what_was_run(bag: Path) -> None:
    shown, _ = shown_in(open_record(bag))
    assert (shown.workflow, shown.platform, shown.robot.name) == ("go2_stand", "fake", "go2")
    assert shown.period == 0.02
    assert shown.model is not None
    assert shown.phases == tuple(phase.value for phase in Phase)
    assert not shown.drives
    assert shown.parameters == {}


def test_each_tick_is_the_recorded_one_to_the_bit(bag: Path, source: RecordedSource) -> None:
    record = open_record(bag)
    assert source.span == (0.0, pytest.approx(149 * 0.02))
    for moment in (0.0, 1.0, 2.5, 1.0, 99.0, -1.0):
        source.seek(moment)
        row = min(max(round(moment / 0.02), 0), 149)
        tick = source.latest()
        assert tick is not None
        assert (tick.tick, tick.handle) == (row, row + 1)
        assert shown_in(record)[0].phases[tick.phase] == record.phases[row]
        for name in record.layout.specs:
            wanted = record.states(name)[row]
            assert np.asarray(tick.states[name]).tobytes() == wanted.tobytes(), name
    source.seek(float("nan"))
    assert source.latest().tick == 0  # type: ignore[union-attr]


def test_what_lies_between_two_looks_is_given_once_and_in_order(source: RecordedSource) -> None:
    def ticks(handle: int) -> list[int]:
        return [tick.tick for tick in source.since(handle)]

    source.seek(0.1)
    assert ticks(0) == [0, 1, 2, 3, 4, 5]
    source.seek(0.2)
    assert ticks(6) == [6, 7, 8, 9, 10]
    assert ticks(11) == []
    source.seek(0.04)
    assert ticks(11) == []  # back in time: nothing is new
    source._most = 4
    source.seek(2.0)
    assert ticks(3) == [97, 98, 99, 100]  # of a long leap the last ones


def test_it_plays_by_itself_as_fast_as_told(
    source: RecordedSource, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = [100.0]
    monkeypatch.setattr("unicon_lab.view.recorded.time.monotonic", lambda: now[0])
    source.speed = 2.0
    assert source.play_on()
    now[0] += 0.5
    assert source.play_on()
    tick = source.latest()
    assert tick is not None
    assert tick.tick == 50
    now[0] += 50.0
    assert not source.play_on()
    tick = source.latest()
    assert tick is not None
    assert tick.tick == 149


def test_stamps_that_jump_back_leave_the_number_as_time(bag: Path) -> None:
    record = open_record(bag)
    stamps = record.stamps.copy()
    stamps[70:] -= stamps[69]  # as of a reset
    object.__setattr__(record, "stamps", stamps)
    jumped = RecordedSource(record, shown_in(record)[0])
    assert jumped.span[1] == pytest.approx(149 * 0.02)


def test_a_recording_of_a_workflow_that_is_not_here_is_shown_all_the_same(bag: Path) -> None:
    record = open_record(bag)
    record.facts["workflow_effective"] = "name: x\npolicies: {walk: nowhere}\n"  # type: ignore[index]
    shown, notes = shown_in(record)
    assert len(notes) == 1
    assert "its workflow is not built here" in notes[0]
    assert shown.robot.name == "go2"
    assert shown.model is not None
    tick: Snapshot | None = RecordedSource(record, shown, notes).latest()
    assert tick is not None
    assert tick.states["joint_pos"].shape == (12,)
    record.facts["robot"] = "nobody"  # type: ignore[index]
    record.facts["robot_path"] = "/nowhere/nobody.yaml"  # type: ignore[index]
    with pytest.raises(UniconError, match="nobody"):
        shown_in(record)


def test_what_cannot_be_shown_is_told_in_one_line(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def told(path: Path) -> str:
        assert main(["view", str(path)]) == 1
        lines = capsys.readouterr().err.splitlines()
        assert len(lines) == 1, lines
        return lines[0]

    assert "there is no such file or folder; correct the name" in told(tmp_path / "none.mcap")
    (tmp_path / "empty.mcap").write_bytes(b"")
    assert "is not a record of ticks" in told(tmp_path / "empty.mcap")
    (tmp_path / "foreign.mcap").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(100))
    assert "unicon bag import" in told(tmp_path / "foreign.mcap")
    (tmp_path / "folder").mkdir()
    assert "has no recording in it" in told(tmp_path / "folder")
    topics = topics_alone(tmp_path / "topics.mcap")
    assert "make one with unicon bag import" in told(topics)


def topics_alone(path: Path) -> Path:
    """Write a bag of messages, without our states, by the reference writer."""
    writing = pytest.importorskip("mcap.writer")
    with path.open("wb") as stream:
        writer = writing.Writer(stream)
        writer.start("ros2")
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        channel = writer.register_channel("/chatter", "cdr", schema)
        writer.add_message(channel, 1, b"\0\1\0\0\2\0\0\0a\0", 1)
        writer.finish()
    return path


def test_what_a_kill_left_is_shown_as_far_as_it_is_whole(bag: Path, tmp_path: Path) -> None:
    left = tmp_path / "left.mcap.partial"
    raw = bag.read_bytes()
    left.write_bytes(raw[: len(raw) * 6 // 10])
    record = open_record(left)
    source = RecordedSource(record, shown_in(record)[0])
    source.seek(source.span[1])
    tick = source.latest()
    assert tick is not None
    assert 0 < tick.tick < 149


@pytest.mark.slow
@pytest.mark.parametrize("sink", ["page", "foxglove"])
def test_the_command_shows_it_until_ctrl_c(bag: Path, sink: str) -> None:
    package, extra = {"page": ("viser", "view"), "foxglove": ("foxglove", "foxglove")}[sink]
    pytest.importorskip(package, reason=f"pip install 'unicon_ros[{extra}]'")
    command = [sys.executable, "-m", "unicon_ros", "view", str(bag), "--in", sink]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True) as run:
        assert run.stdout is not None
        assert "go2_stand on go2 (fake): 150 ticks, 2.98 s" in run.stdout.readline()
        assert re.search(r"view: (http|ws)://127\.0\.0\.1:\d+", run.stdout.readline())
        time.sleep(1.0)
        assert run.poll() is None
        os.kill(run.pid, signal.SIGINT)
        assert run.wait(10.0) in (0, 130)
        assert run.stderr is not None
        assert run.stderr.read() == ""
