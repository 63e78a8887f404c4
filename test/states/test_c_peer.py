"""Peers in C: what they refuse, whole values under contention, killed at any moment."""

from __future__ import annotations

import os
import random
import signal
import struct
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import c_peers
import pytest

from unicon_base.errors import StateError
from unicon_core.states import Layout, States, StateSpec
from unicon_core.states.backends.shm import (
    Segment,
    ShmReader,
    ShmWriter,
    remove_dead,
    segment_path,
    segments,
)
from unicon_core.states.backends.shm import segment as layout
from unicon_core.states.backends.shm.files import HEAD, started
from unicon_core.states.groups import groups_of

NAME = f"test-c-{os.getpid()}"
NUMBERS = Layout({"numbers": StateSpec((250,), "float64"), "count": StateSpec((), "int64")})
GROUPS = groups_of(NUMBERS)
PATIENCE = 20.0


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("c")


@pytest.fixture(scope="module")
def hammer(folder: Path) -> Path:
    return c_peers.build(c_peers.HAMMER, GROUPS, folder)


RUNNING: list[subprocess.Popen[str]] = []


def begin(*command: object) -> subprocess.Popen[str]:
    """Start a peer; a test that fails leaves none running."""
    pipe = subprocess.PIPE
    RUNNING.append(subprocess.Popen(list(map(str, command)), stdout=pipe, stderr=pipe, text=True))
    return RUNNING[-1]


@pytest.fixture(autouse=True)
def nothing_is_left() -> Iterator[None]:
    yield
    for process in [*RUNNING]:
        kill(process)
    left = [found.name for found in segments() if found.name.startswith(NAME)]
    for name in left:
        segment_path(name).unlink()
    assert left == []


# -- what is refused ------------------------------------------------------------------------------


def run(*command: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [str(word) for word in command],
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        check=False,
    )


def refusal(program: Path, mode: str = "read") -> str:
    """Return what `hammer` says when it refuses, one line."""
    done = run(program, mode, NAME, *(("0.1", "-1") if mode == "read" else ("0",)))
    assert (done.returncode, done.stdout) == (1, "")
    path, _, why = done.stderr.partition(": ")
    assert path == str(segment_path(NAME))
    assert why.count("\n") == 1
    return why.strip()


def test_a_header_of_another_layout_is_refused(hammer):
    for specs in (
        NUMBERS.specs | {"numbers": StateSpec((250,), "int64")},  # as long, and other numbers
        NUMBERS.specs | {"numbers": StateSpec((250,), "float64", "rad")},
        NUMBERS.specs | {"more": StateSpec()},
    ):
        made = Segment.create(NAME, groups_of(Layout(specs)))
        assert refusal(hammer).startswith("has other states than this program; make its header")
        made.close()


def test_a_segment_without_the_group_is_refused(tmp_path):
    layout = Layout(NUMBERS.specs | {"joint_damping": StateSpec((2,))})
    hammer = c_peers.build(c_peers.HAMMER, groups_of(layout), tmp_path)
    made = Segment.create(NAME, {"command": groups_of(layout)["command"]})
    assert refusal(hammer) == "has no such group"
    made.close()
    for groups in (groups_of(layout), {"measured": groups_of(layout)["measured"]}):
        made = Segment.create(NAME, groups)
        states = States(layout)
        states.numbers, states.count = 1.0, 1
        ShmWriter(made, "measured", states).publish()
        assert run(hammer, "read", NAME, "1", "1").stdout == "1 0 0 0 1\n"
        made.close()


def test_each_field_of_the_head_is_checked(hammer):
    made = Segment.create(NAME, GROUPS)
    size = made.memory.nbytes
    for at, wrong, why in (
        (0, b"UNICONST", "is not a segment of unicon"),
        (8, struct.pack("<I", 2), "is of another version"),
        (12, struct.pack(">I", 0x01020304), "has another byte order"),
        (32, struct.pack("<Q", size + 64), "is not as long as it says"),
        (40, struct.pack("<Q", 2**63), "is not as long as it says"),
        (48, b"0" * 64, "has other states"),
        (layout.JSON_AT + 20, b"\xff", "has other states"),
    ):
        right = bytes(made.memory[at : at + len(wrong)])
        made.memory[at : at + len(wrong)] = wrong
        assert refusal(hammer).startswith(why)
        made.memory[at : at + len(wrong)] = right
    made.close()
    assert refusal(hammer).startswith("cannot be read; is its writer running?")
    for content in (b"", b"UNICONSH", bytes(4096)):
        segment_path(NAME).write_bytes(content)
        assert refusal(hammer).startswith("is not a segment")
    segment_path(NAME).unlink()
    segment_path(NAME).symlink_to(os.devnull)
    assert refusal(hammer).startswith("cannot be read")
    segment_path(NAME).unlink()
    assert "cannot be named so" in run(hammer, "read", "../etc/passwd", "1", "0").stderr
    assert "cannot be named so" in run(hammer, "write", "x" * 101, "0").stderr


