"""`unicon bag`: recordings looked into, recovered, exported; bags and UniCon's npz imported."""

from __future__ import annotations

import csv
import json
import os
import shutil
import struct
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags")

from recordings import flat
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from test_recorded_runs import noise, recorded, written

from unicon_base.errors import UniconError
from unicon_core.robots import load_robot
from unicon_core.runtime import Runner, RunOptions
from unicon_core.workflow import Program, load_document
from unicon_lab.fault_record import FaultRecord
from unicon_lab.recording import Record, open_record, recover
from unicon_lab.recording.bag_folder import Split
from unicon_lab.recording.info import info_of
from unicon_lab.recording.recorder import Recorder
from unicon_lab.recording.run_recording import Recording
from unicon_lab.recording.scan import Scan, scan
from unicon_ros.cli.main import main

GO2 = load_robot("go2")
recovery = sys.modules["unicon_lab.recording.recover"]  # its package has a function of that name


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of 100 ticks."""
    folder = tmp_path_factory.mktemp("bag")
    recorded(written(folder), folder / "run.mcap", (noise,))
    return folder / "run.mcap"


def refused(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """Run the command, which is refused in one line; return it."""
    assert main(["bag", *map(str, arguments)]) == 1
    told = capsys.readouterr().err
    assert told.count("\n") == 1
    return told


def said(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    assert main(["bag", *map(str, arguments)]) == 0
    return capsys.readouterr().out


def without_end(raw: bytes) -> bytes:
    """Return a file of MCAP without its summary and what says that it is whole."""
    (begin,) = struct.unpack_from("<Q", raw, len(raw) - 8 - 20)
    return raw[: begin - 13]


# -- folders ---------------------------------------------------------------------------------------


def split_run(folder: Path, split: str, **more: Any) -> Record:
    """Record to a bag folder, chunk by chunk."""
    recording = Recording(f"{folder}/", patient=True, split=split)
    record = FaultRecord("off", recording=recording)
    document = load_document(written(folder.parent, duration=10.0, **more))
    program = Program(document, hooks=[recording.hook, record.hook])
    runner = Runner(program, RunOptions(speed="max", warn=str))
    record.attach(runner)
    runner.run()
    assert recording.counts()["error"] == ""
    return open_record(folder)


@pytest.mark.parametrize("split", ["90kB", "1GB,2s", ""])
def test_a_folder_is_one_bag_for_others_and_one_record_for_us(
    split: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("unicon_lab.recording.background.BLOCK_BYTES", 50_000)
    monkeypatch.setattr("unicon_lab.recording.background.BLOCKS", 40)
    record = split_run(tmp_path / "bag", split)
    names = sorted(path.name for path in (tmp_path / "bag").iterdir())
    files = [f"bag_{number}.mcap" for number in range(len(names) - 1)]
    assert names == sorted([*files, "metadata.yaml"])
    assert (len(files) > 3) == bool(split)
    assert [path.name for path in record.paths] == files
    assert record.ticks.tolist() == list(range(500))
    assert record.states("tick").reshape(-1).tolist() == list(range(500))
    assert record.states("tick", rows=slice(100, 400)).reshape(-1).tolist() == list(range(100, 400))
    with AnyReader([tmp_path / "bag"]) as reader:
        counts = {c.topic: c.msgcount for c in reader.connections}
        assert counts["/unicon/ticks"] == counts["/joint_states"] == 500
        assert len(list(reader.messages())) == sum(counts.values()) == reader.message_count
    part = open_record(tmp_path / "bag" / files[-1])
    assert part.facts["run"] == record.facts["run"]
    if split:
        assert part.ticks[-1] == 499
        assert part.memories == []
        assert int(part.facts["first_row"]) == part.ticks[0] > 0


def test_a_folder_that_a_kill_left_is_mended(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("unicon_lab.recording.background.BLOCK_BYTES", 50_000)
    monkeypatch.setattr("unicon_lab.recording.background.BLOCKS", 40)
    split_run(tmp_path / "bag", "150kB")
    left = tmp_path / "left"
    left.mkdir()
    for path in (tmp_path / "bag").glob("*.mcap"):
        shutil.copy(path, left / path.name)
    last = sorted(left.iterdir(), key=lambda path: int(path.stem.split("_")[1]))[-1]
    torn = last.with_name(f"{last.name}.partial")
    torn.write_bytes(without_end(last.read_bytes())[:-100])  # in the last chunk
    last.unlink()
    before = open_record(left)
    assert 0 < len(before.ticks) <= 500
    said(capsys, "recover", left)
    after = open_record(left)
    assert after.ticks.tolist() == before.ticks.tolist()
    assert not list(left.glob("*.partial"))
    with AnyReader([left]) as reader:
        assert len(list(reader.messages())) == reader.message_count


@pytest.mark.parametrize("text", ["1", "GB", "0s", "-1GB", "1 parsec", "1GB;2s", "nan s"])
def test_what_is_no_size_and_no_time_splits_nothing(text: str, tmp_path: Path) -> None:
    from unicon_base.errors import UniconError

    with pytest.raises(UniconError, match="give a size or a time, such as 500MB"):
        Split.of(text)
    assert Split.of("2kB, 1.5min") == Split(2000, 90_000_000_000)
    with pytest.raises(UniconError, match="give a name without"):
        Recorder(tmp_path / "run.mcap", split=Split(1))
    (tmp_path / "there").mkdir()
    with pytest.raises(UniconError, match="exists"):
        Recorder(f"{tmp_path}/there/")


# -- info and recover ------------------------------------------------------------------------------


@pytest.mark.parametrize(("skipped", "missing"), [(1, 0), (3, 2)])
def test_a_change_of_phase_skips_a_tick_that_nobody_misses(
    bag: Path, monkeypatch: pytest.MonkeyPatch, skipped: int, missing: int
) -> None:
    changed = open_record(bag)
    ticks = np.arange(100) + skipped * (np.arange(100) >= 60)
    changed.ticks, changed.phases = ticks, ("run",) * 60 + ("damp",) * 40
    monkeypatch.setattr("unicon_lab.recording.info.open_record", lambda *_: changed)
    assert info_of(bag)["missing_ticks"] == missing


def test_info_of_ours_of_others_and_of_what_is_cut_off(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = said(capsys, "info", bag)
    for line in ("ticks      100 at 50 Hz (run 100)", "/joint_states", "robot      go2"):
        assert line in text
    info = json.loads(said(capsys, "info", bag, "--json"))
    assert info["ticks"] == info["topics"]["/unicon/ticks"]["messages"] == 100
    assert info["cut_off"] is False
    assert info["missing_ticks"] == 0
    torn = tmp_path / "run.mcap.partial"
    torn.write_bytes(without_end(bag.read_bytes()))
    assert json.loads(said(capsys, "info", torn, "--json"))["cut_off"] is True
    assert "unicon bag recover" in said(capsys, "info", torn)
    said(capsys, "recover", torn)
    whole = json.loads(said(capsys, "info", tmp_path / "run.recovered-1.mcap", "--json"))
    assert whole["cut_off"] is False
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(without_end(bag.read_bytes()))
    said(capsys, "recover", cut)
    assert len(open_record(tmp_path / "cut.recovered-1.mcap").ticks) == 100
    assert cut.read_bytes() == without_end(bag.read_bytes())
    assert "is whole; there is nothing to recover" in refused(capsys, "recover", bag)
    assert not list(tmp_path.glob("*.partial"))
    plain = written_by_rosbags(tmp_path / "plain", StoragePlugin.SQLITE3)
    assert json.loads(said(capsys, "info", plain, "--json"))["messages"] == 60


def test_info_looks_through_a_file_once(bag: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    looked: list[Path] = []

    def look(path: Path) -> Scan:
        looked.append(path)
        return scan(path)

    for module in ("info", "read"):
        monkeypatch.setattr(f"unicon_lab.recording.{module}.scan", look)
    assert info_of(bag)["ticks"] == 100
    assert looked == [bag]


@pytest.mark.parametrize("content", [b"", b"garbage", b"\x89MCAP0\r\n", b"\x89MCAP0\r\n" * 40])
@pytest.mark.parametrize("name", ["x.mcap", "x.mcap.partial", "x.db3", "x.npz", "x"])
def test_garbage_is_one_line(
    name: str, content: bytes, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    out = tmp_path / "out.mcap"
    for arguments in (
        ("info", path),
        ("export", path, tmp_path / "x.csv"),
        ("import", path, out, "--robot", "go2"),
        *([("recover", path)] if content or not name.endswith(".partial") else []),
    ):
        told = refused(capsys, *arguments)
        assert f"{path} " in told or f"{path}:" in told
        assert "; " in told, told  # the remedy
    assert sorted(tmp_path.iterdir()) == [path]


def test_a_recording_without_a_name_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "go2_walk", "--no-ros", "--record", ""]) == 1
    told = capsys.readouterr().err
    assert "--record has no name; give FILE.mcap or FOLDER/" in told
    assert told.count("\n") == 1


def test_what_holds_no_message_yet(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    raw = bag.read_bytes()
    position = 8
    while raw[position] != 6:  # the first chunk
        position += 9 + int(struct.unpack_from("<Q", raw, position + 1)[0])
    for content in (b"", raw[:position]):
        left, whole = tmp_path / "run.mcap.partial", tmp_path / "run.mcap"
        left.write_bytes(content)
        told = said(capsys, "recover", left)
        assert told == f"{left}: its run was killed before a message was in it; it is deleted\n"
        assert not left.exists()
        whole.write_bytes(content)
        told = refused(capsys, "recover", whole)
        assert f"{whole} has no whole message of a recording in it" in told
        assert list(tmp_path.iterdir()) == [whole]
        whole.unlink()


def test_a_pipe_is_refused_and_not_waited_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("x.mcap", "x.mcap.partial", "x.db3"):
        pipe = tmp_path / name
        os.mkfifo(pipe)
        for arguments in (
            ("info", pipe),
            ("recover", pipe),
            ("export", pipe, tmp_path / "x.csv"),
            ("import", pipe, tmp_path / "out.mcap", "--robot", "go2"),
        ):
            assert name in refused(capsys, *arguments)
        pipe.unlink()


def test_what_is_not_a_recording_is_not_copied_before_it_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "large.mcap"
    path.touch()
    os.truncate(path, 1 << 40)
    monkeypatch.setattr(shutil, "copyfile", None)
    assert f"{path} is not a recording" in refused(capsys, "recover", path)
    assert list(tmp_path.iterdir()) == [path]


def test_what_stands_behind_damage_is_not_cut_away(
    bag: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    raw = bytearray(without_end(bag.read_bytes()))
    raw[int(open_record(bag)._scans[0].ticks[0]) + 8] ^= 255  # in its one chunk
    path = tmp_path / "run.mcap.partial"
    path.write_bytes(raw)
    monkeypatch.setattr(recovery, "REST", 1000)
    told = refused(capsys, "recover", path)
    assert "is damaged" in told
    assert "rename it to end in .mcap" in told
    assert path.read_bytes() == raw
    with pytest.raises(UniconError, match="is damaged"):  # nor does the next run of that name
        Recorder(tmp_path / "run.mcap")
    assert path.read_bytes() == raw
    path.rename(tmp_path / "run.mcap")
    told = refused(capsys, "recover", tmp_path / "run.mcap")  # a copy, of which nothing is whole
    assert "has no whole message" in told
    assert (tmp_path / "run.mcap").read_bytes() == raw


def test_ctrl_c_leaves_no_copy_of_what_is_recovered(
    bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def cut_off(source: Path, to: Path) -> None:
        to.write_bytes(b"half")
        raise KeyboardInterrupt

    path = tmp_path / "cut.mcap"
    path.write_bytes(without_end(bag.read_bytes()))
    monkeypatch.setattr(shutil, "copyfile", cut_off)
    with pytest.raises(KeyboardInterrupt):
        recover(path)
    assert list(tmp_path.iterdir()) == [path]


def test_a_folder_without_recordings_and_a_name_that_is_not_there(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for what in ("info", "recover"):
        refused(capsys, what, tmp_path)
        refused(capsys, what, tmp_path / "nope")
    assert "has no recording in it" in refused(capsys, "export", tmp_path, tmp_path / "x.csv")


# -- export ----------------------------------------------------------------------------------------


def test_what_is_exported_is_what_was_recorded(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    record = open_record(bag)
    said(capsys, "export", bag, tmp_path / "x.npz")
    with np.load(tmp_path / "x.npz") as file:
        for name in record.kept["sent"]:
            assert file[name].tobytes() == record.states(name).tobytes()
        assert file["phase"].tolist() == list(record.phases)
        assert file["joint_pos.names"].tolist() == list(GO2.joint_names)
    wanted = ("--states", "joint_pos", "base_quat", "--moment", "received")
    said(capsys, "export", bag, tmp_path / "x.csv", *wanted)
    with (tmp_path / "x.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == 100
    assert list(rows[0])[:5] == ["stamp_ns", "tick", "phase", "ended", "joint_pos.FR_hip_joint"]
    pos = record.states("joint_pos", "received")
    for k, row in enumerate(rows):
        told = [float(row[f"joint_pos.{name}"]) for name in GO2.joint_names]
        assert np.array(told, np.float32).tobytes() == pos[k].tobytes()


def test_exports_that_are_refused(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "there.csv").write_text("mine")
    for told, arguments in (
        ("give a name that ends in .npz, .csv, .parquet", ("x.txt",)),
        ("there.csv exists; move it away", ("there.csv",)),
        ("no state 'joint_po' at 'sent'; did you mean", ("x.csv", "--states", "joint_po")),
        ("no moment 'then'", ("x.csv", "--moment", "then")),
        ("cannot write", ("nowhere/x.csv",)),
    ):
        assert told in refused(capsys, "export", bag, tmp_path / arguments[0], *arguments[1:])
    assert [path.name for path in tmp_path.iterdir()] == ["there.csv"]


def test_parquet_asks_for_pyarrow(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    try:
        from pyarrow import parquet
    except ModuleNotFoundError:
        told = refused(capsys, "export", bag, tmp_path / "x.parquet")
        assert "export to Parquet needs pyarrow: pip install 'unicon_ros[parquet]'" in told
        return
    said(capsys, "export", bag, tmp_path / "x.parquet")
    table = parquet.read_table(tmp_path / "x.parquet")
    pos = open_record(bag).states("joint_pos")[:, 0]
    assert table["joint_pos.FR_hip_joint"].to_numpy().tobytes() == pos.tobytes()


# -- import ----------------------------------------------------------------------------------------


def written_by_rosbags(
    path: Path,
    storage: StoragePlugin,
    kind: str = "sensor_msgs/msg/JointState",
    count: int = 40,
    later: int = 0,
) -> Path:
    """Write a bag with rosbags alone: joints in another order, an IMU at half the rate.

    The IMU, and targets, begin with message `later` of the joints, which has no effort.
    """
    store = get_typestore(Stores.ROS2_JAZZY)
    types = store.types
    header, stamp = types["std_msgs/msg/Header"], types["builtin_interfaces/msg/Time"]
    names = list(reversed(GO2.joint_names))
    with Writer(path, version=9, storage_plugin=storage) as writer:
        joints = writer.add_connection("/joint_states", kind, typestore=store)
        imu = writer.add_connection("/imu/data", "sensor_msgs/msg/Imu", typestore=store)
        if later:
            kind_of_targets = "sensor_msgs/msg/JointState"
            targets = writer.add_connection("/joint_targets", kind_of_targets, typestore=store)
        for k in range(count):
            now = 10**9 + k * 20_000_000
            head = header(stamp(now // 10**9, now % 10**9), "")
            if kind != "sensor_msgs/msg/JointState":
                message: Any = types[kind](data="no joints")
            else:
                pos = np.arange(12.0)[::-1] + 0.01 * k
                message = types[kind](head, names, pos, 2 * pos, np.zeros(0))
            writer.write(joints, now, store.serialize_cdr(message, kind))
            if k == 2 * later > 0:
                wanted = types["sensor_msgs/msg/JointState"](head, names, pos, pos, pos)
                raw = store.serialize_cdr(wanted, "sensor_msgs/msg/JointState")
                writer.write(targets, now, raw)
            if k % 2 == 0 and k >= later:
                vector, quat = (
                    types["geometry_msgs/msg/Vector3"],
                    types["geometry_msgs/msg/Quaternion"],
                )
                text = types["sensor_msgs/msg/Imu"](
                    head,
                    quat(0.0, 0.0, np.sin(0.01 * k), np.cos(0.01 * k)),
                    np.zeros(9),
                    vector(0.1 * k, 0.0, 0.0),
                    np.zeros(9),
                    vector(0.0, 0.0, 9.81),
                    np.zeros(9),
                )
                writer.write(imu, now, store.serialize_cdr(text, "sensor_msgs/msg/Imu"))
    return path


@pytest.mark.parametrize("storage", [StoragePlugin.SQLITE3, StoragePlugin.MCAP])
def test_a_bag_by_rosbags_alone_becomes_a_record(
    storage: StoragePlugin, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plain = written_by_rosbags(tmp_path / "plain", storage)
    said(capsys, "import", plain, tmp_path / "x.mcap", "--robot", "go2")
    record = open_record(tmp_path / "x.mcap")
    expected = np.arange(12.0) + 0.01 * np.arange(40)[:, None]
    assert np.array_equal(record.states("joint_pos"), expected.astype(np.float32))
    assert np.array_equal(record.states("joint_vel"), (2 * expected).astype(np.float32))
    quat = record.states("base_quat", "received")
    assert quat.shape == (40, 4)
    assert np.allclose(quat[11], [np.cos(0.1), 0, 0, np.sin(0.1)], atol=1e-6)
    assert np.allclose(record.states("projected_gravity")[20], [0, 0, -1], atol=1e-6)
    assert record.stamps.tolist() == [10**9 + k * 20_000_000 for k in range(40)]
    assert float(record.facts["period_s"]) == pytest.approx(0.02)
    assert "joint_pos_target" not in record.kept["received"]
    said(capsys, "import", plain, tmp_path / "y.mcap", "--robot", "go2", "--rate", "100")
    slow = open_record(tmp_path / "y.mcap")
    assert np.diff(slow.stamps).tolist() == [10_000_000] * (len(slow.ticks) - 1)
    assert np.array_equal(slow.states("joint_pos")[::2], record.states("joint_pos")[:39])


WITH_TARGETS = """
subscribe:
  - {topic: joint_states, type: sensor_msgs/msg/JointState, missing: hold,
     fields: {name: $joint_names, position: joint_pos, velocity: joint_vel, effort: joint_effort}}
  - {topic: imu/data, type: sensor_msgs/msg/Imu, fields: {orientation: base_quat}}
  - {topic: joint_targets, type: sensor_msgs/msg/JointState,
     fields: {name: $joint_names, position: joint_pos_target}}
  - {topic: odom, type: nav_msgs/msg/Odometry, fields: {twist.twist.linear: base_lin_vel}}
