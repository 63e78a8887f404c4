"""Which messages a bag has, under which names, with which QoS: as `ros2 bag` would have them."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

pytest.importorskip("mujoco")
pytest.importorskip("rosbags")
pytest.importorskip("mcap_ros2", reason="another reader: pip install mcap-ros2-support")

from recordings import read_by_both
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability, QosReliability
from rosbags.rosbag2 import Reader

from unicon_base.errors import UniconError
from unicon_lab.recording.recorder import Recorder
from unicon_lab.recording.recover import recover_folder
from unicon_ros.cli.main import main

WORKFLOW = """\
schema: unicon.workflow/1
robot: go2
platform: mujoco
rate: 50
duration: 2.0
flow: {hold: {}}
"""
LEGS = "float32[12] angles\nmy_msgs/Place place\n"
MAP = """\
messages: [my_msgs/msg]
publish:
  - topic: legs
    type: my_msgs/msg/Legs
    qos: {reliability: best_effort, depth: 3}
    fields: {angles: joint_pos, place.x: "base_pos_w[0]"}
"""


@pytest.fixture
def record(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, str]]:
    """Runs the workflow at full speed; returns the exit status and what was said."""
    path = tmp_path / "workflow.yaml"
    path.write_text(WORKFLOW)

    def run(file: Path | str, *options: str) -> tuple[int, str]:
        always = ("--no-ros", "--speed", "max", "--quiet", "--faults", "off")
        status = main(["run", str(path), "--record", str(file), *always, *options])
        return status, capsys.readouterr().err

    return run


@pytest.fixture
def own_types(tmp_path: Path) -> Path:
    """A map with message types of its own."""
    folder = tmp_path / "my_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "Legs.msg").write_text(LEGS)
    (folder / "Place.msg").write_text("float64 x\n")
    path = tmp_path / "map.yaml"
    path.write_text(MAP)
    return path


def test_message_types_of_the_map_are_in_the_bag(
    record: Callable[..., tuple[int, str]], own_types: Path, tmp_path: Path
) -> None:
    file = tmp_path / "own.mcap"
    assert record(file, "--map", str(own_types)) == (0, "")
    assert len(read_by_both(file)["/legs"]) == 100
    with AnyReader([file]) as reader:
        (connection,) = (c for c in reader.connections if c.topic == "/legs")
        messages = [reader.deserialize(r, c.msgtype) for c, _, r in reader.messages([connection])]
    assert messages[0].angles.shape == (12,)
    assert messages[-1].place.x != 0.0


def test_what_cannot_be_recorded_leaves_no_file_in_the_way(
    record: Callable[..., tuple[int, str]], own_types: Path, tmp_path: Path
) -> None:
    own_types.write_text(MAP.replace("Place.x", "Place.y").replace("place.x", "place.y"))
    before = sorted(tmp_path.rglob("*"))
    for name in ("own.mcap", "folder/", "deeper/own.mcap"):
        status, said = record(f"{tmp_path}/{name}", "--map", str(own_types))
        assert status == 1
        assert "place.y" in said
    left = {path.name for path in tmp_path.rglob("*")} - {path.name for path in before}
    assert left <= {"deeper"}  # a folder that was asked for
    own_types.write_text(MAP)
    assert record(tmp_path / "own.mcap", "--map", str(own_types)) == (0, "")


def test_names_are_full_and_the_robot_can_be_seen(
    record: Callable[..., tuple[int, str]], tmp_path: Path
) -> None:
    file = tmp_path / "walk.mcap"
    named = ("--namespace", "robot1", "--frame-prefix", "robot1/")
    assert record(file, *named) == (0, "")
    found = read_by_both(file)
    counts = {topic: len(stamps) for topic, stamps in found.items()}
    assert counts.pop("/unicon/ticks") == 100
    assert counts == {
        "/robot1/joint_states": 100,
        "/robot1/imu/data": 100,
        "/robot1/odom": 100,
        "/robot1/robot_description": 1,
        "/clock": 100,
        "/tf": 200,  # odometry and the links, on one topic
        "/tf_static": 1,
    }
    with AnyReader([file]) as reader:
        frames, described, joints = set(), [], []
        for connection, stamp, raw in reader.messages():
            if connection.topic == "/unicon/ticks":
                continue
            message: Any = reader.deserialize(raw, connection.msgtype)
            for each in getattr(message, "transforms", ()):
                frames |= {each.header.frame_id, each.child_frame_id}
            if connection.topic == "/robot1/robot_description":
                described.append((stamp, message.data))
            if connection.topic == "/robot1/joint_states":
                joints.append(stamp)
    assert all(frame.startswith("robot1/") for frame in frames)
    assert {"robot1/odom", "robot1/base_link", "robot1/FL_calf"} <= frames
    ((stamp, urdf),) = described
    assert urdf.startswith("<?xml")
    assert "FL_calf_joint" in urdf
    assert stamp <= min(joints)


def test_qos_is_told_as_ros2_bag_tells_it(
    record: Callable[..., tuple[int, str]], own_types: Path, tmp_path: Path
) -> None:
    file, folder = tmp_path / "own.mcap", tmp_path / "own"
    assert record(file, "--map", str(own_types)) == (0, "")
    assert record(f"{folder}/", "--map", str(own_types)) == (0, "")
    content = yaml.safe_load((folder / "metadata.yaml").read_text())
    listed = content["rosbag2_bagfile_information"]["topics_with_message_count"]
    told = {each["topic_metadata"]["name"]: each["topic_metadata"] for each in listed}
    # Numbers in a text: what Humble's player reads, and later ones too.
    (legs,) = yaml.safe_load(told["/legs"]["offered_qos_profiles"])
    assert legs["history"] == 1
    assert legs["deadline"] == {"sec": 9223372036, "nsec": 854775807}
    for path in (file, folder):
        with AnyReader([path]) as reader:
            profiles = {c.topic: c.ext.offered_qos_profiles for c in reader.connections}
        (of_legs,), (of_frames,) = profiles["/legs"], profiles["/tf_static"]
        assert (of_legs.reliability, of_legs.depth) == (QosReliability.BEST_EFFORT, 3)
        assert of_frames.durability == QosDurability.TRANSIENT_LOCAL
        assert profiles["/unicon/ticks"] == []


def test_every_file_of_a_folder_begins_with_what_is_latched(
    record: Callable[..., tuple[int, str]], tmp_path: Path
) -> None:
    folder = tmp_path / "walk"
    assert record(f"{folder}/", "--record-split", "0.5s") == (0, "")
    files = sorted(folder.glob("*.mcap"))
    assert len(files) > 2
    for file in files:
        found = read_by_both(file)
        for topic in ("/robot_description", "/tf_static"):
            (stamp,) = found[topic]
            assert stamp <= min(found["/joint_states"])
    with Reader(folder) as reader:
        counts = {c.topic: c.msgcount for c in reader.connections}
        assert reader.message_count == sum(counts.values())
    assert counts["/robot_description"] == len(files)
    assert counts["/joint_states"] == 100


def test_a_folder_that_was_cut_off_gets_its_qos_back(
    record: Callable[..., tuple[int, str]], tmp_path: Path
) -> None:
    folder = tmp_path / "walk"
    assert record(f"{folder}/", "--record-split", "0.5s") == (0, "")
    whole = (folder / "metadata.yaml").read_text()
    (folder / "metadata.yaml").unlink()
    last = sorted(folder.glob("*.mcap"))[-1]
    last.rename(f"{last}.partial")
    recover_folder(folder)
    assert yaml.safe_load((folder / "metadata.yaml").read_text()) == yaml.safe_load(whole)


def test_a_disk_with_room_for_no_message_is_left_empty(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """There is room for a chunk, but then not for the summary, whose room it was."""
    real = os.pwritev
    for name in ("run.mcap", "run/"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        recorder = Recorder(f"{tmp_path}/{name}", warn=lambda line: None)
        write = recorder.channel("/clock", "rosgraph_msgs/msg/Clock")
        room = recorder._file.size + 200

        def full(descriptor: int, views: Any, position: int, room: int = room) -> int:
            if position + sum(len(view) for view in views) > room:
                raise OSError(28, "No space left on device")
            return real(descriptor, views, position)

        with monkeypatch.context() as patch:
            patch.setattr(os, "pwritev", full)
            write(1, bytes(12))
            recorder.start()
            recorder.close()
        counts = recorder.counts()
        assert (counts["messages"], counts["dropped"]) == (0, 1)
        assert counts["error"] == "No space left on device: nothing was recorded"
        assert list(tmp_path.iterdir()) == []  # the next try is not in its own way


def test_a_folder_that_a_killed_run_left_is_not_in_the_way_of_the_next(
    record: Callable[..., tuple[int, str]], tmp_path: Path
) -> None:
    folder = tmp_path / "walk"
    for number in (1, 2):
        assert record(f"{folder}/", "--record-split", "0.5s")[0] == 0
        (folder / "metadata.yaml").unlink()
        last = sorted(folder.glob("*.mcap"))[-1]
        last.rename(f"{last}.partial")
        status, said = record(f"{folder}/")
        assert status == 0
        aside = tmp_path / f"walk.recovered-{number}"
        assert f"messages are in {aside} now" in said
        with Reader(aside) as reader:
            counts = {c.topic: c.msgcount for c in reader.connections}
            assert counts["/joint_states"] == 100
        for path in folder.iterdir():
            path.unlink()
        (folder / "walk_0.mcap.partial").touch()  # killed before its first message
        assert record(f"{folder}/") == (0, "")
        shutil.rmtree(folder)
    folder.mkdir()
    (folder / "notes.txt").write_text("mine")
    (folder / "walk_0.mcap").write_text("mine")
    status, said = record(f"{folder}/")
    assert status == 1
    assert f"recording {folder} exists" in said
    assert sorted(path.name for path in folder.iterdir()) == ["notes.txt", "walk_0.mcap"]


def test_a_folder_that_another_run_writes_is_left_to_it(tmp_path: Path) -> None:
    other = Recorder(f"{tmp_path}/walk/")
    write = other.channel("/clock", "rosgraph_msgs/msg/Clock")
    other.start()
    with pytest.raises(UniconError, match="is being written by another run"):
        Recorder(f"{tmp_path}/walk/")
    write(1, bytes(12))
    other.close()
    assert read_by_both(tmp_path / "walk" / "walk_0.mcap") == {"/clock": [1]}
