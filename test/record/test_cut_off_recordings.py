"""Recordings of runs that are killed, or whose disk is full, at random moments."""

from __future__ import annotations

import json
import os
import random
import resource
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rosbags")

from rosbags.highlevel import AnyReader
from test_recorded_runs import written

from unicon_core.runtime import Runner, RunOptions
from unicon_core.workflow import Program, load_document
from unicon_lab.fault_record import FaultRecord
from unicon_lab.recording import Record, open_record
from unicon_lab.recording.background import BREATH_S, CHUNK_BYTES, CHUNK_ROWS
from unicon_lab.recording.recorder import Recorder
from unicon_lab.recording.run_recording import Recording
from unicon_ros.cli.main import main

RATE = 500


def killed(folder: Path, record: str, moment: float) -> int:
    """Record a robot at 500 Hz, kill it so long after it has begun; return when, in [ns]."""
    workflow = written(folder, platform="fake_robot", rate=RATE, start="none", flow="hold")
    run = subprocess.Popen(
        [
            *(sys.executable, "-m", "unicon_ros", "run", str(workflow), "--no-ros", "--yes"),
            *("--set", "safety=none", "--duration", "120", "--record", record, "--quiet"),
        ],
        stderr=subprocess.PIPE,
    )
    try:
        end = time.monotonic() + 60.0
        while not any(p.stat().st_size > 60_000 for p in folder.rglob("*.mcap.partial")):
            assert run.poll() is None, run.stderr.read() if run.stderr else ""
            assert time.monotonic() < end
            time.sleep(0.01)
        time.sleep(moment)
    finally:
        now = time.time_ns()
        run.send_signal(signal.SIGKILL)
        run.communicate(timeout=20)
    return now


def opened(path: Path) -> Record:
    """Open what was recovered, as rosbags and as we do; return it."""
    with AnyReader([path]) as reader:
        assert len(list(reader.messages())) == reader.message_count
        ticks = sum(c.msgcount for c in reader.connections if c.topic == "/unicon/ticks")
    record = open_record(path)
    assert len(record.ticks) == ticks > 0
    phases = np.flatnonzero(np.diff(record.ticks) != 1)
    assert all(record.ticks[k + 1] == 0 for k in phases)  # another phase begins to count
    assert record.memories[0]["before"] == 0
    assert json.loads(record.facts["options"])["speed"] == "real"
    return record


