"""Recordings as LeRobot data sets: layout and numbers against the recordings' own ticks."""

from __future__ import annotations

import ctypes
import io
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("pyarrow")
pytest.importorskip("PIL")
pytest.importorskip("rosbags")

from picturing import picture, run
from PIL import Image
from pyarrow import parquet

from unicon_base.errors import StateError, UniconError
from unicon_core.flow import Block, Stage
from unicon_core.robots import load_robot
from unicon_core.workflow import HookBlocks, Program
from unicon_lab.datasets.export import Wanted, export_dataset
from unicon_lab.recording import open_record
from unicon_ros.cli.main import main

OWN = Wanted(writer="own", video=False)
GO2 = load_robot("go2")


def made(bags: list[Path], out: Path, **wanted: Any) -> tuple[dict[str, Any], Any, list[str]]:
    """Export; return what info.json says, the table of all frames, and what is told."""
    told = export_dataset(bags, out, Wanted(**{"writer": "own", "video": False} | wanted))
    info = json.loads((out / "meta/info.json").read_text("utf-8"))
    return info, parquet.read_table(out / "data/chunk-000/file-000.parquet"), told


def array(table: Any, key: str) -> Any:
    return np.array(table[key].to_pylist())


def test_every_number_is_the_recordings_own(bags: list[Path], tmp_path: Path) -> None:
    info, table, told = made(bags, tmp_path / "set", task="stand still", fps=100)
    assert (info["codebase_version"], info["fps"], info["robot_type"]) == ("v3.0", 100, "go2")
    assert info["total_episodes"] == 3
    assert info["total_frames"] == len(table) == 135
    assert info["splits"] == {"train": "0:3"}
    assert told[:2] == [
        f"{tmp_path / 'set'}: 3 episodes, 135 frames at 100 fps, written by pyarrow",
        "action: joint_pos_target (12), velocity_command (3)",
    ]
    rows = table["episode_index"].to_pylist()
    assert rows == [0] * 45 + [1] * 45 + [2] * 45
    assert table["index"].to_pylist() == list(range(135))
    assert table["frame_index"].to_pylist() == 3 * list(range(45))
    times = array(table, "timestamp").astype(np.float32)
    assert np.array_equal(times, np.tile(np.arange(45) / 100, 3).astype(np.float32))
    for number, bag in enumerate(bags):
        record = open_record(bag)
        part = table.slice(45 * number, 45)
        ticks = array(part, "unicon.tick")
        assert ticks.tolist() == list(range(5, 50))  # from the first picture of both cameras on
        for state, key in (
            ("joint_pos", "observation.state"),
            ("joint_vel", "observation.velocity"),
            ("joint_effort", "observation.effort"),
            ("base_quat", "observation.base_quat"),
        ):
            seen = array(part, key).astype(np.float32)
            assert seen.tobytes() == record.states(state)[5:].tobytes()
        action = array(part, "action").astype(np.float32)
        assert action[:, :12].tobytes() == record.states("joint_pos_target")[5:].tobytes()
        assert action[:, 12:].tobytes() == record.states("velocity_command")[5:].tobytes()
    assert info["features"]["observation.state"]["names"] == list(GO2.joint_names)
    names = info["features"]["action"]["names"]
    assert names == [*GO2.joint_names, *(f"velocity_command.{axis}" for axis in ("vx", "vy", "wz"))]
    sources = json.loads((tmp_path / "set/meta/unicon.json").read_text("utf-8"))["episodes"]
    assert [each["run"] for each in sources] == [open_record(bag).facts["run"] for bag in bags]


def test_a_frame_shows_the_picture_whose_handle_its_tick_held(
    bags: list[Path], tmp_path: Path
) -> None:
    info, table, _ = made(bags, tmp_path / "set", fps=50)
    assert info["features"]["observation.images.front"] == {
        "dtype": "image",
        "shape": [96, 128, 3],
        "names": ["height", "width", "channels"],
    }
    for number, bag in enumerate(bags):
        handles = open_record(bag).states("front_handle")
        length = info["total_frames"] // 3
        part = table.slice(length * number, length)
        shown = part["observation.images.front"].to_pylist()
        for tick, each in zip(part["unicon.tick"].to_pylist(), shown):
            file = Image.open(io.BytesIO(each["bytes"]))
            seen = np.asarray(file).astype(int)
            error = np.abs(seen - picture(int(handles[tick]), 96, 128)).mean()
            assert file.format == ("PNG" if number else "JPEG")
            assert error == 0.0 if number else error < 8.0


