"""Pictures and clouds in recordings: the frames of rings by their handles, beside the ticks."""

from __future__ import annotations

import json
import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags")

from picturing import picture, run
from replaying import replay
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore
from test_recorded_runs import written

from unicon_base.errors import StateError, UniconError
from unicon_core.handles import FrameRing
from unicon_lab.recording import open_record
from unicon_lab.recording.recorded_topics import RecordedFrames
from unicon_lab.recording.recorder import Recorder
from unicon_lab.recording.records import Large
from unicon_lab.recording.run_recording import Recording
from unicon_ros.bridge.images import frame_message
from unicon_ros.cli.main import main
from unicon_ros.peripheral import FrameSource

STORE = get_typestore(Stores.ROS2_JAZZY)


def test_a_ticks_handle_finds_its_frame_to_the_bit(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cameras = {"every": 3}, {"prefix": "rear", "every": 4, "kind": "depth"}
    record, counts = run(tmp_path, *cameras, frames=["all"])
    assert counts["dropped"] == 0
    assert counts["frames"] == {
        "front": {"frames": 17, "missed": 0},
        "rear": {"frames": 13, "missed": 0},
    }
    assert record.frame_names == ("front", "rear")
    frames, handles = record.frames("front"), record.states("front_handle")
    assert frames.handles.tolist() == list(range(1, 18))
    for row, index in enumerate(frames.at(handles).tolist()):
        raw = frames.message(index)
        message: Any = STORE.deserialize_cdr(raw, frames.type)
        seen = message.data.reshape(message.height, message.width, 3)
        assert np.array_equal(seen, picture(int(handles[row]), 48, 64))
        stamp = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
        assert stamp == frames.stamps[index]
    with AnyReader([tmp_path / "run.mcap"]) as reader:
        topics = {c.topic: (c.msgtype, c.msgcount) for c in reader.connections}
        assert topics["/unicon/frames/rear"] == ("sensor_msgs/msg/Image", 13)
        assert len(list(reader.messages())) == reader.message_count
    assert main(["bag", "info", str(tmp_path / "run.mcap")]) == 0
    assert "/unicon/frames/front  sensor_msgs/msg/Image" in capsys.readouterr().out
    assert replay(record) == []
    with pytest.raises(StateError, match=r"no frames 'fron' in .*; did you mean 'front'"):
        record.frames("fron")


def test_a_device_behind_send_is_not_asked_of_a_replay(tmp_path: Path) -> None:
    deferred = [{"call": {"function": "picturing:clock"}}]
    record, _ = run(tmp_path, workflow={"deferred": deferred})
    assert "front_handle" in json.loads(record.facts["outside"])["sent"]
    assert len(record.files["memory.json"]) < 50_000  # without its frames
    assert replay(record) == []


def test_frames_that_are_not_asked_for_are_not_recorded(tmp_path: Path) -> None:
    record, counts = run(tmp_path, {}, {"prefix": "rear"}, frames=["rear"])
    assert [*counts["frames"]] == ["rear"]
    assert record.frame_names == ("rear",)
    (tmp_path / "without").mkdir()
    record, counts = run(tmp_path / "without", {})
    assert "frames" not in counts
    assert record.frame_names == ()


def test_raw_pictures_become_jpegs_and_jpegs_stay(tmp_path: Path) -> None:
    image = pytest.importorskip("PIL.Image")
    record, counts = run(tmp_path, {}, {"prefix": "rear", "kind": "jpeg"}, frames=["all"], jpeg=95)
    frames = record.frames("front")
    assert frames.type == "sensor_msgs/msg/CompressedImage"
    for index, handle in enumerate(frames.handles.tolist()):
        message: Any = STORE.deserialize_cdr(frames.message(index), frames.type)
        assert message.format == "jpeg"
        assert message.header.frame_id == "front_optical_frame"
        (tmp_path / "x.jpg").write_bytes(message.data.tobytes())
        seen = np.asarray(image.open(tmp_path / "x.jpg")).astype(int)
        assert np.abs(seen - picture(handle, 48, 64)).mean() < 8.0
        stamp = message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec
        assert stamp == frames.stamps[index]
    kept = record.frames("rear")
    for index, handle in enumerate(kept.handles.tolist()):
        message = STORE.deserialize_cdr(kept.message(index), kept.type)
        assert message.data.tobytes() == b"\xff\xd8" + bytes([handle % 256]) * handle
    assert max(len(frames.message(row)) for row in range(25)) < 48 * 64 * 3
    assert counts["frames"]["rear"] == {"frames": 25, "missed": 0}


def test_a_recording_in_files_has_its_frames_in_all_of_them(tmp_path: Path) -> None:
    record, counts = run(tmp_path, {}, name="run", frames=["front"], split="100kB")
    assert len(record.paths) > 1
    assert record.frames("front").handles.tolist() == list(range(1, 26))
    assert counts["dropped"] == 0


def test_frames_that_nobody_has_are_refused(tmp_path: Path) -> None:
    with pytest.raises(UniconError, match="no block of the workflow has pictures or clouds; add"):
        run(tmp_path, frames=["all"])
    with pytest.raises(UniconError, match="no frames 'back'; known: all, front, rear"):
        run(tmp_path, {}, {"prefix": "rear"}, frames=["back"])
    assert not list(tmp_path.glob("*.mcap*"))


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--record-frames", "all"], "--record-frames goes with --record FILE.mcap; add it"),
        (["--record", "x.mcap", "--record-jpeg", "90"], "--record-jpeg goes with --record-frames"),
    ],
)
def test_options_that_want_another_one_say_so(
    arguments: list[str], told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["run", "go2_walk", "--no-ros", *arguments]) == 1
    assert told in capsys.readouterr().err


