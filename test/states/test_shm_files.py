"""What stands under a segment's name: damage, other kinds of files, no room, and races for it."""

from __future__ import annotations

import errno
import os
import socket
import struct
import subprocess
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from ring_processes import PATIENCE, counted_states, end, start

from unicon_base.errors import StateError
from unicon_core.states import Layout, States, StateSpec
from unicon_core.states.backends.shm import (
    Segment,
    ShmReader,
    ShmWatcher,
    ShmWriter,
    clean,
    segment_path,
    segments,
)
from unicon_core.states.backends.shm.files import HEAD
from unicon_core.states.backends.shm.segment import JSON_AT
from unicon_core.states.groups import groups_json
from unicon_ros.cli.states import look

LAYOUT = Layout({"joint_pos": StateSpec((3,), unit="rad"), "stamp_ns": StateSpec((), "int64")})
GROUPS = {"measured": LAYOUT}
TEXT = groups_json(GROUPS).encode()

root = pytest.mark.skipif(os.getuid() != 0, reason="needs root")


def good_bytes() -> bytes:
    """Return a segment with a value in it, whose writer has gone."""
    states = States(LAYOUT)
    segment = Segment.create("good", GROUPS)
    ShmWriter(segment, "measured", states).publish()
    made = bytes(segment.memory)
    segment.close()
    return made


def attempts(name: str) -> list[str]:
    """Try all ways to read a file; return what errors of ours say. No other is raised."""
    told = []

    def read(way: Callable[[], Segment | ShmWatcher]) -> None:
        try:
            way().close()
        except StateError as error:
            told.append(str(error))

    def taken(kind: type[ShmWatcher]) -> ShmWatcher:
        reader = kind(name, "measured", States(LAYOUT))
        reader.take()
        reader.alive()
        if isinstance(reader, ShmReader):
            reader.wait(0.0)
        return reader

    read(lambda: Segment.attach(name))
    read(lambda: Segment.attach(name, read_only=True))
    read(lambda: taken(ShmWatcher))
    read(lambda: taken(ShmReader))
    look(0.0)
    return told


@settings(
    deadline=None, max_examples=100, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    flips=st.lists(
        st.tuples(st.integers(0, JSON_AT + len(TEXT) - 1), st.integers(1, 255)), max_size=4
    ),
    length=st.none() | st.integers(0, 4096),
    fill=st.none() | st.integers(0, 255),
)
def test_a_damaged_segment_is_refused_in_one_line(folder, flips, length, fill):
    damaged = bytearray(good_bytes())
    for place, flip in flips:
        damaged[place] ^= flip
    if fill is not None:  # the ring itself
        start_ = len(damaged) - (2 * 64 + 4 * (64 + LAYOUT.nbytes))
        damaged[start_:] = bytes([fill]) * (len(damaged) - start_)
    if length is not None:
        damaged = damaged[:length].ljust(length, b"\0")
    path = segment_path("damaged")
    path.write_bytes(damaged)
    try:
        told = attempts("damaged")
        assert all("remove it" in error and "\n" not in error for error in told)
        # Process and its start are told only, and behind the head is a gap; else each byte counts.
        good = good_bytes()
        same = damaged[:16] == good[:16] and damaged[32 : HEAD.size] == good[32 : HEAD.size]
        same = same and damaged[JSON_AT : JSON_AT + len(TEXT)] == TEXT
        assert len(told) == (0 if same and len(damaged) == len(good) else 4)
        if damaged[:8] == good[:8]:  # what is known as a leftover is replaced
            Segment.create("damaged", GROUPS).close()
            assert not path.exists()
        else:
            with pytest.raises(StateError, match="is not a segment of unicon; remove it"):
                Segment.create("damaged", GROUPS)
            assert clean() == []
            assert path.exists()
    finally:
        path.unlink(missing_ok=True)


