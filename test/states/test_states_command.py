"""`unicon states`: the list, one segment in full, following states, and what dead writers left."""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from ring_processes import PATIENCE, counted_states, running, start, until, write_counts

from unicon_core.handles import FrameRing
from unicon_core.states import Layout, States, StateSpec
from unicon_core.states.backends.shm import Segment, ShmWriter, files, segments
from unicon_ros.cli.main import main
from unicon_ros.cli.states import summary

SPECS = {
    "joint_pos": StateSpec((3,), unit="rad", names=("hip", "thigh", "calf")),
    "contact": StateSpec((2,), "bool", description="feet on the ground"),
    "velocity_command": StateSpec((3,), frame="base", names=("vx", "vy", "wz")),
    "stamp_ns": StateSpec((), "int64", unit="ns"),
}
MEASURED = Layout({name: SPECS[name] for name in ("joint_pos", "contact", "stamp_ns")})
COMMAND = Layout({"velocity_command": SPECS["velocity_command"]})


class Walk:
    """A segment of two groups, with its writers."""

    def __init__(self, name: str = "walk") -> None:
        self.states = States(SPECS)
        self.segment = Segment.create(name, {"measured": MEASURED, "command": COMMAND})
        self.writers = [
            ShmWriter(self.segment, group, self.states) for group in ("measured", "command")
        ]

    def publish(self) -> None:
        for writer in self.writers:
            writer.publish()


@pytest.fixture
def walk(folder: Path) -> Iterator[Walk]:
    made = Walk()
    yield made
    made.segment.close()