# -- one writer of a name --------------------------------------------------------------------------


def start(hammer: Path, pause_us: int = 0) -> subprocess.Popen[str]:
    """Start a writer in C, and wait until it has published."""
    process = begin(hammer, "write", NAME, pause_us)
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        try:
            segment = Segment.attach(NAME)
        except StateError:
            segment = None
        if segment is not None:
            mine = segment.pid == process.pid and segment.latest("measured")[0]
            segment.close()
            if mine:
                return process
        time.sleep(0.001)
    process.kill()
    raise AssertionError("the writer did not begin")


def kill(process: subprocess.Popen[str]) -> None:
    process.kill()
    process.communicate()  # its pipes are closed
    RUNNING.remove(process)


def test_c_and_python_take_no_name_from_one_who_lives(hammer):
    made = Segment.create(NAME, GROUPS)
    assert refusal(hammer, "write") == "another process writes it just now; end that one"
    made.close()
    writer = start(hammer)
    with pytest.raises(StateError, match=f"is written by process {writer.pid} just now"):
        Segment.create(NAME, GROUPS)
    segment = Segment.attach(NAME)
    head = HEAD.unpack_from(segment.memory)
    assert head[4] == started(writer.pid)
    assert segment_path(NAME).stat().st_mode & 0o777 == 0o600
    segment.close()
    kill(writer)
    made = Segment.create(NAME, GROUPS)  # what C left
    made.close()


def test_of_many_that_want_a_dead_ones_name_one_gets_it(hammer):
    for _ in range(5):
        kill(start(hammer))
        peers = [begin(hammer, "write", NAME, 1000) for _ in range(6)]
        end = time.monotonic() + PATIENCE
        while sum(peer.poll() is None for peer in peers) > 1:
            remove_dead(NAME)  # has a lock on the dead one's for a moment
            assert time.monotonic() < end
        [winner] = [peer for peer in peers if peer.poll() is None]
        for peer in peers:
            if peer is not winner:
                assert "another process writes it just now" in peer.communicate()[1]
        reader = ShmReader(NAME, "measured", States(NUMBERS))
        assert reader.wait(PATIENCE)
        assert reader._segment.pid == winner.pid
        reader.close()
        kill(winner)
    assert remove_dead(NAME)


def whole(states: States, reader: ShmReader) -> bool:
    """Whether a value is one and the same all through, and the one that its number says."""
    return bool((states.numbers == states.count).all()) and states.count == reader.number


def killed_at_random(hammer: Path, times: int) -> None:
    """Kill a writer in C again and again: readers keep a whole value and find the next writer."""
    states, chance = States(NUMBERS), random.Random(times)
    writer = start(hammer)
    reader = ShmReader(NAME, "measured", states)
    looks = 0
    for _ in range(times):
        assert reader.alive()
        end = time.monotonic() + chance.uniform(0.0, 0.01)
        while time.monotonic() < end:
            if reader.take():
                assert whole(states, reader)
                looks += 1
        kill(writer)
        while reader.take():
            assert whole(states, reader)
        assert not reader.alive()
        assert whole(states, reader)  # the last one stays
        number, _ = reader._segment.latest("measured")
        assert number == reader.number
        writer = start(hammer)
    reader.close()
    kill(writer)
    assert remove_dead(NAME)
    assert looks > times
    assert reader.starved == 0


def test_a_writer_in_c_that_is_killed_leaves_a_whole_value(hammer):
    killed_at_random(hammer, 30)


