"""`unicon run --picture` and `--record`: files that others can open."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import pytest

from unicon_ros.cli.main import main

RUN = ["run", "go2_stand", "--no-ros", "--speed", "max", "--duration", "1.0", "--quiet"]
FAKE = ["--set", "platform=fake"]


def test_the_picture_is_a_png(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    picture = tmp_path / "new" / "run.png"
    assert main([*RUN, *FAKE, "--picture", str(picture)]) == 0
    assert picture.read_bytes().startswith(b"\x89PNG\r\n")
    assert picture.stat().st_size > 20_000


def test_no_two_joints_share_a_colour(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    figures = pytest.importorskip("matplotlib.figure")
    drawn: list[Any] = []
    monkeypatch.setattr(figures.Figure, "savefig", lambda figure, *_, **__: drawn.append(figure))
    assert main([*RUN, *FAKE, "--picture", str(tmp_path / "run.png")]) == 0
    lines = next(axes for axes in drawn[0].axes if "joint" in axes.get_title()).get_lines()
    assert len({tuple(line.get_color()) for line in lines}) == len(lines) == 12


def test_without_matplotlib_the_run_does_not_begin(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert main([*RUN, *FAKE, "--picture", str(tmp_path / "run.png")]) == 1
    needs = "--picture needs matplotlib: pip install 'unicon_ros[plots]'"
    assert needs in capsys.readouterr().err


def test_a_recording_holds_what_the_map_publishes(tmp_path: Path) -> None:
    pytest.importorskip("rosbags")
    from rosbags.highlevel import AnyReader

    file = tmp_path / "run.mcap"
    assert main([*RUN, "--record", str(file)]) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run.mcap"]
    with AnyReader([file]) as reader:
        counts = {connection.topic: connection.msgcount for connection in reader.connections}
        assert counts["/joint_states"] == 50
        assert counts["/clock"] == 50
        connections = [c for c in reader.connections if c.topic == "/joint_states"]
        stamps, names = [], set()
        for connection, stamp, raw in reader.messages(connections):
            message = reader.deserialize(raw, connection.msgtype)
            assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == stamp
            stamps.append(stamp)
            names.add(tuple(message.name))
    assert stamps == [20_000_000 * i for i in range(50)]
    assert len(names) == 1
    assert names.pop()[0] == "FR_hip_joint"


def test_a_recording_is_never_overwritten(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("rosbags")
    file = tmp_path / "run.mcap"
    file.write_bytes(b"precious")
    assert main([*RUN, *FAKE, "--record", str(file)]) == 1
    assert f"recording {file} exists; move it away" in capsys.readouterr().err
    assert file.read_bytes() == b"precious"


@pytest.mark.ros
def test_with_ros_the_recording_holds_the_very_messages_that_left(tmp_path: Path) -> None:
    pytest.importorskip("rosbags")
    pytest.importorskip("rclpy")
    from rosbags.highlevel import AnyReader

    from unicon_core.runtime import Runner, RunOptions
    from unicon_core.workflow import load_workflow
    from unicon_lab.recording.run_recording import Recording
    from unicon_ros.bridge import RosSession

    file = tmp_path / "run.mcap"
    session = RosSession(map="default", warn=lambda line: None)
    try:
        recorder = Recording(file, "default", session).hook
        workflow = load_workflow("go2_stand", hooks=[session.hook, recorder])
        left: list[bytes] = []
        joints = next(out for out in session.outgoing if out.topic == "/joint_states")
        recorded, published = joints.tap, joints._publish
        assert recorded is not None
        joints._publish = lambda raw: (left.append(raw), published(raw))[1]
        runner = Runner(workflow, RunOptions(duration=0.5, speed="max"))
        session.attach(runner)
        runner.run()
    finally:
        session.close()
    with AnyReader([file]) as reader:
        connections = [c for c in reader.connections if c.topic == "/joint_states"]
        kept = [raw for _, _, raw in reader.messages(connections)]
        topics = {connection.topic for connection in reader.connections}
    assert len(left) == 25
    assert kept == left
    assert "/tf" in topics  # though this ROS may lack its type
