"""`--collect`: what the operator keeps is a data set, whatever becomes of the run."""

from __future__ import annotations

import json
import os
import pty
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

pytest.importorskip("rosbags")
pytest.importorskip("PIL")
pytest.importorskip("av")
parquet = pytest.importorskip("pyarrow.parquet")

from test_recorded_runs import written  # noqa: E402

from unicon_base.errors import UniconError  # noqa: E402
from unicon_core.flow import Tick  # noqa: E402
from unicon_core.robots import Robot  # noqa: E402
from unicon_core.runtime import Runner, RunOptions  # noqa: E402
from unicon_core.states import StateSpec  # noqa: E402
from unicon_core.workflow import Program, load_document  # noqa: E402
from unicon_core.workflow.autowire import BuildContext  # noqa: E402
from unicon_lab.datasets.export import Wanted, export_dataset  # noqa: E402
from unicon_lab.fault_record import FaultRecord  # noqa: E402
from unicon_lab.recording import open_record  # noqa: E402
from unicon_lab.recording.collection import Collection  # noqa: E402
from unicon_ros.cli.main import main  # noqa: E402

ROOT = Path(__file__).resolve().parents[2]
PYTHON = os.environ.get("UNICON_LEROBOT", "")
STICK = ("trigger", "squeeze", "touchpad", "thumbstick")


def operator(*, context: BuildContext) -> Tick:
    """Write a hand and a target that is lost in every other second; sticks stay for the test."""
    states = context.states
    states["hand_pose"][...] = 7.0

    def tick() -> None:
        count = int(states["tick"])
        states["webxr_head"][...] = count
        states["hand_target"][...] = np.nan if count // 100 % 2 else count

    tick.writes = ("webxr_head", "hand_target", "hand_pose")  # type: ignore[attr-defined]
    tick.outside = True  # type: ignore[attr-defined]
    return tick


def _declares(robot: Robot, **_: Any) -> dict[str, StateSpec]:
    pose = StateSpec((7,), names=("x", "y", "z", "qw", "qx", "qy", "qz"), frame="local_floor")
    return {
        "webxr_head": pose,
        "webxr_valid": StateSpec((1,), "int32", names=("head",)),
        "webxr_right_buttons": StateSpec((4,), names=STICK),
        "webxr_left_buttons": StateSpec((4,), names=STICK),
        "hand_pose": StateSpec((7,)),
        "hand_target": StateSpec((7,)),
    }


operator.declares = _declares  # type: ignore[attr-defined]

CALLS = [
    {"call": {"function": "test_collect:operator"}},
    {"call": {"function": "picturing:camera", "height": 96, "width": 128}},
]
VALUES = {"rate": 100, "duration": 30.0, "flow": "hold", "start": "none", "commands": CALLS}


class Session:
    """A run in this thread whose operator is a script in another one."""

    def __init__(
        self, folder: Path, wanted: int, script: Callable[[Session], object], task: str = ""
    ) -> None:
        self.out, self.lines = folder / "demos", list[str]()
        self.collection = Collection(
            wanted, task, str(self.out), None, None, self.lines.append, False, "", "", "", [], 0
        )
        record = FaultRecord("off", self.lines.append, self.collection)
        document = load_document(written(folder, **VALUES))
        self.program = Program(document, hooks=[self.collection.hook, record.hook])
        self.runner = Runner(self.program, RunOptions(warn=self.lines.append))
        self.pressed = ""
        self.collection._pressed = self._take  # type: ignore[method-assign]
        self.collection.attach(self.runner)
        record.attach(self.runner)
        self.failed: list[BaseException] = []

        def work() -> None:
            try:
                script(self)
            except BaseException as error:
                self.failed.append(error)
            self.runner.stop()

        thread = threading.Thread(target=work)
        thread.start()
        report = self.runner.run()
        thread.join()
        self.collection.close()
        self.written = [write() for _, _, write in self.collection.files(report)]
        assert not self.failed, (self.failed, "\n".join(self.lines))
        assert not report.faults

    def _take(self) -> str:
        taken, self.pressed = self.pressed, ""
        return taken

    def tick(self) -> int:
        return int(self.program.states["tick"])

    def go(self, key: str, said: str, ticks: int = 40) -> str:
        """Press a key, wait until a line says something, and then for some ticks; return it."""
        begin, before = time.monotonic(), len(self.lines)
        self.pressed = key
        while not any(said in line for line in self.lines[before:]) or self.collection._busy:
            assert time.monotonic() - begin < 20.0, self.lines
            time.sleep(0.005)
        self.wait(ticks)
        return next(line for line in self.lines[before:] if said in line)

    def wait(self, ticks: int) -> None:
        until = self.tick() + ticks
        while self.tick() < until and self.runner.phase.value == "run":
            time.sleep(0.005)


