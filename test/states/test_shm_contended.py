"""Shared memory under contention, SIGKILL and SIGSTOP: values stay whole, and others go on."""

from __future__ import annotations

import os
import random
import signal
import time
from pathlib import Path

import pytest
from ring_processes import (
    counted_states,
    end,
    is_whole,
    read_counts,
    running,
    start,
    until,
    write_counts,
)

from unicon_base.errors import StateError
from unicon_core.states.backends.shm import (
    Segment,
    ShmReader,
    ShmWatcher,
    ShmWriter,
    clean,
    files,
    remove_dead,
    segments,
)
from unicon_core.states.backends.shm.segment import MAX_SLEEPERS


def contended_reads(reads: int) -> None:
    with running(lambda: write_counts("full")):
        until(lambda: [found for found in segments() if found.name == "full"])
        readers = [start(lambda: read_counts("full", reads)) for _ in range(3)]
        assert [os.waitpid(pid, 0)[1] for pid in readers] == [0, 0, 0]
    assert clean() == ["full"]


def test_no_contended_read_is_torn_or_starves(folder: Path) -> None:
    contended_reads(20_000)


@pytest.mark.slow
def test_of_ten_million_contended_reads_none_is_torn_or_starves(folder: Path) -> None:
    contended_reads(3_333_334)


def killed_writers(times: int, seed: int) -> None:
    """Kill writers of one name, every other one perhaps before it has the name."""
    chance = random.Random(seed)
    states = counted_states()
    writer = start(lambda: write_counts("killed"))
    until(lambda: [found for found in segments() if found.alive])
    reader = ShmReader("killed", "counts", states)
    inodes = set()
    for kill in range(times):
        if kill % 2 == 0:
            until(reader.alive)
        moment = time.monotonic() + chance.uniform(0.0, 0.005)
        while time.monotonic() < moment:
            if reader.take():
                assert is_whole(states, reader)
            reader.alive()
        end(writer)
        reader.alive()  # where it has come as far as to take the name, it is followed
        assert not reader.alive()
        reader.take()
        assert is_whole(states, reader)
        assert reader.starved == 0
        inodes.add(reader._segment.inode)
        writer = start(lambda: write_counts("killed"))
    until(reader.alive)
    until(reader.take)
    assert is_whole(states, reader)
    end(writer)
    assert not reader.alive()
    assert len(inodes) > 1
    reader.close()


@pytest.mark.slow
def test_what_a_killed_writer_leaves_is_whole_and_known_to_be_stale(folder: Path) -> None:
    killed_writers(20, seed=1)
    assert len(list(folder.iterdir())) == 1
    assert clean() == ["killed"]
    assert not list(folder.iterdir())


@pytest.mark.slow
def test_a_thousand_killed_writers_leave_whole_values_and_nothing_else(folder: Path) -> None:
    killed_writers(1000, seed=2)
    assert len(list(folder.iterdir())) == 1
    states = counted_states()
    Segment.create("killed", {"counts": states.layout}).close()  # takes it over, and goes
    assert not list(folder.iterdir())