"""


@pytest.mark.parametrize("rate", [(), ("--rate", "50")])
def test_what_a_bag_lacks_is_absent_and_not_zero(
    rate: tuple[str, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plain = written_by_rosbags(tmp_path / "plain", StoragePlugin.MCAP, later=10)
    (tmp_path / "own.yaml").write_text(WITH_TARGETS, "utf-8")
    arguments = (plain, tmp_path / "x.mcap", "--robot", "go2", "--map", tmp_path / "own.yaml")
    assert main(["bag", "import", *map(str, (*arguments, *rate))]) == 0
    told = capsys.readouterr().err.splitlines()
    assert told == [
        "unicon bag: ticks begin 0.2 s after the first message of /joint_states: /imu/data had "
        "none before",
        "unicon bag: /joint_targets begins 0.2 s later: until then joint_pos_target is NaN",
    ]
    record = open_record(tmp_path / "x.mcap")
    assert set(record.layout.specs) == {
        *("joint_pos", "joint_vel", "joint_pos_target", "base_quat", "projected_gravity"),
        *("stamp_ns", "tick"),
    }
    assert record.stamps[0] == 10**9 + 10 * 20_000_000
    targets = record.states("joint_pos_target")
    assert np.isnan(targets[:10]).all()
    assert np.array_equal(targets[10], (np.arange(12.0) + 0.2).astype(np.float32))
    assert np.isfinite(record.states("base_quat")).all()


@pytest.mark.slow
def test_identical_motion_with_and_without_recorded_targets_does_not_differ(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("matplotlib")
    plain = written_by_rosbags(tmp_path / "plain", StoragePlugin.MCAP)
    said(capsys, "import", plain, tmp_path / "real.mcap", "--robot", "go2")
    expected = np.arange(12.0) + 0.01 * np.arange(40)[:, None]
    expected = expected.astype(np.float32)
    own = {"joint_pos": expected, "joint_pos_target": expected, "dt": 0.02}
    np.savez(tmp_path / "sim.npz", joint_names=GO2.joint_names, **own)
    files = [str(tmp_path / name) for name in ("real.mcap", "sim.npz")]
    assert main(["analyze", *files, "--out", str(tmp_path / "out")]) == 0
    told = capsys.readouterr().out
    assert "No joint differs." in told
    assert "differs most" not in told


def test_bags_that_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plain = written_by_rosbags(tmp_path / "plain", StoragePlugin.MCAP)
    other = written_by_rosbags(tmp_path / "other", StoragePlugin.MCAP, "std_msgs/msg/String")
    out = tmp_path / "x.mcap"
    for told, arguments in (
        ("topic /joint_states is std_msgs/msg/String, and map ros_robot says", (other, out)),
        (
            "has no topic of map clock_in (clock); it has /imu/data, /joint",
            (plain, out, "--map", "clock_in"),
        ),
        ("every message of a topic was refused", (plain, out, "--robot", "n1")),
        ("give a name that ends in .mcap", (plain, tmp_path / "x.csv")),
        ("--joints goes with an .npz", (plain, out, "--joints", "a")),
        ("unknown robot 'go3'", (plain, out, "--robot", "go3")),
    ):
        assert told in refused(capsys, "import", "--robot", "go2", *arguments)
    assert not out.exists()


def unicon_npz(path: Path, **more: Any) -> Path:
    """Write what UniCon records."""
    frames = np.arange(30.0)[:, None]
    values = {
        "type": "unicon",
        "rec_dt": 0.02,
        "DOF_NAMES": np.array(list(reversed(GO2.joint_names))),
        "states_q": np.arange(12.0)[::-1] + 0.1 * frames,
        "states_q_ctrl": np.arange(12.0)[::-1] - 0.1 * frames,
        "states_quat": np.tile([0.0, 0.0, 0.6, 0.8], (30, 1)),
        "states_rpy": np.zeros((30, 3)),
        "states_cmd": np.tile([0.5, 0.0, 0.1, 7.0], (30, 1)),
        "args": np.array({"an": "object"}, object),
    } | more
    np.savez(path, **{key: value for key, value in values.items() if value is not None})
    return path


def test_the_keys_of_unicon_become_a_record(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    said(capsys, "import", unicon_npz(tmp_path / "x.npz"), tmp_path / "x.mcap", "--robot", "go2")
    record = open_record(tmp_path / "x.mcap")
    expected = np.arange(12.0) + 0.1 * np.arange(30)[:, None]
    assert np.array_equal(record.states("joint_pos", "received"), expected.astype(np.float32))
    assert record.states("joint_pos_target")[5, 3] == np.float32(2.5)
    assert record.states("base_quat")[0].tolist() == [np.float32(0.8), 0.0, 0.0, np.float32(0.6)]
    assert np.allclose(record.states("velocity_command")[3], [0.5, 0.0, 0.1])
    assert np.diff(record.stamps).tolist() == [20_000_000] * 29
    file = unicon_npz(
        tmp_path / "y.npz", states_quat=None, states_rpy=np.tile([0, 0, 0.5], (30, 1))
    )
    said(capsys, "import", file, tmp_path / "y.mcap", "--robot", "go2", "--rate", "500")
    quat = open_record(tmp_path / "y.mcap").states("base_quat")[7]
    assert np.allclose(quat, [np.cos(0.25), 0, 0, np.sin(0.25)])
    others = [name for name in GO2.joint_names if "FL" not in name]
    for told, more in (
        ("does not say the order of its 12 joints (DOF_NAMES); give --joints", {"DOF_NAMES": None}),
        ("has no joint 'FL_hip_joint'", {"DOF_NAMES": np.array([*others, "a", "b", "c"])}),
        ("has 12 joints, and 9 names", {"DOF_NAMES": np.array(others)}),
        ("has neither rec_dt nor ts", {"rec_dt": None}),
        ("has rec_dt nan s", {"rec_dt": np.nan}),
        ("ts that does not grow", {"rec_dt": None, "ts": np.zeros(30, np.float32)}),
        ("of one length", {"states_qd": np.zeros((7, 12))}),
        ("states_rpy has shape (30, 2)", {"states_quat": None, "states_rpy": np.zeros((30, 2))}),
        ("give numbers of shape (frames, elements)", {"states_q": np.full((30, 12), "x")}),
        ("ts that does not grow", {"rec_dt": None, "ts": np.r_[0.0:29.0, np.inf]}),
        ("rec_dt is float64 of shape (2,); give one", {"rec_dt": [0.02, 0.02]}),
        ("states_quat has shape (30, 3)", {"states_quat": np.zeros((30, 3))}),
        ("of one length", {"states_quat": None, "states_rpy": np.zeros((31, 3))}),
        ("len is nan, not the number of the last row", {"len": np.nan}),
        ("len is <U1 of shape (); give one number", {"len": "x"}),
        ("has nothing that could be imported", {"len": -5}),
        ("is not an .npz of arrays: Object", {"states_q": np.full((30, 12), None)}),
    ):
        file = unicon_npz(tmp_path / "z.npz", **more)
        assert told in refused(capsys, "import", file, tmp_path / "z.mcap", "--robot", "go2")
    np.savez(tmp_path / "z.npz", mine=np.zeros(3))
    told = refused(capsys, "import", tmp_path / "z.npz", tmp_path / "z.mcap", "--robot", "go2")
    assert "has no key of UniCon; known: states_q, " in told
    assert "exists" in refused(
        capsys, "import", tmp_path / "x.npz", tmp_path / "x.mcap", "--robot", "go2"
    )


def test_rows_that_unicon_never_wrote_are_left_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It makes its arrays for the longest run, and tells the last row that it wrote."""
    stamps = np.concatenate([5.0 + 0.02 * np.arange(20), np.zeros(10)])
    for number, (more, ticks) in enumerate(
        (
            ({"len": 19}, 20),
            ({"len": np.array([19]), "rec_dt": None, "ts": stamps}, 20),
            ({"len": 19, "states_quat": None}, 20),
            ({"len": 1000}, 30),
            ({"len": np.array([{}], object)}, 30),  # as much as if it were not there
        )
    ):
        out = tmp_path / f"{number}.mcap"
        said(capsys, "import", unicon_npz(tmp_path / "x.npz", **more), out, "--robot", "go2")
        record = open_record(out)
        assert len(record.ticks) == ticks
        assert np.diff(record.stamps).tolist() == [20_000_000] * (ticks - 1)
        assert record.states("joint_pos")[-1, 3] == np.float32(3.0 + 0.1 * (ticks - 1))