def marks(folder: Path) -> list[Any]:
    found: list[Any] = json.loads((folder / "demos.recordings" / "episodes.json").read_bytes())
    return found


def table(folder: Path, name: str = "demos") -> Any:
    return parquet.read_table(folder / name / "data/chunk-000/file-000.parquet")


def keep_two(session: Session) -> None:
    session.go("s", "started")
    session.go("k", "kept, 0.")
    session.go("s", "started")
    session.go("d", "discarded")
    session.go("s", "started")
    session.go("k", "2 of 2 episodes are kept")


def test_kept_episodes_are_a_data_set_of_hands_targets_and_pictures(tmp_path: Path) -> None:
    session = Session(tmp_path, 2, keep_two, "stack")
    first, second = marks(tmp_path)
    assert first[0] == "session-001.mcap"
    assert first[3] == "stack"
    assert first[2] < second[1]
    record = open_record(tmp_path / "demos.recordings" / "session-001.mcap")
    rows = table(tmp_path).to_pydict()
    assert set(rows["episode_index"]) == {0, 1}
    ticks = np.array(rows["unicon.tick"])
    for number, (_, begin, end, _) in enumerate((first, second)):
        there = ticks[np.array(rows["episode_index"]) == number]
        assert begin <= there[0] <= begin + 4
        assert end - 4 <= there[-1] <= end
    # The operator's head as it was, and no policy takes it for an observation.
    np.testing.assert_array_equal(np.array(rows["operator.webxr_head"])[:, 0], ticks)
    assert "observation.webxr_head" not in rows
    assert "operator.webxr_valid" in rows
    # The action ends with the target, and with the hand's pose where there is none.
    targets = np.array(rows["action"])[:, -7]
    expected = np.where(ticks // 100 % 2, 7.0, ticks)
    np.testing.assert_array_equal(targets, expected.astype(np.float32))
    info = json.loads((session.out / "meta/info.json").read_text())
    assert info["total_episodes"] == 2
    assert "observation.images.front" in info["features"]
    tasks = parquet.read_table(session.out / "meta/tasks.parquet").to_pydict()
    assert tasks["__index_level_0__"] == ["stack"]
    # The simulator began anew behind each: the record says where.
    again = [int(record.ticks[each["before"]]) for each in record.memories if each["anew"]]
    assert any(first[2] < tick <= second[1] for tick in again)


def test_a_second_session_adds_to_the_set_and_says_when_it_has_enough(tmp_path: Path) -> None:
    def keep_one(session: Session) -> None:
        session.go("s", "started")
        session.go("k", "kept, 0.")

    Session(tmp_path, 3, keep_one, "left")
    before = marks(tmp_path)
    own = [tmp_path / f"demos.{end}" for end in ("old", "new")]  # of the user
    for folder in own:
        folder.mkdir()
    Session(tmp_path, 2, keep_one, "right")
    for folder in own:
        folder.rmdir()
    assert marks(tmp_path)[0] == before[0]
    assert [each[0] for each in marks(tmp_path)] == ["session-001.mcap", "session-002.mcap"]
    tasks = parquet.read_table(tmp_path / "demos/meta/tasks.parquet").to_pydict()
    assert tasks["__index_level_0__"] == ["left", "right"]
    assert set(table(tmp_path).to_pydict()["episode_index"]) == {0, 1}
    assert sorted(path.name for path in tmp_path.glob("demos*")) == ["demos", "demos.recordings"]
    with pytest.raises(UniconError, match="has 2 episodes; give more --episodes, or write them"):
        Collection(2, "", str(tmp_path / "demos"))
    lines = export_dataset([tmp_path / "demos.recordings"], tmp_path / "own", Wanted(fps=10))
    assert "2 episodes" in lines[0]


def test_sticks_of_a_headset_start_keep_and_discard(tmp_path: Path) -> None:
    def script(session: Session) -> None:
        take = type(session.collection)._pressed.__get__(session.collection)
        session.collection._keys = False  # no terminal
        session.collection._pressed = take  # type: ignore[method-assign]

        def push(side: str, said: str) -> None:
            stick = session.program.states[f"webxr_{side}_buttons"]
            stick[3] = 0.9
            session.go("", said)
            stick[3] = 0.0
            session.wait(10)

        push("right", "started")  # and is held meanwhile: it counts once
        push("left", "discarded")
        push("right", "started")
        push("right", "1 of 1 episodes are kept")

    Session(tmp_path, 1, script)
    assert len(marks(tmp_path)) == 1


def test_what_the_medium_has_not_is_not_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def script(session: Session) -> None:
        session.go("s", "started")
        session.go("k", "kept, 0.")
        recorder = session.collection._recorder
        session.go("s", "started")
        recorder._overflow += 1
        session.go("k", "NOT kept: 1 of its messages were lost")
        session.go("s", "started")
        with monkeypatch.context() as patch:
            patch.setattr("unicon_lab.recording.collection.write_json", no_room)
            session.go("k", "NOT kept: cannot write episodes.json: No space left")
        session.go("s", "started")
        recorder._stop(OSError(28, "No space left on device"), 0)  # as a full disk does
        session.go("k", "NOT kept: No space left on device")

    def no_room(*_: Any) -> None:
        raise UniconError("cannot write episodes.json: No space left on device; make room")

    Session(tmp_path, 9, script)
    assert len(marks(tmp_path)) == 1
    assert len(set(table(tmp_path).to_pydict()["episode_index"])) == 1


def test_an_episode_with_a_silent_camera_or_a_reset_is_not_kept(tmp_path: Path) -> None:
    """The data set would have pictures of another time, or a leap; without any there is none."""

    def script(session: Session) -> None:
        (camera,) = (b.tick for b in session.program.blocks if getattr(b.tick, "sources", ()))
        session.go("s", "started")
        camera._first = 1 << 60  # as one whose process is killed, or stopped
        session.go("", "discard it: front gives no picture; 0 of 2")
        camera._first = 0  # it comes back
        session.go("k", "NOT kept: front gives no picture; 0 of 2")
        session.go("s", "started")
        session.go("k", "kept, ")
        session.go("s", "started")
        session.runner.call_soon(session.runner.reset)
        session.go("", "discard it: the run was reset")
        session.go("k", "NOT kept: the run was reset; 1 of 2")
        session.go("s", "started")
        session.go("k", "2 of 2 episodes are kept")

    Session(tmp_path, 2, script)
    assert set(table(tmp_path).to_pydict()["episode_index"]) == {0, 1}


def test_what_is_collected_does_not_go_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    given: dict[str, Any] = {}

    def options(**values: Any) -> RunOptions:
        given.update(values)
        raise UniconError("that is all")

    monkeypatch.setattr("unicon_core.runtime.RunOptions", options)
    workflow = str(written(tmp_path, flow="hold"))
    for more, returns in (["--collect", str(tmp_path / "demos")], False), ([], True):
        assert main(["run", workflow, "--no-ros", *more]) == 1
        assert "that is all" in capsys.readouterr().err
        assert given["returns"] is returns


def test_folders_that_are_no_collection_are_left_alone(tmp_path: Path) -> None:
    (tmp_path / "demos").mkdir()
    with pytest.raises(UniconError, match=r"demos exists, and .*recordings does not"):
        Collection(2, "", str(tmp_path / "demos"))
    folder = tmp_path / "more.recordings"
    folder.mkdir()
    for garbage in ('[["a.mcap", 1]]', "nan", '{"a": 1}', "[1]", '[["a.mcap", 1, 2, "t", 5]]'):
        (folder / "episodes.json").write_text(garbage)
        with pytest.raises(UniconError, match=r"episodes.json cannot be read.*mend it"):
            Collection(2, "", str(tmp_path / "more"))
    (folder / "episodes.json").write_text("[]")
    with pytest.raises(UniconError, match="no episode was kept"):
        export_dataset([folder], tmp_path / "out", Wanted())


WORKFLOW = {
    "schema": "unicon.workflow/1",
    "robot": "arx_x5",
    "platform": "fake",
    "rate": 100,
    "flow": "hold",
    "start": "none",
    "commands": CALLS,
}


class Terminal:
    """`unicon run --collect` in a terminal of its own."""

    def __init__(self, folder: Path, *options: str, workflow: str = "") -> None:
        path = folder / "workflow.yaml"
        path.write_text(yaml.safe_dump(WORKFLOW), "utf-8")
        theirs, self.ours = pty.openpty()[::-1]
        here = [str(ROOT), str(Path(__file__).parent), str(ROOT / "test" / "record")]
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(here), "TERM": "xterm"}
        command = [sys.executable, "-m", "unicon_ros", "run", workflow or str(path), "--no-ros"]
        command += ["--collect", str(folder / "demos"), *options]
        self.run = subprocess.Popen(
            command, stdin=theirs, stdout=theirs, stderr=theirs, env=environment, cwd=folder
        )
        os.close(theirs)
        self.text = ""

    def until(self, said: str, patience: float = 60.0) -> None:
        """Read until something is said; forget what was said before."""
        begin = time.monotonic()
        while said not in self.text:
            assert time.monotonic() - begin < patience, self.text
            if select.select([self.ours], [], [], 0.1)[0]:
                try:
                    self.text += os.read(self.ours, 4096).decode("utf-8", "replace")
                except OSError:  # it has ended
                    assert said in self.text, self.text
        self.text = self.text.partition(said)[2]

    def press(self, key: str, said: str) -> None:
        """Press a key and wait for what it does."""
        os.write(self.ours, key.encode())
        self.until(said)
        time.sleep(0.5)


