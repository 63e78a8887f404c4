"""Recordings survive SIGKILL, a full disk and a file that vanishes, and never stall the ticks."""

from __future__ import annotations

import json
import os
import random
import resource
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rosbags")
pytest.importorskip("mcap_ros2", reason="another reader: pip install mcap-ros2-support")

from recordings import KIND, message, read_by_both, small

from unicon_base.errors import UniconError
from unicon_lab.recording import McapFile, open_record, recover
from unicon_lab.recording.recorder import Recorder
from unicon_ros.cli.main import main

RUN = ["run", "go2_stand", "--no-ros", "--set", "platform=fake", "--quiet"]
HOLD = "schema: unicon.workflow/1\nrobot: go2\nplatform: fake\nrate: 50\nflow: {hold: {}}\n"


def unicon(*arguments: str, **options: Any) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "unicon_ros", *RUN, *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        **options,
    )


def grown(file: Path, least: int, patience: float = 60.0) -> int:
    """Wait until a file is that large; return its size."""
    end = time.monotonic() + patience
    while time.monotonic() < end:
        if file.exists() and file.stat().st_size >= least:
            return file.stat().st_size
        time.sleep(0.02)
    raise AssertionError(f"{file.name} has not grown to {least} bytes")


def flushed(recorder: Recorder) -> int:
    """Let what was given to a recorder come into its file at once; return the file's size."""
    partial = recorder.path.with_name(f"{recorder.path.name}.partial")
    before = partial.stat().st_size
    recorder._wake.set()  # within 0.7 s it wakes by itself
    return grown(partial, before + 1)