@pytest.mark.slow
def test_a_writer_in_c_is_killed_a_thousand_times(hammer):
    killed_at_random(hammer, 1000)


# -- contention ------------------------------------------------------------------------------------


def contended(hammer: Path, values: int, readers: int) -> None:
    """Publish from Python without a pause, to readers in C that sleep and that look."""
    states = States(NUMBERS)
    made = Segment.create(NAME, GROUPS)
    writer = ShmWriter(made, "measured", states)
    peers = [begin(hammer, "read", NAME, 600, values) for _ in range(readers)]
    for i in range(1, values + 1):
        states.numbers, states.count = i, i
        writer.publish()
    for peer in peers:
        said, _ = peer.communicate(timeout=60)
        taken, torn, back, starved, last = map(int, said.split())
        assert (torn, back, starved, last) == (0, 0, 0, values)
        assert 0 < taken <= values
    made.close()


def test_readers_in_c_get_whole_values_from_python(hammer):
    contended(hammer, 100_000, 2)


@pytest.mark.slow
def test_readers_in_c_get_whole_values_for_long(hammer):
    contended(hammer, 5_000_000, 3)


def reads_of_c(hammer: Path, seconds: float) -> None:
    """Read a writer in C that never pauses, from Python and from C."""
    writer = start(hammer)
    states = States(NUMBERS)
    reader = ShmReader(NAME, "measured", states)
    peer = begin(hammer, "read", NAME, seconds, -1)
    taken, before, end = 0, 0, time.monotonic() + seconds
    while time.monotonic() < end:
        if reader.wait(0.1) and reader.take():
            assert whole(states, reader)
            assert reader.number > before
            before = reader.number
            taken += 1
    said, _ = peer.communicate(timeout=PATIENCE)
    kill(writer)
    reader.close()
    assert taken > 0
    assert remove_dead(NAME)
    in_c, torn, back, _, _ = map(int, said.split())
    assert (torn, back) == (0, 0)
    assert in_c > 0


def test_readers_of_a_writer_in_c_get_whole_values(hammer):
    reads_of_c(hammer, 1.0)


@pytest.mark.slow
def test_readers_of_a_writer_in_c_get_whole_values_for_long(hammer):
    reads_of_c(hammer, 60.0)


# -- sleeping --------------------------------------------------------------------------------------


def test_a_reader_in_c_that_is_killed_asleep_or_stopped_holds_nobody_up(hammer):
    states = States(NUMBERS)
    made = Segment.create(NAME, GROUPS)
    writer = ShmWriter(made, "measured", states)
    asleep = [begin(hammer, "read", NAME, 60, -1) for _ in range(2)]
    place = made.starts["measured"] + layout.SLEEPERS
    end = time.monotonic() + PATIENCE
    while sum(made.memory[place : place + layout.MAX_SLEEPERS]) < 2:
        assert time.monotonic() < end
        time.sleep(0.001)
    asleep[0].send_signal(signal.SIGSTOP)
    for _ in range(1000):
        writer.publish()
    for peer in asleep:
        kill(peer)
    for _ in range(2000):
        writer.publish()
    assert not any(made.memory[place : place + layout.MAX_SLEEPERS])  # their places are free again
    made.close()


def test_a_writer_in_c_clears_after_readers_that_were_killed_asleep(hammer):
    writer = start(hammer, pause_us=1)
    segment = Segment.attach(NAME)
    at = segment.starts["measured"] + layout.SLEEPERS
    place = segment.sleeper()
    segment.memory[at : at + 3] = b"\1\1\1"  # the first is ours
    end = time.monotonic() + PATIENCE
    while segment.memory[at + 1] or segment.memory[at + 2]:
        assert time.monotonic() < end
        time.sleep(0.001)
    assert (place, segment.memory[at]) == (0, 1)
    kill(writer)
    segment.close()
    assert remove_dead(NAME)


def test_64_readers_sleep_and_the_next_is_told(hammer):
    made = Segment.create(NAME, GROUPS)
    held = [Segment.attach(NAME) for _ in range(layout.MAX_SLEEPERS)]
    places = [segment.sleeper() for segment in held]
    assert sorted(places) == list(range(layout.MAX_SLEEPERS))
    assert refusal(hammer) == "64 readers sleep already; poll it"
    for segment in held:
        segment.close()
    made.close()