def test_who_removes_a_dead_writers_segment_is_not_taken_for_a_writer(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with running(lambda: write_counts("dead")):
        until(lambda: list(segments()))
        reader = ShmReader("dead", "counts", counted_states())
        until(reader.take)
    seen = []
    unname = files.unname

    def looked_at(path: Path, inode: int) -> None:
        seen.append((reader.alive(), [found.alive for found in segments()], clean()))
        unname(path, inode)

    monkeypatch.setattr(files, "unname", looked_at)
    assert remove_dead("dead")
    assert seen == [(False, [False], [])]  # and nobody else removes it
    assert not list(folder.iterdir())
    reader.close()


def test_a_stopped_writer_lives_and_is_silent(folder: Path) -> None:
    with running(lambda: write_counts("still", pause=0.001)) as writer:
        until(lambda: list(segments()))
        states = counted_states()
        reader = ShmReader("still", "counts", states)
        until(reader.take)
        os.kill(writer, signal.SIGSTOP)
        os.waitpid(writer, os.WUNTRACED)
        reader.take()
        assert is_whole(states, reader)
        assert not reader.wait(0.05)
        assert not reader.take()
        assert reader.alive()
        stamp, number = reader.stamp_ns, reader.number
        with pytest.raises(StateError, match=f"is written by process {writer} just now"):
            Segment.create("still", {"counts": states.layout})
        os.kill(writer, signal.SIGCONT)
        assert reader.wait(60.0)
        assert reader.take()
        assert is_whole(states, reader)
        assert reader.number > number
        assert reader.stamp_ns > stamp
        reader.close()


def sleep_on(name: str) -> None:
    reader = ShmReader(name, "counts", counted_states())
    while True:
        reader.wait(60.0)


def flags(segment: Segment) -> list[int]:
    start_ = segment.starts["counts"] + 64
    return list(segment.memory[start_ : start_ + MAX_SLEEPERS])


def test_a_reader_that_is_stopped_or_killed_asleep_holds_nobody_up(folder: Path) -> None:
    states = counted_states()
    segment = Segment.create("sleepers", {"counts": states.layout})
    writer = ShmWriter(segment, "counts", states)
    with running(lambda: sleep_on("sleepers")) as stopped:
        until(lambda: flags(segment)[0])
        os.kill(stopped, signal.SIGSTOP)
        os.waitpid(stopped, os.WUNTRACED)
        with running(lambda: sleep_on("sleepers")):
            until(lambda: flags(segment)[1])
        assert flags(segment)[:3] == [1, 1, 0]  # both say so still: one is stopped, one dead
        there = counted_states()
        reader = ShmReader("sleepers", "counts", there)
        for number in range(1, 3001):
            states.words = number
            writer.publish()
            if number % 100 == 0:
                assert reader.wait(0.0)
                assert reader.take()
                assert is_whole(there, reader)
        # The dead one's place is free again, and costs no more wake-ups; that of the other is not.
        assert flags(segment)[:3] == [1, 0, 0]
        assert not reader.wait(0.0)
        assert reader._place == 1
        reader.close()
    segment.close()
    assert not list(folder.iterdir())


def test_a_reader_wakes_up_when_something_is_published(folder: Path) -> None:
    with running(lambda: write_counts("wakes", pause=0.01)):
        until(lambda: list(segments()))
        states = counted_states()
        reader = ShmReader("wakes", "counts", states)
        for _ in range(20):
            assert reader.wait(60.0)
            assert reader.take()
            assert is_whole(states, reader)
        reader.close()


def test_so_many_readers_may_sleep_and_the_next_is_told(folder: Path) -> None:
    states = counted_states()
    segment = Segment.create("crowd", {"counts": states.layout})
    readers = [ShmReader("crowd", "counts", states) for _ in range(MAX_SLEEPERS + 1)]
    for reader in readers[:-1]:
        assert not reader.wait(0.0)
    with pytest.raises(StateError, match="segment 'crowd': 64 readers wait for it; poll it"):
        readers[-1].wait(0.0)
    readers[7].close()
    assert not readers[-1].wait(0.0)
    assert readers[-1]._place == 7
    for reader in readers:
        reader.close()
    segment.close()


def test_the_lock_is_the_writers_and_not_its_childrens(folder: Path) -> None:
    def forks() -> None:
        states = counted_states()
        segment = Segment.create("forks", {"counts": states.layout})
        writer = ShmWriter(segment, "counts", states)

        def child() -> None:
            segment.close()  # must neither unlock nor remove what its parent writes
            (folder / "child").write_text(str(os.getpid()))
            time.sleep(600)

        if os.fork() == 0:  # it outlives its parent
            child()
        while True:
            writer.publish()
            time.sleep(0.001)

    child = 0
    try:
        with running(forks):
            until(lambda: (folder / "child").exists() and (folder / "child").read_text())
            child = int((folder / "child").read_text())
            states = counted_states()
            reader = ShmReader("forks", "counts", states)
            assert reader.alive()
            until(reader.take)
        os.kill(child, 0)  # the child lives still
        assert not reader.alive()
        Segment.create("forks", {"counts": states.layout}).close()
        reader.close()
    finally:
        if child:
            os.kill(child, signal.SIGKILL)


def test_a_watcher_leaves_no_trace(folder: Path) -> None:
    states, there = counted_states(), counted_states()
    segment = Segment.create("watched", {"counts": states.layout})
    writer = ShmWriter(segment, "counts", states)
    states.words = 1
    writer.publish()
    before, locks = bytes(segment.memory), locks_of(segment.inode)
    watcher = ShmWatcher("watched", "counts", there)
    assert watcher._segment.memory.readonly
    with pytest.raises(TypeError, match="read-only"):
        watcher._latest[0] = 0
    for _ in range(100):
        watcher.take()
        assert watcher.alive()
    assert is_whole(there, watcher)
    assert bytes(segment.memory) == before
    assert locks_of(segment.inode) == locks == 1
    segment.close()
    assert not watcher.alive()
    watcher.close()
    assert not watcher.alive()


def locks_of(inode: int) -> int:
    """Return how many locks there are on a file, of whatever process."""
    lines = Path("/proc/locks").read_text().splitlines()
    return sum(line.split()[5].endswith(f":{inode}") for line in lines)