@pytest.mark.parametrize("text", ["0", "101", "nine"])
def test_a_quality_that_is_none_is_refused(text: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["run", "go2_walk", "--record-jpeg", text])
    assert "--record-jpeg" in capsys.readouterr().err


def test_a_quality_that_python_gives_is_checked_too(tmp_path: Path) -> None:
    with pytest.raises(UniconError, match="101 is not a quality of a JPEG; give 1 to 100, or 0"):
        Recording(tmp_path / "run.mcap", frames=["all"], jpeg=101)


class Rig:
    """A recorder of one ring, without a program."""

    def __init__(self, folder: Path) -> None:
        self.message = frame_message("color", 64, 48, "front")
        self.ring = FrameRing.create(len(self.message.template))
        self.warnings: list[str] = []
        self.recorder = Recorder(folder / "run.mcap", self.warnings.append)
        sources = {"front": FrameSource(self.ring, self.message)}
        self.frames = RecordedFrames(
            self.recorder, sources, time.time_ns, warn=self.warnings.append
        )

    def shoot(self, count: int = 1) -> None:
        for _ in range(count):
            self.ring.fill()[:] = np.uint8(self.ring.latest % 256)
            self.ring.commit(time.time_ns())

    def close(self) -> dict[str, int]:
        self.frames.close()
        self.recorder.close()
        self.ring.close()
        return self.frames.counts()["front"]