def test_files_tell_where_each_episode_stands(bags: list[Path], tmp_path: Path) -> None:
    info, table, _ = made(bags, tmp_path / "set", task="wave: ὑγίεια")
    folder = tmp_path / "set"
    episodes = parquet.read_table(folder / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    for number, each in enumerate(episodes):
        assert each["episode_index"] == number
        assert each["tasks"] == ["wave: ὑγίεια"]
        begin, end = each["dataset_from_index"], each["dataset_to_index"]
        assert end - begin == each["length"]
        assert set(table.slice(begin, end - begin)["episode_index"].to_pylist()) == {number}
        for key in ("data/chunk_index", "data/file_index", "meta/episodes/file_index"):
            assert each[key] == 0
        assert each["stats/action/count"] == [each["length"]]
        assert np.shape(each["stats/observation.images.rear/mean"]) == (3, 1, 1)
    tasks = parquet.read_table(folder / "meta/tasks.parquet")
    assert tasks.to_pydict() == {"task_index": [0], "__index_level_0__": ["wave: ὑγίεια"]}
    assert json.loads(tasks.schema.metadata[b"pandas"])["index_columns"] == ["__index_level_0__"]
    stats = json.loads((folder / "meta/stats.json").read_text("utf-8"))
    assert stats.keys() == info["features"].keys()
    state = array(table, "observation.state")
    for name, value in (("min", state.min(0)), ("mean", state.mean(0)), ("std", state.std(0))):
        assert np.allclose(stats["observation.state"][name], value, atol=1e-6)
    metadata = parquet.read_schema(folder / "data/chunk-000/file-000.parquet").metadata
    described = json.loads(metadata[b"huggingface"])["info"]["features"]
    assert described["observation.images.rear"] == {"_type": "Image"}


@pytest.mark.skipif(not hasattr(os, "SCHED_BATCH"), reason="Linux alone has these policies")
def test_an_encoder_takes_no_priority_over_a_tick(bags: list[Path], tmp_path: Path) -> None:
    """SVT-AV1 gives itself, and its caller, real-time priority where it runs as root."""
    pytest.importorskip("av")
    before = os.sched_getscheduler(0)
    made(bags, tmp_path / "set", video=True, fps=25)
    policies = {os.sched_getscheduler(int(name)) for name in os.listdir("/proc/self/task")}
    assert policies.isdisjoint({os.SCHED_FIFO, os.SCHED_RR})
    assert os.sched_getscheduler(0) == before
    # What libpthread remembers, and Fast DDS hands on to its threads, is no longer SVT-AV1's.
    told, param = ctypes.c_int(-1), ctypes.create_string_buffer(64)
    pthread = ctypes.c_ulong(threading.get_ident())
    assert not ctypes.CDLL(None).pthread_getschedparam(pthread, ctypes.byref(told), param)
    assert told.value == before


def test_a_video_has_a_frame_for_each_row(bags: list[Path], tmp_path: Path) -> None:
    av = pytest.importorskip("av")
    info, table, _ = made(bags, tmp_path / "set", video=True, fps=25)
    front, rear = (info["features"][f"observation.images.{name}"] for name in ("front", "rear"))
    assert (front["dtype"], front["info"]["video.codec"]) == ("video", "av1")
    assert rear["dtype"] == "image"  # too small for the encoder
    assert "observation.images.front" not in table.column_names
    key = "observation.images.front"
    path = tmp_path / "set" / info["video_path"].format(video_key=key, chunk_index=0, file_index=0)
    episodes = parquet.read_table(tmp_path / "set/meta/episodes/chunk-000/file-000.parquet")
    begins = episodes[f"videos/{key}/from_timestamp"].to_pylist()
    ends = episodes[f"videos/{key}/to_timestamp"].to_pylist()
    with av.open(str(path)) as container:
        frames = list(container.decode(video=0))
        pixels = [frame.to_ndarray(format="rgb24") for frame in frames]
        times = [float(frame.pts * frame.time_base) for frame in frames]
    assert len(frames) == len(table) == round(25 * ends[-1])
    assert np.allclose(times, np.arange(len(frames)) / 25, atol=1e-6)
    assert begins == [0.0, *ends[:-1]]
    handles = open_record(bags[2]).states("front_handle")
    for row in range(round(25 * begins[2]), len(table)):
        wanted = picture(int(handles[table["unicon.tick"][row].as_py()]), 96, 128)
        assert np.abs(pixels[row].astype(int) - wanted).mean() < 20.0


# -- what was commanded, and what is not a number --------------------------------------------------


def commands(program: Program) -> HookBlocks:
    """Command three joints from tick 20 to 39, and forget an effort in tick 7."""
    command, effort = program.states["joint_pos_command"], program.states["joint_effort"]
    tick = program.states["tick"]

    def command_some() -> None:
        command[...] = np.nan
        if 20 <= tick < 40:
            command[3:6] = 0.1

    def forget() -> None:
        effort[4] = np.nan if tick == 7 else 1.0

    return {
        Stage.INPUT: [Block("some", command_some, amends=("joint_pos_command",), endless=True)],
        Stage.RECV: [Block("forget", forget, amends=("joint_effort",), endless=True)],
    }


@pytest.fixture(scope="module")
def commanded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("commanded")
    workflow = {
        "states": {"unknown": {"shape": [2], "initial": float("nan")}},
        "flow": {"forward_command": {"max_rate": 2.0}},
    }
    run(folder, hooks=(commands,), workflow=workflow)
    return folder / "run.mcap"


def test_the_action_is_what_was_commanded_and_else_what_was_sent(
    commanded: Path, tmp_path: Path
) -> None:
    info, table, told = made([commanded], tmp_path / "set")
    assert "action: joint_pos_command (3), velocity_command (3)" in told
    assert "joint_pos_command.FR_hip_joint and 8 more: never a number, left out" in told
    assert info["features"]["action"]["names"][:3] == list(GO2.joint_names[3:6])
    record, action = open_record(commanded), array(table, "action").astype(np.float32)
    sent = record.states("joint_pos_target")[:, 3:6]
    assert np.array_equal(action[20:40, :3], np.full((20, 3), np.float32(0.1)))
    assert np.array_equal(action[:20, :3], sent[:20])
    assert np.array_equal(action[40:, :3], sent[40:])


def test_what_is_no_number_stays_and_is_told(commanded: Path, tmp_path: Path) -> None:
    info, table, told = made([commanded], tmp_path / "set", states=["joint_effort", "unknown"])
    assert "observation.effort: 1 numbers are NaN, as recorded; first FL_thigh_joint" in told
    assert "unknown.0 and 1 more: never a number, left out" in told
    assert "observation.unknown" not in info["features"]
    effort = array(table, "observation.effort").astype(np.float32)
    assert effort.tobytes() == open_record(commanded).states("joint_effort").tobytes()
    stats = json.loads((tmp_path / "set/meta/stats.json").read_text("utf-8"))
    assert np.isfinite([stats["observation.effort"][name] for name in ("min", "mean")]).all()
    with pytest.raises(UniconError, match="--writer lerobot: it takes no NaN, and there are some"):
        made([commanded], tmp_path / "other", writer="lerobot")


# -- what is refused -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("wanted", "told"),
    [
        ({"states": ["joint_po"]}, "has no state 'joint_po' at 'sent'; did you mean 'joint_pos'"),
        ({"actions": ["wave"]}, "has no state 'wave' at 'sent'; known: "),
        ({"cameras": ["back"]}, "camera 'back' was not recorded; known: front, rear"),
        ({"phases": ["walk"]}, "--phases: no phase 'walk'; known: approach, damp"),
        ({"phases": ["soft"]}, "has no whole tick of phase soft; it has run: give --phases"),
        ({"fps": 101}, "--fps 101: .*run.mcap has 100 ticks a second; give at most that"),
        ({"writer": "lerobot"}, "--writer lerobot needs lerobot: pip install lerobot"),
    ],
)
def test_wishes_that_are_refused(
    wanted: dict[str, Any],
    told: str,
    bags: list[Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "lerobot", None)
    with pytest.raises(UniconError, match=told):
        made(bags, tmp_path / "set", **wanted)
    assert list(tmp_path.iterdir()) == []


def test_recordings_that_do_not_fit_are_refused(bags: list[Path], tmp_path: Path) -> None:
    for name, workflow, cameras, told in (
        ("slow", {"rate": 50}, [{"every": 4, "height": 96, "width": 128}], "50 ticks a second, "),
        ("other", {"robot": "go1"}, [], "is of robot go1, .* of go2; make a data set for each"),
        ("blind", {}, [], "has cameras none, .* front .128 x 96., rear .64 x 48."),
        ("small", {}, [{}, {"prefix": "rear"}], "has cameras front .64 x 48., rear .64 x 48., "),
    ):
        (tmp_path / name).mkdir()
        run(
            tmp_path / name,
            *cameras,
            workflow={"duration": 0.1, **workflow},
            frames=["all"][: len(cameras)],
        )
        with pytest.raises(UniconError, match=told):
            export_dataset([bags[0], tmp_path / name / "run.mcap"], tmp_path / "set", OWN)
    assert not (tmp_path / "set").exists()
    # With --fps the rates may differ, and without pictures those of the cameras.
    both = [bags[1], tmp_path / "slow" / "run.mcap"]
    info, table, _ = made(both, tmp_path / "set", fps=25, cameras=[])
    assert info["total_episodes"] == 2
    assert np.diff(array(table, "unicon.tick"))[:5].tolist() == [4] * 5
    assert np.diff(array(table, "unicon.tick"))[-1] == 2


def test_a_batch_is_refused(tmp_path: Path) -> None:
    run(tmp_path, workflow={"num_robots": 2, "duration": 0.1})
    with pytest.raises(UniconError, match="is of 2 robots; a data set is of one: record without"):
        made([tmp_path / "run.mcap"], tmp_path / "set")


def test_a_camera_without_a_picture_is_refused(tmp_path: Path) -> None:
    run(tmp_path, {"first": 45}, workflow={"duration": 0.5}, frames=["all"])
    record = open_record(tmp_path / "run.mcap")
    assert len(record.frames("front").handles) == 3
    _info, table, _ = made([tmp_path / "run.mcap"], tmp_path / "set", fps=100)
    assert len(table) == 5  # from the first picture on
    (tmp_path / "never").mkdir()
    run(tmp_path / "never", {"first": 3, "every": 100}, frames=["all"])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("unicon_lab.recording.read.Record.states", _without_handles)
        with pytest.raises(
            UniconError, match="no picture of 'front' in ticks 0 to 49 of run; leave"
        ):
            made([tmp_path / "never/run.mcap"], tmp_path / "other")


def _without_handles(self: Any, name: str, *_: Any) -> Any:
    return np.zeros(len(self.ticks), np.int64)


def test_depths_are_left_out_and_told(tmp_path: Path) -> None:
    run(tmp_path, {"kind": "depth"}, frames=["all"])
    info, _, told = made([tmp_path / "run.mcap"], tmp_path / "set")
    assert "front: 32FC1, left out: a picture is rgb8 or JPEG" in told
    assert not [key for key in info["features"] if "images" in key]
    with pytest.raises(UniconError, match="camera 'front' is 32FC1, and a picture is rgb8 or JPEG"):
        made([tmp_path / "run.mcap"], tmp_path / "other", cameras=["front"])


def test_a_picture_that_is_garbage_is_one_line(tmp_path: Path) -> None:
    run(tmp_path, {"kind": "jpeg"}, frames=["all"])
    with pytest.raises(
        UniconError, match="a picture is not a JPEG that can be read; leave that camera out"
    ):
        made([tmp_path / "run.mcap"], tmp_path / "set")
    info, _, _ = made([tmp_path / "run.mcap"], tmp_path / "set", cameras=[])
    assert info["total_frames"] == 50


def test_nothing_is_written_over_and_nothing_is_left(
    bags: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "a set: ü"
    made(bags[:1], out)
    before = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    with pytest.raises(UniconError, match="exists; move it away or give another name"):
        made(bags[:1], out)
    # Another export of that name, which comes to its end earlier.
    monkeypatch.setattr(os.path, "lexists", lambda _: False)
    with pytest.raises(
        UniconError, match=r"cannot write .*/a set: ü: .*; make room or give another path"
    ):
        made(bags[:1], out)
    monkeypatch.undo()
    assert {path: path.read_bytes() for path in out.rglob("*") if path.is_file()} == before
    assert list(tmp_path.iterdir()) == [out]


def test_a_full_disk_is_one_line_and_leaves_nothing(bags: list[Path], tmp_path: Path) -> None:
    def bounded() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))

    done = subprocess.run(
        [
            *(sys.executable, "-m", "unicon_ros", "bag", "export", "--lerobot", *map(str, bags)),
            *("--out", str(tmp_path / "set"), "--writer", "own"),
        ],
        capture_output=True,
        text=True,
        preexec_fn=bounded,
        check=False,
    )
    assert done.returncode == 1
    assert done.stderr.count("\n") == 1, done.stderr
    assert f"cannot write {tmp_path / 'set'}: " in done.stderr
    assert "; make room or give another path" in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_a_run_that_was_killed_is_exported_before_and_after_recovery(
    bags: list[Path], tmp_path: Path
) -> None:
    torn = tmp_path / "run.mcap.partial"
    places = open_record(bags[1])._scans[0].frames["/unicon/frames/front"]
    torn.write_bytes(bags[1].read_bytes()[: int(places[-3])])
    _, table, told = made([torn], tmp_path / "torn", fps=100)
    assert any("frames show the picture before theirs" in line for line in told)
    assert main(["bag", "recover", str(torn)]) == 0
    _, again, _ = made([tmp_path / "run.recovered-1.mcap"], tmp_path / "mended", fps=100)
    assert again.equals(table)