def test_every_truncation_is_refused(folder):
    good = good_bytes()
    path = segment_path("short")
    for length in [*range(0, 700, 7), len(good) - 1]:
        path.write_bytes(good[:length])
        with pytest.raises(StateError, match="remove it"):
            Segment.attach("short")
    path.write_bytes(good)
    Segment.attach("short").close()


def test_what_a_damaged_header_says_is_told(folder):
    fields = list(HEAD.unpack_from(good_bytes()))
    wrong = [
        (0, b"OTHERONE", "is not a segment of unicon"),
        (1, 2, "is of version 2, and this program reads version 1"),
        (2, 0x04030201, "has another byte order"),
        (5, 1 << 63, "is not as long as it says"),
        (6, 1 << 62, "is not as long as it says"),
        (6, len(TEXT) - 1, "has a damaged description of its states"),
        (7, b"0" * 64, "has a damaged description of its states"),
    ]
    for field, value, what in wrong:
        damaged = bytearray(good_bytes())
        HEAD.pack_into(damaged, 0, *[*fields[:field], value, *fields[field + 1 :]])
        segment_path("wrong").write_bytes(damaged)
        with pytest.raises(StateError, match=f"wrong {what}; end what writes it, or remove it"):
            Segment.attach("wrong")


def test_a_description_in_other_words_is_refused(folder):
    """Its hash is right; but where groups begin would be counted from another length."""
    good = good_bytes()
    spaced = TEXT.replace(b",", b", ", 1)
    damaged = bytearray(good)
    struct.pack_into("<Q", damaged, 48, len(spaced))
    damaged[JSON_AT : JSON_AT + len(spaced)] = spaced
    segment_path("spaced").write_bytes(damaged)
    with pytest.raises(StateError, match="has a damaged description"):
        Segment.attach("spaced")


def make_folder(path: Path) -> None:
    path.mkdir()


def make_link(path: Path) -> None:
    path.symlink_to(path.parent / "elsewhere")


def make_link_to_a_segment(path: Path) -> None:
    elsewhere = path.parent / "elsewhere"
    elsewhere.write_bytes(good_bytes())
    path.symlink_to(elsewhere)


def make_socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as made:
        made.bind(str(path))


def make_foreign(path: Path) -> None:
    path.write_bytes(good_bytes())
    os.chown(path, 12345, -1)


@pytest.mark.parametrize(
    ("make", "what"),
    [
        (os.mkfifo, "is not a file"),
        (make_folder, "Is a directory|is not a file"),
        (make_link, "Too many levels of symbolic links"),
        (make_link_to_a_segment, "Too many levels of symbolic links"),
        (make_socket, "No such device or address"),
        pytest.param(make_foreign, "belongs to user 12345", marks=root),
    ],
)
def test_what_is_not_a_file_of_ours_is_refused_and_left(folder, make, what):
    path = segment_path("odd")
    make(path)
    for read_only in (False, True):
        with pytest.raises(StateError, match=f"odd.*({what}); remove it"):
            Segment.attach("odd", read_only=read_only)
    with pytest.raises(StateError, match=f"odd.*({what}); remove it"):
        Segment.create("odd", GROUPS)
    assert [found.name for found in segments()] == []
    assert clean() == []
    assert os.path.lexists(path)


@root
def test_a_file_that_may_not_be_opened_is_refused(folder):
    def without_rights() -> None:
        os.setgid(65534)
        os.setuid(65534)
        path = segment_path("closed")
        path.write_bytes(b"")
        path.chmod(0)
        with pytest.raises(StateError, match=r"cannot read .*closed: Permission denied"):
            Segment.attach("closed")
        with pytest.raises(StateError, match=r"cannot take over .*closed: Permission denied"):
            Segment.create("closed", GROUPS)
        assert list(segments()) == []
        assert clean() == []

    folder.chmod(0o777)
    assert os.waitpid(start(without_rights), 0)[1] == 0


# -- no room -------------------------------------------------------------------------------------


def descriptors() -> int:
    return len(os.listdir("/proc/self/fd"))