def test_frames_that_were_overwritten_are_counted(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    rig.shoot(3)
    stream = rig.frames._streams["front"]
    stream.take(1)
    rig.shoot(20)
    stream.take(2)
    assert stream.missed == 16
    rig.recorder.start()
    assert rig.close() == {"frames": 7, "missed": 16}
    assert rig.recorder.counts()["messages"] == 7


def test_memory_is_used_again_and_has_a_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("unicon_lab.recording.records.MOST_BYTES", 1000)
    woken: list[int] = []
    large = Large(1, 200, lambda: woken.append(1))
    rooms = set()
    for number in range(10):
        room = large.room()
        if room is None:
            break
        rooms.add(room.__array_interface__["data"][0])
        large.put(len(room), number, 5, 6)
    assert (len(large.waiting), large.crowded, len(woken)) == (4, 1, 3)
    for _ in range(3):
        large.free(True)
        room = large.room()
        assert room is not None
        rooms.add(room.__array_interface__["data"][0])
        large.put(1, 1, 5, 6)
    assert len(rooms) == 4


def test_what_goes_wrong_with_frames_leaves_the_run(tmp_path: Path) -> None:
    rig = Rig(tmp_path)
    rig.frames.start()
    rig.frames._streams["front"].large.room = None  # type: ignore[assignment, method-assign]
    rig.shoot()
    end = time.monotonic() + 5.0
    while not rig.warnings and time.monotonic() < end:
        time.sleep(0.01)
    assert "frames are recorded no longer: 'NoneType' object is not callable" in rig.warnings[0]
    rig.close()


# -- kills and full disks --------------------------------------------------------------------------


def started(folder: Path, *arguments: str, limit: int = 0) -> subprocess.Popen[str]:
    """Start a run at 100 Hz with a camera of 33 pictures a second."""
    size = {"height": 120, "width": 160, "slots": 16}
    call = {"function": "picturing:camera", "every": 3, **size}
    path = written(folder, rate=100, flow="hold", start="none", commands=[{"call": call}])

    def bounded() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

    here = str(Path(__file__).parent)
    return subprocess.Popen(
        [
            *(sys.executable, "-m", "unicon_ros", "run", str(path), "--no-ros", "--quiet"),
            *("--record", str(folder / "run.mcap"), "--record-frames", "all", *arguments),
        ],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": here},
        preexec_fn=bounded if limit else None,
    )


def test_what_a_killed_run_leaves_has_its_frames(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    process = started(tmp_path, "--set", "duration=60")
    partial = tmp_path / "run.mcap.partial"
    end = time.monotonic() + 60.0
    while not (partial.exists() and partial.stat().st_size > 2_000_000):
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < end
        time.sleep(0.02)
    process.send_signal(signal.SIGKILL)
    process.communicate(timeout=20)
    cut = open_record(partial).frames("front")
    assert main(["bag", "recover", str(partial)]) == 0
    capsys.readouterr()
    record = open_record(tmp_path / "run.recovered-1.mcap")
    frames = record.frames("front")
    assert frames.handles.tolist() == cut.handles.tolist()
    assert np.array_equal(frames.handles, np.arange(1, len(frames.handles) + 1))
    assert abs(record.stamps[-1] - frames.stamps[-1]) * 1e-9 < 1.0
    message: Any = STORE.deserialize_cdr(frames.message(3), frames.type)
    assert np.array_equal(message.data.reshape(120, 160, 3), picture(4, 120, 160))
    with AnyReader([tmp_path / "run.recovered-1.mcap"]) as reader:
        assert len(list(reader.messages())) == reader.message_count


def test_a_full_disk_ends_the_recording_and_not_the_run(tmp_path: Path) -> None:
    report = tmp_path / "report.json"
    arguments = ("--set", "duration=1.5", "--report", str(report))
    process = started(tmp_path, *arguments, limit=2_200_000)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 0, err
    told = json.loads(report.read_text("utf-8"))
    assert told["ticks"] == 150
    assert told["recording"]["error"].startswith("File too large")
    assert told["recording"]["dropped"] > 0
    frames = told["recording"]["frames"]["front"]
    record = open_record(tmp_path / "run.mcap")
    assert 0 < len(record.ticks) < 150
    handles = record.frames("front").handles
    assert np.array_equal(handles, np.arange(1, len(handles) + 1))
    # The file gives up its last chunks for its summary.
    assert 0 <= frames["frames"] - len(handles) <= 2
    assert frames["frames"] + frames["missed"] == 50