@pytest.mark.slow
@pytest.mark.parametrize("end", [signal.SIGKILL, signal.SIGINT])
def test_what_was_kept_outlives_a_kill_and_ctrl_c(tmp_path: Path, end: signal.Signals) -> None:
    terminal = Terminal(tmp_path, "--episodes", "2", "--task", "wave")
    terminal.until("s start, k keep")
    terminal.until("episode 1/2 idle")  # the status line
    terminal.press("s", "episode 1/2 RECORDING")
    terminal.press("k", "1 of 2 episodes are kept")
    terminal.press("s", "episode 2/2 RECORDING")  # is not kept
    terminal.run.send_signal(end)
    assert terminal.run.wait(60.0) == (-9 if end == signal.SIGKILL else 0)
    assert len(marks(tmp_path)) == 1
    assert (tmp_path / "demos").exists() == (end == signal.SIGINT)
    again = Terminal(tmp_path, "--episodes", "2", "--task", "wave")
    again.until("s start, k keep")
    again.press("s", "started")
    os.write(again.ours, b"k")
    again.until("2 of 2 episodes are kept")
    again.until("action: ", 120.0)
    assert again.run.wait(60.0) == 0
    rows = table(tmp_path).to_pydict()
    assert set(rows["episode_index"]) == {0, 1}
    if PYTHON:
        reader, out = Path(__file__).with_name("lerobot_reader.py"), tmp_path / "read.npz"
        environment = {**os.environ, "PYTHONPATH": str(ROOT), "HF_HUB_OFFLINE": "1"}
        command = [PYTHON, str(reader), str(tmp_path / "demos"), str(out)]
        subprocess.run(command, check=True, env=environment)
        with np.load(out) as read:
            assert set(read["task"]) == {"wave"}
            np.testing.assert_allclose(read["action"], rows["action"], rtol=1e-6)
            assert read["observation.images.front"].shape[1:] == (3, 96, 128)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--episodes", "5"], "--episodes and --task go with --collect DIR; add it"),
        (["--collect", "DIR", "--record", "a.mcap"], "leave --record and --speed"),
        (["--collect", "DIR", "--speed", "max"], "leave --record and --speed"),
        (
            ["--collect", "DIR", "--episodes", "0"],
            "0 is not a number of episodes; give 1 to 100000",
        ),
        (["--collect", "DIR", "--set", "commands.0=keyboard"], "keyboard reads: leave one out"),
    ],
)
def test_options_that_contradict_are_one_line(
    options: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    workflow = str(written(tmp_path, commands=["velocity_command"], flow="hold"))
    options = [option.replace("DIR", str(tmp_path / "demos")) for option in options]
    try:
        status = main(["run", workflow, "--no-ros", *options])
    except SystemExit as refused:
        status = int(str(refused.code))
    assert status in (1, 2)
    assert said in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "demos").exists()