def test_an_npz_that_unpacks_to_too_much_is_not_unpacked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The bound is on what the archive says of itself, before any of it is read."""
    monkeypatch.setattr("unicon_lab.recording.imported.LARGEST", 1 << 20)
    np.savez_compressed(tmp_path / "bomb.npz", states_q=np.zeros((30, 12)), more=np.zeros(1 << 18))
    monkeypatch.setattr(np, "load", None)
    told = refused(capsys, "import", tmp_path / "bomb.npz", tmp_path / "x.mcap", "--robot", "go2")
    assert "bomb.npz unpacks to 0 GiB; at most 0 are read" in told


def test_what_is_no_npz_is_one_line_of_the_import(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    good = unicon_npz(tmp_path / "x.npz").read_bytes()
    np.save(tmp_path / "bare.npy", np.zeros(3))
    (tmp_path / "bare.npy").rename(tmp_path / "bare.npz")
    (tmp_path / "cut.npz").write_bytes(good[: len(good) // 2])
    (tmp_path / "garbage.npz").write_bytes(b"PK\x03\x04garbage")
    with zipfile.ZipFile(tmp_path / "text.npz", "w") as archive:
        archive.writestr("states_q", "text")
    (tmp_path / "folder.npz").mkdir()
    os.mkfifo(tmp_path / "pipe.npz")
    for name, told in {
        **dict.fromkeys(("bare", "cut", "garbage"), "is not an .npz of arrays: "),
        "text": "states_q is not an array",
        **dict.fromkeys(("folder", "pipe"), "is not a file; give an .npz"),
        "missing": "No such file",
    }.items():
        path, out = tmp_path / f"{name}.npz", tmp_path / "x.mcap"
        assert told in refused(capsys, "import", path, out, "--robot", "go2")


# -- readers of others -----------------------------------------------------------------------------


def test_other_readers_find_the_same_values(bag: Path) -> None:
    make_reader = pytest.importorskip("mcap.reader").make_reader
    decoder = pytest.importorskip("mcap_ros2.decoder").DecoderFactory()
    record = open_record(bag)
    same: list[Callable[[int], Any]] = []
    with AnyReader([bag]) as reader:
        connections = [c for c in reader.connections if c.topic == "/unicon/ticks"]
        found = [reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages(connections)]
        same.append(lambda row: found[row])
    with bag.open("rb") as stream:
        other = make_reader(stream, validate_crcs=True, decoder_factories=[decoder])
        decoded = [m for *_, m in other.iter_decoded_messages(topics=["/unicon/ticks"])]
        same.append(lambda row: decoded[row])
        assert {each.name for each in other.iter_attachments()} == set(record.files)
        assert {each.name for each in other.iter_metadata()} == {"unicon"}
    assert len(found) == len(decoded) == len(record.ticks)
    for moment, names in record.kept.items():
        for name in names:
            values = record.states(name, moment)
            for row in (0, 41, 99):
                for message in same:
                    there = flat(getattr(getattr(message(row), moment), name), values.dtype)
                    assert there.tobytes() == values[row].tobytes()