def test_what_killed_runs_leave_is_recovered(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folders = [tmp_path / "file", tmp_path / "folder"]
    for folder in folders:
        folder.mkdir()
    records = [str(folders[0] / "run.mcap"), f"{folders[1]}/run/"]
    with ThreadPoolExecutor() as at_once:
        list(at_once.map(killed, folders, records, (0.3, 0.6)))
    for folder in folders:
        (left,) = folder.rglob("*.partial")
        before = open_record(left)
        where = left.parent if left.parent != folder else left
        assert main(["bag", "recover", str(where)]) == 0
        (path,) = folder.rglob("*.mcap")
        assert capsys.readouterr().out.startswith(f"{path}: ")
        after = opened(where if where.is_dir() else path)
        assert after.ticks.tolist() == before.ticks.tolist()


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_fifty_kills_lose_a_second_at_most(tmp_path: Path) -> None:
    rng = random.Random(16)
    losses = []
    for number in range(50):
        folder = tmp_path / str(number)
        folder.mkdir()
        now = killed(folder, str(folder / "run.mcap"), rng.uniform(0.0, 2.0))
        assert main(["bag", "recover", str(folder / "run.mcap.partial")]) == 0
        (path,) = folder.glob("*.mcap")
        losses.append((now - int(opened(path).stamps[-1])) * 1e-9)
    print(f"lost: median {np.median(losses):.2f} s, most {max(losses):.2f} s")
    # A machine that others keep busy may hold up the writer, or the ticks, once or twice.
    assert sorted(losses)[-3] <= 1.0


@pytest.mark.parametrize(("name", "limit"), [("run.mcap", 70_000), ("run/", 400_000)])
def test_a_disk_that_is_full_leaves_what_was_written(name: str, limit: int, tmp_path: Path) -> None:
    full(tmp_path, name, limit)


def test_a_full_disk_takes_the_part_of_a_chunk_for_which_there_is_room(tmp_path: Path) -> None:
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    recorder = Recorder(tmp_path / "run.mcap", warn=str)
    write = recorder.channel("clock", "rosgraph_msgs/msg/Clock")
    for stamp in range(2000):
        assert write(stamp, bytes(12))
    resource.setrlimit(resource.RLIMIT_FSIZE, (80_000, before[1]))
    try:
        recorder.start()
        recorder.close()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    counts = recorder.counts()
    assert 500 < counts["messages"] < 2000
    assert counts["messages"] + counts["dropped"] == 2000
    with AnyReader([tmp_path / "run.mcap"]) as reader:
        assert [stamp for _, stamp, _ in reader.messages()] == list(range(counts["messages"]))


def test_chunks_are_small_so_that_no_tick_waits_long_for_the_thread(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "run.mcap", warn=str)
    writes = [recorder.channel(topic, "rosgraph_msgs/msg/Clock") for topic in ("clock", "other")]
    sizes = [12] * 3000 + [5000] * 100 + [12]  # CDR that nobody decodes
    for stamp, size in enumerate(sizes):
        assert writes[stamp % 2](stamp, bytes(size))
    recorder.start()
    recorder.close()
    chunks = [sum(chunk.counts.values()) for chunk in recorder._file.chunks]
    assert sum(chunks) == len(sizes) == recorder.counts()["messages"]
    assert max(chunks) == CHUNK_ROWS
    starts = [chunk.start for chunk in recorder._file.chunks]
    assert np.diff(starts).max() < CHUNK_BYTES + 16 * CHUNK_ROWS + 8000
    with AnyReader([tmp_path / "run.mcap"]) as reader:
        found = [(stamp, len(raw)) for _, stamp, raw in reader.messages()]
    assert found == list(enumerate(sizes))


def test_behind_each_chunk_a_tick_that_waits_may_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    slept: list[float] = []
    monkeypatch.setattr("unicon_lab.recording.background.time.sleep", slept.append)
    recorder = Recorder(tmp_path / "run.mcap", warn=str)
    write = recorder.channel("clock", "rosgraph_msgs/msg/Clock")
    for stamp in range(5 * CHUNK_ROWS):
        assert write(stamp, bytes(12))
    recorder.start()
    end = time.monotonic() + 20.0
    while recorder.counts()["messages"] < 5 * CHUNK_ROWS:
        assert time.monotonic() < end
    recorder.close()
    assert slept[:4] == [BREATH_S] * 4  # the end of the run waits for nothing


@pytest.mark.slow
def test_a_disk_that_is_full_at_any_moment(tmp_path: Path) -> None:
    rng = random.Random(17)
    for number in range(30):
        folder = tmp_path / str(number)
        folder.mkdir()
        full(folder, rng.choice(["run.mcap", "run/"]), round(10 ** rng.uniform(4.0, 6.2)))


def full(folder: Path, name: str, limit: int) -> None:
    """Record with files of that size at most: the run goes on, what was written opens."""
    warnings: list[str] = []
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    path = str(folder / name) + "/" * name.endswith("/")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("unicon_lab.recording.background.BLOCK_BYTES", 30_000)
        patch.setattr("unicon_lab.recording.background.BLOCKS", 60)
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, before[1]))
        try:
            recording = Recording(path, warn=warnings.append, patient=True)
            record = FaultRecord("off", recording=recording)
            document = load_document(written(folder, duration=20.0))
            program = Program(document, hooks=[recording.hook, record.hook])
            runner = Runner(program, RunOptions(speed="max", warn=str))
            record.attach(runner)
            report = runner.run()
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)
    counts = recording.counts()
    assert (report.ticks, report.faults) == (1000, [])
    assert counts["dropped"] > 0
    assert counts["error"].startswith("File too large")
    assert [w.count("\n") for w in warnings] == [0]
    files = [p for p in folder.rglob("*") if p.suffix in (".mcap", ".partial")]
    if not files:
        assert not counts["messages"]
        return
    (file,) = files
    if file.suffix == ".partial":
        assert not counts["messages"]
        return
    with AnyReader([file.parent if name.endswith("/") else file]) as reader:
        assert len(list(reader.messages())) == counts["messages"]
    found = open_record(file)
    assert found.ticks.tolist() == list(range(len(found.ticks)))
    assert os.path.getsize(file) <= limit