def test_the_command_says_what_it_made(
    bags: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = str(tmp_path / "set")
    arguments = ["bag", "export", "--lerobot", *map(str, bags), "--no-video", "--writer", "own"]
    assert main([*arguments, "--out", out, "--fps", "50"]) == 0
    assert capsys.readouterr().out.startswith(f"{out}: 3 episodes, 69 frames at 50 fps")
    shutil.rmtree(out)
    for more, told in (
        ([], "--lerobot: give the folder of the data set: --out DIR"),
        (["--out", out, "--moment", "received"], "--moment goes without --lerobot"),
        (["--out", out, "--fps", "-1"], "--fps -1: give 1 or more frames a second"),
    ):
        assert main([*arguments, *more]) == 1
        assert told in capsys.readouterr().err
    for arguments, told in (
        (["bag", "export", str(bags[0])], "1 names; give BAG and OUT, or any number of recordings"),
        (["bag", "export", str(bags[0]), "x.csv", "--out", out], "--out goes with --lerobot"),
    ):
        assert main(arguments) == 1
        assert told in capsys.readouterr().err


def test_what_is_missing_is_named(
    bags: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(UniconError, match="a LeRobot data set needs pyarrow: pip install"):
        export_dataset(bags, tmp_path / "set", OWN)
    monkeypatch.undo()
    monkeypatch.setitem(sys.modules, "PIL", None)
    with pytest.raises(UniconError, match="a data set of pictures needs pillow: pip install"):
        export_dataset(bags, tmp_path / "set", OWN)


@pytest.mark.parametrize(
    ("code", "told"),
    [
        ("CODEBASE_VERSION = 'v2.1'", "the installed lerobot writes v2.1, not v3.0: pip install"),
        ("import not_there", "lerobot lacks not_there: pip install not_there, or --writer own"),
        ("1 / 0", "lerobot cannot be imported: division by zero; mend it, or give --writer own"),
        (
            "CODEBASE_VERSION = 'v3.0'\nclass LeRobotDataset:\n"
            "    def create(*_, **__):\n        raise KeyError('x')",
            "lerobot cannot write .*: 'x'; give --writer own",
        ),
    ],
)
def test_a_package_that_cannot_write_is_told_and_done_without(
    code: str, told: str, bags: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, text in (
        ("lerobot/__init__.py", ""),
        ("lerobot/datasets/__init__.py", ""),
        ("lerobot/datasets/lerobot_dataset.py", code),
        ("datasets.py", "def disable_progress_bars(): pass"),
    ):
        path = tmp_path / "site" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, "utf-8")
    monkeypatch.syspath_prepend(tmp_path / "site")
    out = tmp_path / "set"
    try:
        with pytest.raises(UniconError, match=told):
            made(bags, out, writer="lerobot")
        assert not out.exists()
        if "cannot write" not in told:
            _, _, lines = made(bags, out, writer="auto")
            assert "written by pyarrow" in lines[0]
            assert lines[-1].startswith("not written by lerobot: ")
    finally:
        for name in [n for n in sys.modules if n.partition(".")[0] in ("lerobot", "datasets")]:
            del sys.modules[name]


def test_a_state_of_other_numbers_is_refused(bags: list[Path], tmp_path: Path) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("unicon_lab.datasets.columns._TYPES", ("int8",))
        with pytest.raises(StateError, match="state 'joint_pos' is float32, which a data set does"):
            made(bags, tmp_path / "set", states=["joint_pos"])


def test_commands_that_never_came_are_what_was_sent(tmp_path: Path) -> None:
    run(tmp_path, workflow={"flow": {"forward_command": {"max_rate": 2.0}}})
    assert "joint_pos_command" in open_record(tmp_path / "run.mcap").kept["sent"]
    _, _, told = made([tmp_path / "run.mcap"], tmp_path / "set")
    assert told[1:] == ["action: joint_pos_target (12), velocity_command (3)"]