def unicon(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    """Run the command; return its status, and what it prints."""
    status = main(["states", *arguments])
    told = capsys.readouterr()
    return status, told.out, told.err


# -- the list ------------------------------------------------------------------------------------


def test_an_empty_list_says_so(folder, capsys):
    assert unicon(capsys) == (
        0,
        "no process of this user shares its states (a workflow does with store: shm)\n",
        "",
    )


def test_living_dead_and_broken_segments_are_listed(folder, walk, capsys, tmp_path):
    walk.publish()
    dead = start(lambda: Walk("fell"))
    os.waitpid(dead, 0)
    (folder / f"unicon-{os.getuid()}-junk").write_bytes(bytes(4096))
    with running(lambda: write_counts("counts", pause=0.002)) as writer:
        until(lambda: len(list(segments())) == 4)
        until(lambda: " 0.0 Hz" not in unicon(capsys)[1].splitlines()[1])  # it writes by now
        status, told, err = unicon(capsys, "--json", str(tmp_path / "list.json"))
    assert (status, err) == (0, "")
    head, counts, fell, second, junk, measured, command, gap, broken, left = told.splitlines()
    assert head.split() == ["name", "process", "size", "group", "states", "bytes", "rate", "age"]
    assert counts.split()[:2] == ["counts", str(writer)]
    assert counts.split()[3:7] == ["B", "counts", "1", "2048"]
    assert float(counts.split()[7]) > 0.0
    size = str(walk.segment.memory.nbytes)
    assert fell.split()[:5] == ["fell", str(dead), "(dead)", size, "B"]
    assert fell.split()[5:] == ["measured", "3", "192", "-", "no", "value"]
    assert second.split() == ["command", "1", "64", "-", "no", "value"]
    assert junk.split()[:3] == ["junk", "?", "(dead)"]
    assert measured.split()[:2] == ["walk", str(os.getpid())]
    assert measured.split()[4:9] == ["measured", "3", "192", "0.0", "Hz"]
    assert command.split()[:5] == ["command", "1", "64", "0.0", "Hz"]
    assert gap == ""
    assert "junk is not a segment of unicon" in broken
    assert left == "left by writers that died: fell; unicon states --clean"
    listed = {each["name"]: each for each in json.loads((tmp_path / "list.json").read_text())}
    assert [each["alive"] for each in listed.values()] == [True, False, False, True]
    assert listed["walk"]["pid"] == os.getpid()
    assert listed["walk"]["hash"] == walk.segment.hash
    assert listed["walk"]["groups"]["measured"]["number"] == 1
    assert listed["fell"]["groups"]["command"]["age"] is None
    assert listed["counts"]["groups"]["counts"]["rate"] > 0.0
    assert "not a segment" in listed["junk"]["error"]


# -- one in full ---------------------------------------------------------------------------------


def test_a_segment_is_shown_with_its_present_values(walk, capsys):
    walk.states.joint_pos = [0.5, -1.25, float("nan")]
    walk.states.contact = [True, False]
    walk.states.stamp_ns = 123
    walk.writers[0].publish()
    status, told, err = unicon(capsys, "walk")
    assert (status, err) == (0, "")
    lines = told.splitlines()
    assert lines[0] == f"walk: {walk.segment.memory.nbytes} B of process {os.getpid()}"
    assert lines[2].startswith("group measured: 192 B, value 1, ")
    assert [line.split() for line in lines[5:8]] == [
        ["joint_pos", "3", "float32", "rad", "-", "0.5", "-1.25", "nan"],
        ["contact", "2", "bool", "-", "-", "True", "False"],
        ["stamp_ns", "scalar", "int64", "ns", "-", "123"],
    ]
    assert lines[9] == "group command: 64 B, no value yet"
    assert lines[12].split() == ["velocity_command", "3", "float32", "-", "base", "-"]


def test_what_a_dead_writer_left_is_shown_as_that(folder, capsys):
    os.waitpid(start(lambda: Walk("fell").publish()), 0)
    _, told, _ = unicon(capsys, "fell")
    assert told.splitlines()[1] == (
        "its writer has died, and these are its last values; unicon states --clean"
    )
    assert "value 1, " in told


@pytest.mark.parametrize(
    ("value", "told"),
    [
        (np.zeros(12), "all 0"),
        (np.arange(12), "0 … 11"),
        (np.arange(12) * 123456, "0 … 1358016"),
        (np.linspace(-1 / 3, 1, 5), "-0.3333 … 1"),
        (np.array([1.0, np.nan, 3.0, np.inf, 2.0]), "1 … inf, 1 NaN"),
        (np.full(5, np.nan), "5 NaN"),
        (np.array([True] * 3 + [False] * 4), "3 of 7 true"),
        (np.array(2.5), "2.5"),
        (np.ones((2, 2), int), "1 1 1 1"),
    ],
)
def test_many_numbers_are_told_by_their_range(value, told):
    assert summary(value) == told


# -- following -----------------------------------------------------------------------------------


def test_csv_has_every_element_in_full_precision(walk, capsys):
    walk.states.joint_pos = [0.1, 1e-30, float("nan")]
    walk.states.velocity_command = [-0.0, 2.0, float("inf")]
    walk.states.contact = [True, False]
    walk.states.stamp_ns = 2**62 + 1
    walk.publish()
    chosen = ("velocity_command", "joint_pos", "contact", "stamp_ns")
    status, told, err = unicon(
        capsys, "walk", "--watch", *chosen, "--csv", "--duration", "0.2", "--rate", "100"
    )
    assert (status, err) == (0, "")
    head, row = csv.reader(StringIO(told))  # nothing new came: one row
    assert head == [
        *("measured.stamp_ns", "command.stamp_ns"),
        *("velocity_command.vx", "velocity_command.vy", "velocity_command.wz"),
        *("joint_pos.hip", "joint_pos.thigh", "joint_pos.calf"),
        *("contact.0", "contact.1", "stamp_ns"),
    ]
    assert int(row[0]) == walk.segment.latest("measured")[1]
    assert int(row[1]) == walk.segment.latest("command")[1]
    assert row[2:5] == ["-0.0", "2.0", "inf"]
    assert np.array_equal(np.array(row[5:8], float), walk.states.joint_pos, equal_nan=True)
    assert row[8:] == ["1", "0", str(2**62 + 1)]


def test_a_batch_has_a_column_for_each_robot(folder, capsys):
    states = States(Layout({"joint_pos": SPECS["joint_pos"]}, 2))
    segment = Segment.create("batch", {"measured": states.layout})
    ShmWriter(segment, "measured", states).publish()
    _, told, _ = unicon(capsys, "batch", "--watch", "joint_pos", "--csv", "--duration", "0.01")
    assert told.splitlines()[0].endswith(
        "joint_pos.0.calf,joint_pos.1.hip,joint_pos.1.thigh,joint_pos.1.calf"
    )
    segment.close()


def test_values_of_a_running_process_are_followed(folder, capsys):
    with running(lambda: write_counts("counts", pause=0.001)):
        until(lambda: list(segments()))
        status, told, err = unicon(
            capsys, *("counts", "--watch", "words", "--csv", "--rate", "100", "--duration", "1")
        )
    assert (status, err) == (0, "")
    rows = [[int(cell) for cell in row] for row in csv.reader(StringIO(told)) if row[0].isdigit()]
    assert len(rows) > 2
    assert all(len(set(row[1:])) == 1 for row in rows)
    stamps, numbers = [row[0] for row in rows], [row[1] for row in rows]
    assert stamps == sorted(set(stamps))
    assert numbers == sorted(set(numbers))


def test_people_get_a_line_for_each_state(walk, capsys):
    walk.states.joint_pos = [0.5, -0.12345678, 3.0]
    walk.publish()
    _, told, _ = unicon(capsys, "walk", "--watch", "joint_pos", "contact", "--duration", "0.05")
    assert told.splitlines() == [
        "joint_pos [rad]: hip, thigh, calf",
        "contact: feet on the ground",
        "    0.000  joint_pos        0.5   -0.1235         3",
        "           contact        False     False",
    ]


def test_the_end_of_the_writer_is_told(folder, capsys):
    def ends() -> None:
        walk = Walk("ends")
        walk.publish()
        time.sleep(0.3)
        walk.segment.close()

    pid = start(ends)
    until(lambda: list(segments()))
    status, told, err = unicon(capsys, "ends", "--watch", "stamp_ns", "--csv", "--rate", "200")
    assert (status, err) == (0, f"unicon: ends: process {pid} has ended\n")
    assert len(told.splitlines()) == 2
    os.waitpid(pid, 0)


def test_the_death_of_the_writer_is_told(folder, capsys):
    pid = start(lambda: Walk("dies").publish())
    os.waitpid(pid, 0)
    status, told, err = unicon(capsys, "dies", "--watch", "stamp_ns", "--csv")
    assert status == 0
    assert err == f"unicon: dies: process {pid} has died; unicon states --clean removes the rest\n"
    assert len(told.splitlines()) == 2  # its last value


def test_a_silent_writer_is_told_once(walk, capsys):
    walk.publish()
    status, _, err = unicon(
        capsys, "walk", "--watch", "stamp_ns", "--rate", "50", "--duration", "1.5"
    )
    assert (status, err) == (
        0,
        f"unicon: walk: no new value for 1 s; process {os.getpid()} lives\n",
    )


def test_looking_changes_no_byte_and_takes_no_lock(walk, capsys):
    walk.publish()
    before = bytes(walk.segment.memory)
    unicon(capsys)
    unicon(capsys, "walk")
    unicon(capsys, "walk", "--watch", "stamp_ns", "--rate", "1000", "--duration", "0.1")
    assert bytes(walk.segment.memory) == before


# -- as a process: signals, pipes, a new writer --------------------------------------------------


class Watching:
    """`unicon states NAME --watch words --csv` as a process."""

    def __init__(self, name: str) -> None:
        command = [sys.executable, "-m", "unicon_ros", "states", name, "--watch", "words", "--csv"]
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
        self.process = subprocess.Popen([*command, "--rate", "100"], **pipes)
        self.head = self.process.stdout.readline()
        self.first = self.process.stdout.readline()

    def stop(self) -> None:
        self.process.send_signal(signal.SIGSTOP)
        until(lambda: "stopped" in Path(f"/proc/{self.process.pid}/status").read_text())

    def wait(self) -> tuple[int, str, str]:
        out, err = self.process.communicate(timeout=PATIENCE)
        return self.process.returncode, out, err


@pytest.fixture
def watched() -> Iterator[tuple[Watching, Segment]]:
    """A watcher of a segment of this process, among those of this machine."""
    states, name = counted_states(), f"test-watched-{os.getpid()}"
    segment = Segment.create(name, {"counts": states.layout})
    ShmWriter(segment, "counts", states).publish()
    watching = Watching(name)
    yield watching, segment
    watching.process.kill()
    watching.wait()
    segment.close()


def test_ctrl_c_ends_it_well(watched):
    watching, _ = watched
    watching.process.send_signal(signal.SIGINT)
    assert watching.wait() == (0, "", "")


def test_a_reader_that_goes_ends_it_quietly(watched):
    watching, segment = watched
    watching.process.stdout.close()
    states = counted_states()
    writer = ShmWriter(segment, "counts", states)
    writer.publish()
    writer.publish()
    assert watching.process.wait(PATIENCE) == 0
    assert watching.process.stderr.read() == ""


def test_a_new_writer_is_followed(watched):
    watching, segment = watched
    watching.stop()
    segment.close()
    states = counted_states()
    states.words = 5
    name, groups = segment.name, segment.groups

    def follows() -> None:
        ShmWriter(Segment.create(name, groups), "counts", states).publish()
        time.sleep(PATIENCE)

    with running(follows) as writer:
        until(lambda: name in [found.name for found in segments()])
        watching.process.send_signal(signal.SIGCONT)
        assert watching.process.stdout.readline().rstrip().endswith(",5,5")
    status, _, err = watching.wait()
    assert status == 0
    assert err.splitlines() == [
        f"unicon: {name}: process {writer} has taken over",
        f"unicon: {name}: process {writer} has died; unicon states --clean removes the rest",
    ]
    Segment.create(name, groups).close()


def test_another_layout_is_refused_by_the_first_state_that_differs(watched):
    watching, segment = watched
    watching.stop()
    segment.close()
    other = Segment.create(segment.name, {"counts": Layout({"words": StateSpec((8,), "int64")})})
    watching.process.send_signal(signal.SIGCONT)
    status, _, err = watching.wait()
    other.close()
    assert status == 1
    assert err == (
        f"unicon: error: segment {segment.name!r}, group 'counts': state 'words': shape is [256] "
        "here and [8] there\n"
    )


# -- leftovers and wrong use ---------------------------------------------------------------------


def test_clean_removes_what_the_dead_left_and_nothing_else(folder, walk, capsys):
    os.waitpid(start(lambda: Walk("fell")), 0)
    os.waitpid(start(lambda: Walk("slipped")), 0)
    os.waitpid(start(lambda: FrameRing.create(8)), 0)
    (frames,) = folder.glob("unicon_frames_*")
    junk = folder / f"unicon-{os.getuid()}-junk"
    junk.write_bytes(bytes(4096))
    status, told, err = unicon(capsys, "--clean")
    assert (status, err) == (0, "")
    assert told.splitlines() == [
        "removed fell",
        "removed slipped",
        f"removed {frames.name}",
        f"left junk: store shm: {junk} is not a segment of unicon; end what writes it, or remove "
        "it",
    ]
    junk.unlink()
    assert unicon(capsys, "--clean") == (0, "no writer that died has left anything\n", "")
    assert [found.name for found in segments()] == ["walk"]
    assert walk.segment.alive()


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("wlk",), "no segment 'wlk' in FOLDER; did you mean 'walk'? known: walk"),
        (("a/b",), "a segment cannot be named 'a/b'; use letters, digits, '_', '.' and '-'"),
        (
            ("walk", "--watch", "jointpos"),
            "segment 'walk' has no state 'jointpos'; did you mean 'joint_pos'? known: contact, "
            "joint_pos, stamp_ns, velocity_command",
        ),
        (
            ("--watch", "joint_pos"),
            "states: --watch goes with a name: unicon states NAME --watch joint_pos; there are: "
            "walk",
        ),
        (
            ("walk", "--csv"),
            "states: --csv goes with --watch: unicon states NAME --watch STATE --csv",
        ),
        (
            ("--rate", "5"),
            "states: --rate goes with --watch: unicon states NAME --watch STATE --rate",
        ),
        (
            ("walk", "--json", "x.json"),
            "states: --json writes the list: unicon states --json FILE",
        ),
        (
            ("walk", "--clean"),
            "states: --clean removes whatever writers that died have left, and takes no name: "
            "unicon states --clean",
        ),
        (
            ("--json", "/nowhere/x.json"),
            "cannot write /nowhere/x.json: No such file or directory; give a path in a writable "
            "folder with room",
        ),
    ],
)
def test_wrong_use_is_one_line(arguments, told, walk, capsys):
    told = told.replace("FOLDER", str(files.FOLDER))
    assert unicon(capsys, *arguments) == (1, "", f"unicon: error: {told}\n")


@pytest.mark.parametrize("rate", ["0", "-1", "nan", "inf", "x"])
def test_a_rate_is_a_number(rate, folder, capsys):
    with pytest.raises(SystemExit) as stopped:
        main(["states", "walk", "--watch", "x", "--rate", rate])
    assert stopped.value.code == 2
    assert f"--rate: {rate} is not" in capsys.readouterr().err or rate == "x"