def test_where_there_is_no_room_nothing_is_left(folder, monkeypatch):
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    before = descriptors()
    monkeypatch.setattr(os, "posix_fallocate", full)
    with pytest.raises(StateError, match=f"No space left on device; make room in {folder}"):
        Segment.create("large", GROUPS)
    assert not list(folder.iterdir())
    assert descriptors() == before


@root
def test_a_file_system_that_is_full_is_told(folder, monkeypatch):
    small = folder / "small"
    small.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=64k", "unicon_test", str(small)], capture_output=True
    )
    if mounted.returncode:
        pytest.skip("may not mount")
    try:
        from unicon_core.states.backends.shm import files

        monkeypatch.setattr(files, "FOLDER", small)
        with pytest.raises(StateError, match=r"\d+ bytes for .*: No space left on device; make ro"):
            Segment.create("large", {"g": Layout({"x": StateSpec((10_000,))})})
        assert not list(small.iterdir())
        states = States(LAYOUT)
        segment = Segment.create("fits", GROUPS)
        with suppress(OSError):
            (small / "rest").write_bytes(bytes(1 << 20))
        writer = ShmWriter(segment, "measured", states)  # its pages are there: no SIGBUS now
        reader = ShmReader("fits", "measured", States(LAYOUT))
        for _ in range(8):
            writer.publish()
            assert reader.take()
        reader.close()
        segment.close()
        (small / "rest").unlink()
        assert not list(small.iterdir())
    finally:
        subprocess.run(["umount", "--lazy", str(small)], check=True)


def test_a_folder_that_is_not_there_is_told(folder, monkeypatch):
    from unicon_core.states.backends.shm import files

    monkeypatch.setattr(files, "FOLDER", folder / "nowhere")
    with pytest.raises(StateError, match=r"cannot make .*: No such file or directory"):
        Segment.create("x", GROUPS)
    assert list(segments()) == []


def test_a_signal_after_the_name_was_given_leaves_nothing(folder, monkeypatch):
    from unicon_core.states.backends.shm import segment

    give_name = segment.give_name

    def interrupted(fd: int, name: str) -> None:
        give_name(fd, name)
        raise KeyboardInterrupt

    monkeypatch.setattr(segment, "give_name", interrupted)
    before = descriptors()
    with pytest.raises(KeyboardInterrupt):
        Segment.create("x", GROUPS)
    assert not list(folder.iterdir())
    assert descriptors() == before


# -- races ---------------------------------------------------------------------------------------


def race(sweeping: bool) -> None:
    """Let four processes race for a name; those that die leave it to the next race."""
    groups = {"counts": counted_states().layout}
    gate_out, gate_in = os.pipe()
    told_out, told_in = os.pipe()

    def create() -> None:
        os.close(gate_in)
        os.read(gate_out, 1)
        try:
            made = Segment.create("raced", groups)
            told = b"won" if made.alive() else b"???"
        except StateError as error:
            told = b"not" if "is written by process" in str(error) else b"???"
        os.write(told_in, told)
        time.sleep(PATIENCE)

    def sweep() -> None:
        os.close(gate_in)
        os.read(gate_out, 1)
        while True:
            clean()

    processes = [start(create) for _ in range(4)] + [start(sweep) for _ in range(sweeping)]
    os.close(gate_in)  # off they go
    told = b""
    while len(told) < 12:
        told += os.read(told_out, 12)
    assert sorted(told[k : k + 3] for k in range(0, 12, 3)) == [b"not"] * 3 + [b"won"]
    assert [found.alive for found in segments()] == [True]
    for fd in (gate_out, told_in, told_out):
        os.close(fd)
    for pid in processes:
        end(pid)


@pytest.mark.slow
def test_of_writers_that_race_one_wins(folder):
    for round_ in range(10):
        race(sweeping=round_ % 2 == 1)
    clean()
    assert not list(folder.iterdir())


@pytest.mark.slow
def test_of_writers_that_race_many_times_one_wins(folder):
    for round_ in range(300):
        race(sweeping=round_ % 2 == 1)
    clean()
    assert not list(folder.iterdir())