def paths(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@pytest.fixture(scope="module")
def killed(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """What a run leaves in run.mcap.partial that is killed while it records."""
    folder = tmp_path_factory.mktemp("killed")
    partial = folder / "run.mcap.partial"
    # Two minutes of ticks: the recording shall be there long before they end.
    run = unicon("--record", str(folder / "run.mcap"), "--duration", "120")
    try:
        size = grown(partial, 20_000)
        grown(partial, size + 1)  # the next chunk, well within a minute
    finally:
        run.send_signal(signal.SIGKILL)
        run.wait(10)
    assert paths(folder) == ["run.mcap.partial"]
    return partial.read_bytes()


def test_a_run_that_is_killed_leaves_all_but_the_last_second(killed: bytes, tmp_path: Path) -> None:
    partial = tmp_path / "run.mcap.partial"
    partial.write_bytes(killed)
    recovered = recover(partial)
    assert recovered is not None
    assert paths(tmp_path) == ["run.recovered-1.mcap"]
    stamps = read_by_both(recovered[0])["/joint_states"]
    assert len(stamps) > 1
    assert stamps == sorted(stamps)


def test_what_was_written_a_second_ago_is_in_the_file(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "run.mcap")
    write = recorder.channel("/topic", KIND)
    recorder.start()
    partial = tmp_path / "run.mcap.partial"
    before = partial.stat().st_size
    write(1, message(1))
    began = time.monotonic()
    grown(partial, before + 1)
    assert time.monotonic() - began < 10.0  # it was about 11 s, for 1 MB
    recorder.close()


def test_the_next_run_of_that_name_recovers_what_a_killed_one_left(
    killed: bytes, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    file, partial = tmp_path / "run.mcap", tmp_path / "run.mcap.partial"
    for number in (1, 2):
        partial.write_bytes(killed)
        assert main([*RUN, "--speed", "max", "--duration", "0.5", "--record", str(file)]) == 0
        told = capfd.readouterr().err
        assert "an earlier run was cut off while it recorded to" in told
        assert f"run.recovered-{number}.mcap" in told
        assert read_by_both(file)["/joint_states"]
        assert read_by_both(tmp_path / f"run.recovered-{number}.mcap")["/joint_states"]
        file.unlink()


@pytest.mark.parametrize("count", [0, 1, 40])
def test_wherever_a_kill_cuts_the_file_its_whole_chunks_are_read(
    count: int, tmp_path: Path
) -> None:
    ends = [0]
    recorder = Recorder(tmp_path / "run.mcap")
    partial = tmp_path / "run.mcap.partial"
    header = partial.stat().st_size
    write = recorder.channel("/topic", KIND)
    recorder.start()
    for number in range(count):
        write(number + 1, message(number))
        if number % 20 == 19 or number == count - 1:
            ends.append(flushed(recorder))
    raw = partial.read_bytes()
    recorder.close()
    for cut in range(0, len(raw) + 1, max(len(raw) // 61, 1)):
        torn = tmp_path / "torn.mcap.partial"
        torn.write_bytes(raw[:cut])
        wanted = min(20 * sum(cut >= end for end in ends[1:]), count)
        if 0 < cut < header:
            with pytest.raises(UniconError, match="is not a recording that a killed run left"):
                recover(torn)
            torn.unlink()
            continue
        found = recover(torn)
        assert (0 if found is None else found[1]) == wanted
        if found is not None:
            assert read_by_both(found[0]) == {"/topic": list(range(1, wanted + 1))}
            found[0].unlink()
        assert not torn.exists()


def test_rubble_behind_the_last_chunk_is_cut_away(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "run.mcap")
    write = recorder.channel("/topic", KIND)
    recorder.start()
    partial = tmp_path / "run.mcap.partial"
    write(1, message(1))
    flushed(recorder)
    raw = partial.read_bytes()
    recorder.close()
    for rubble in (bytes(5000), b"\xff" * 5000, b"\x06" + b"\xff" * 40, raw[-40:]):
        partial.write_bytes(raw + rubble)
        found = recover(partial)
        assert found is not None
        assert read_by_both(found[0]) == {"/topic": [1]}


def test_a_broken_file_is_recovered_or_refused_and_never_more(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "run.mcap")
    write = recorder.channel("/topic", KIND)
    recorder.start()
    partial = tmp_path / "run.mcap.partial"
    for number in range(3):
        write(number + 1, message(number))
        flushed(recorder)
    raw = partial.read_bytes()
    recorder.close()
    rng = random.Random(1)
    counts = set()
    for _ in range(300):
        broken = bytearray(raw)
        for _ in range(rng.choice((1, 1, 5))):
            at = rng.randrange(len(raw))
            broken[at : at + rng.choice((1, 1, 8))] = rng.randbytes(rng.choice((1, 1, 8)))
        partial.write_bytes(broken)
        try:
            found = recover(partial)
        except UniconError:
            counts.add(-1)
            partial.unlink()
            continue
        counts.add(found[1] if found else 0)
        if found:
            found[0].unlink()
    assert counts == {-1, 0, 1, 2, 3}


def limit_files() -> None:
    resource.setrlimit(resource.RLIMIT_FSIZE, (2_000_000, 2_000_000))


@pytest.fixture
def little_room(tmp_path: Path) -> Iterator[Path]:
    """A file system of 2 MiB."""
    folder = tmp_path / "little"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=2m", "tmpfs", str(folder)]
    try:
        done = subprocess.run(mount, capture_output=True, text=True, check=False)
    except FileNotFoundError:
        pytest.skip("no mount command here")
    if done.returncode:
        pytest.skip(f"mounting a small file system needs root: {done.stderr.strip()}")
    yield folder
    subprocess.run(["umount", "-l", str(folder)], check=True)


def goes_on_without_room(file: Path, folder: Path, **options: Any) -> None:
    (folder / "hold.yaml").write_text(HOLD)
    report = folder / "report.json"
    run = subprocess.Popen(
        [
            *(sys.executable, "-m", "unicon_ros", "run", str(folder / "hold.yaml"), "--quiet"),
            *("--speed", "max", "--duration", "30"),
            *("--record", str(file), "--report", str(report)),
        ],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        **options,
    )
    out, err = run.communicate(timeout=100)
    assert run.returncode == 0, err
    assert "Traceback" not in err
    assert err.count("the run goes on without it") == 1  # told once
    told = json.loads(report.read_text())
    assert told["ticks"] == 1500
    assert told["faults"] == []
    recording = told["recording"]
    assert recording["messages"] > 0
    assert recording["dropped"] > 0
    assert recording["bytes"] > 0
    assert recording["error"].startswith(("File too large", "No space left on device"))
    assert f"{recording['dropped']} lost" in out
    assert sum(len(stamps) for stamps in read_by_both(file).values()) == recording["messages"]
    assert paths(file.parent) == [file.name]


def test_a_full_disk_ends_the_recording_and_not_the_run(little_room: Path, tmp_path: Path) -> None:
    goes_on_without_room(little_room / "run.mcap", tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(8))
def test_a_disk_that_fills_up_at_any_moment_keeps_what_was_written(
    little_room: Path, tmp_path: Path, seed: int
) -> None:
    """At real rate, as a file and as a bag folder, whose metadata may have no room either."""
    rng = random.Random(seed)
    size, folder = rng.randint(150, 2500), rng.random() < 0.5
    subprocess.run(["mount", "-o", f"remount,size={size}k", str(little_room)], check=True)
    target, report = little_room / ("run" if folder else "run.mcap"), tmp_path / "report.json"
    where = f"{target}/" if folder else str(target)
    to = ["--record", where, "--report", str(report), *(["--record-split=700KB"] * folder)]
    command = ["run", "go2_teleop", "--set", "rate=500", "--duration", "4", "--faults", "off"]
    run = [sys.executable, "-m", "unicon_ros", *command, *to]
    done = subprocess.run(run, capture_output=True, text=True, timeout=100, check=False)
    assert done.returncode == 0, done.stderr
    told = json.loads(report.read_text())
    recording = told["recording"]
    assert (told["ticks"], told["faults"]) == (2000, [])
    assert recording["dropped"] > 0
    assert recording["error"].count("No space left on device") == 1
    ticks = open_record(target).ticks
    assert len(ticks) > 10
    assert ticks.tolist() == list(range(len(ticks)))
    files = sorted(target.glob("*.mcap")) if folder else [target]
    read = [len(stamps) for file in files for stamps in read_by_both(file).values()]
    assert sum(read) == recording["messages"]


def test_a_file_that_must_not_grow_ends_the_recording_and_not_the_run(tmp_path: Path) -> None:
    goes_on_without_room(tmp_path / "new" / "run.mcap", tmp_path, preexec_fn=limit_files)


def test_a_summary_without_room_takes_that_of_the_last_chunks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recorder = Recorder(tmp_path / "run.mcap", warn=lambda line: None)
    write = recorder.channel("/topic", KIND)
    recorder.start()
    partial = tmp_path / "run.mcap.partial"
    for number in range(4):
        write(number + 1, message(number, 3000))
        flushed(recorder)
    room = partial.stat().st_size
    real = os.pwritev

    def full(descriptor: int, views: Any, position: int) -> int:
        size = sum(len(view) for view in views)
        if position + size > room:
            raise OSError(28, "No space left on device")
        return real(descriptor, views, position)

    monkeypatch.setattr(os, "pwritev", full)
    recorder.close()
    counts = recorder.counts()
    assert counts["messages"] + counts["dropped"] == 4
    assert 0 < counts["messages"] < 4
    from rosbags.highlevel import AnyReader

    with AnyReader([tmp_path / "run.mcap"]) as reader:
        assert len(list(reader.messages())) == counts["messages"]


@pytest.mark.parametrize("written", [False, True])
def test_a_file_that_is_deleted_is_told_and_the_run_goes_on(written: bool, tmp_path: Path) -> None:
    told: list[str] = []
    recorder = Recorder(tmp_path / "run.mcap", told.append)
    write = recorder.channel("/topic", KIND)
    recorder.start()
    partial = tmp_path / "run.mcap.partial"
    for number in range(3):
        write(number, message(number))
    if written:  # and nothing follows that could tell
        flushed(recorder)
    partial.unlink()
    recorder.close()
    line = told[0].partition(": ")[2]
    assert recorder.counts() == {"messages": 0, "dropped": 3, "bytes": 0, "error": line}
    assert len(told) == 1
    assert "somebody deleted it" in line
    assert paths(tmp_path) == []


def test_a_folder_that_is_moved_takes_the_recording_with_it(tmp_path: Path) -> None:
    folder = tmp_path / "here"
    recorder = Recorder(folder / "run.mcap")
    write = recorder.channel("/topic", KIND)
    recorder.start()
    folder.rename(tmp_path / "there")
    write(1, message(1))
    recorder.close()
    assert read_by_both(tmp_path / "there" / "run.mcap") == {"/topic": [1]}


@pytest.fixture
def stuck(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[], None]]:
    """A disk that takes nothing until it is told to."""
    from threading import Event

    go, real = Event(), McapFile.write

    def write(self: McapFile, *arguments: Any) -> None:
        go.wait(60)
        real(self, *arguments)

    monkeypatch.setattr(McapFile, "write", write)
    yield go.set
    go.set()


def test_a_disk_that_stands_still_drops_messages_and_counts_them(
    tmp_path: Path, stuck: Callable[[], None]
) -> None:
    told: list[str] = []
    recorder = Recorder(tmp_path / "run.mcap", told.append)
    write = recorder.channel("/topic", KIND)
    recorder.start()
    began = time.monotonic()
    for number in range(20_000):  # 20 MB
        write(number, message(number, 1000))
    assert time.monotonic() - began < 30.0  # the disk stands still for 60
    stuck()
    recorder.close()
    counts = recorder.counts()
    assert counts["dropped"] > 10_000
    assert counts["messages"] + counts["dropped"] == 20_000
    assert "too slow; messages are dropped" in counts["error"]
    assert len(told) == 1
    assert len(read_by_both(tmp_path / "run.mcap")["/topic"]) == counts["messages"]


def test_closing_does_not_wait_for_ever_for_a_disk_that_stands_still(
    tmp_path: Path, stuck: Callable[[], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("unicon_lab.recording.background.CLOSE_S", 0.2)
    told: list[str] = []
    recorder = Recorder(tmp_path / "run.mcap", told.append)
    recorder.channel("/topic", KIND)(1, message(1))
    recorder.start()
    began = time.monotonic()
    recorder.close()
    assert time.monotonic() - began < 30.0
    assert "the medium took nothing for 0.2 s" in told[0]


def test_at_full_speed_a_run_waits_for_the_disk_and_drops_nothing(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "run.mcap", patient=True)
    write = recorder.channel("/topic", KIND)
    recorder.start()
    for number in range(40_000):  # 40 MB
        write(number, message(number, 1000))
    recorder.close()
    assert recorder.counts()["messages"] == 40_000
    assert recorder.counts()["error"] == ""


def test_a_message_larger_than_the_memory_for_many_is_recorded(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "run.mcap")
    write = recorder.channel("/topic", KIND)
    recorder.start()
    for number, size in enumerate((10, 3_000_000, 10)):
        write(number, message(number, size))
    recorder.close()
    assert read_by_both(tmp_path / "run.mcap") == {"/topic": [0, 1, 2]}


@pytest.mark.slow
def test_two_runs_of_one_name_at_once_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "run.mcap"
    run = unicon("--record", str(file), "--duration", "120")
    try:
        grown(tmp_path / "run.mcap.partial", 20_000)
        assert main([*RUN, "--speed", "max", "--duration", "0.5", "--record", str(file)]) == 1
        told = capsys.readouterr().err
        assert "is being written by another run; let that end first, or give another name" in told
    finally:
        run.terminate()
        run.wait(20)
    assert read_by_both(file)["/joint_states"]


def test_what_is_not_a_recording_is_left_alone(tmp_path: Path) -> None:
    for content in (b"precious", b"\x89MCAP0\r\n"):
        partial = tmp_path / "run.mcap.partial"
        partial.write_bytes(content)
        with pytest.raises(UniconError, match="is not a recording that a killed run left; move"):
            Recorder(tmp_path / "run.mcap")
        assert partial.read_bytes() == content


def test_where_nothing_can_be_written_the_run_does_not_begin(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_bytes(b"")
    (tmp_path / "run.mcap.partial").mkdir()
    for name, line in (
        ("file/run.mcap", "cannot record to "),
        ("run.mcap", "run.mcap.partial is not a recording that a killed run left; move it away"),
        ("", " exists; move it away or give another name"),
    ):
        assert main([*RUN, "--duration", "1", "--record", str(tmp_path / name)]) == 1
        told = capsys.readouterr().err
        assert line in told
        assert told.count("\n") == 1


@pytest.mark.parametrize("why", [["--map", "nonesuch"], ["--view=window"]])
def test_a_run_that_is_not_built_leaves_no_file_and_no_thread(
    why: list[str], tmp_path: Path
) -> None:
    before = threading.active_count()
    assert main([*RUN, "--record", str(tmp_path / "run.mcap"), *why]) == 1
    assert paths(tmp_path) == []
    assert threading.active_count() == before


def test_others_read_what_is_written(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "run.mcap")
    small(recorder, 1001)
    found = read_by_both(tmp_path / "run.mcap")
    assert found == {"/even": list(range(1, 1002, 2)), "/odd": list(range(2, 1002, 2))}
    assert recorder.counts()["messages"] == 1001
    assert recorder.counts()["dropped"] == 0


def test_a_name_that_is_too_long_is_refused_in_a_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*RUN, "--speed", "max", "--record", str(tmp_path / ("x" * 300 + ".mcap"))]) == 1
    assert "File name too long; give a path" in capsys.readouterr().err


def test_a_link_is_neither_replaced_nor_written_through(tmp_path: Path) -> None:
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "a.mcap").symlink_to(tmp_path / "elsewhere" / "a")
    (tmp_path / "b.mcap.partial").symlink_to(tmp_path / "elsewhere" / "b")
    for name, told in (("a", "exists"), ("b", "symbolic links")):
        with pytest.raises(UniconError, match=told):
            Recorder(tmp_path / f"{name}.mcap")
    assert list((tmp_path / "elsewhere").iterdir()) == []
