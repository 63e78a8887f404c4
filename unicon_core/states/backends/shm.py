"""Shared memory: groups of states that other processes of this machine read, each value whole.

    segment = Segment.create("walk", {"measured": group})
    writer = ShmWriter(segment, "measured", states)
    writer.publish()                                    # about a microsecond, nobody can delay it

    reader = ShmReader("walk", "measured", states)      # in another process
    if reader.wait(0.02): reader.take()

A segment is one file, `/dev/shm/unicon-<uid>-<name>`, of mode 0600. Each group is a ring of four
slots: a writer fills the oldest and then makes it the latest, so that a reader has three publishing
periods to copy a value, and sees by the slot's number whether it was overwritten meanwhile. Nobody
waits on a lock, and a writer that is killed at any moment leaves the value before whole. The place
of everything is told in docs/states.md and written as C by `unicon states --header`.

The locks that there are tell who lives, and the kernel lets them go with their process: byte 0 of
the file is locked by the writer, one byte for each reader that sleeps (F_OFD_SETLK in fcntl(2)).
Python's own `multiprocessing.shared_memory` is not used: its tracker removes a segment when a
process that only reads it ends.
"""

from __future__ import annotations

import errno
import fcntl
import mmap
import os
import re
import struct
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from unicon_core.errors import StateError
from unicon_core.states.backends.sleep import Sleep, barrier
from unicon_core.states.groups import (
    Copies,
    Groups,
    difference,
    groups_from_json,
    groups_hash,
    groups_json,
)
from unicon_core.states.layout import Layout
from unicon_core.states.states import States

__all__ = [
    "FOLDER",
    "Segment",
    "ShmReader",
    "ShmWriter",
    "clean",
    "remove_dead",
    "segment_path",
    "segments",
]

FOLDER = Path("/dev/shm")
MAGIC = b"UNICONSH"
VERSION = 1
BYTE_ORDER = 0x01020304
SLOTS = 4
LINE = 64
"""A cache line; everything begins on one."""

HEAD = struct.Struct("<8sIIqQQQ64s")
"""magic, version, byte order, writer's pid, its start in clock ticks, size of the segment, length
of the JSON behind the header, its SHA-256 in hexadecimal."""
JSON_AT = 128

# Of a group, from its start: the latest number, then a line of one byte for each sleeping reader,
# then the slots. Of a slot: number, stamp in [ns] of CLOCK_MONOTONIC, then the bytes.
LATEST, SLEEPERS, RING = 0, LINE, 2 * LINE
NUMBER, STAMP, BYTES = 0, 8, LINE
MAX_SLEEPERS = LINE

_WRITER_LOCK = 0
_SLEEPER_LOCKS = 1 << 32
_TRIES = 1000
_SLICE = 0.01
"""Longest sleep in [s]: x86 may look for sleepers before others see the new number, though a system
call of the sleeper lies between the two; whatever happened, the value is seen a slice later."""


def segment_path(name: str) -> Path:
    """Return the file of a segment.

    Raises:
        StateError: the name does not do for a file.
    """
    if not re.fullmatch(r"[A-Za-z0-9_.-]{1,100}", name):
        raise StateError(
            f"a segment cannot be named {name!r}; use letters, digits, '_', '.' and '-'"
        )
    return FOLDER / f"unicon-{os.getuid()}-{name}"


def _offsets(groups: Groups, json_length: int) -> tuple[dict[str, int], int]:
    """Return where each group begins, and the size of the segment."""
    at, starts = _lines(JSON_AT + json_length), {}
    for name, layout in groups.items():
        starts[name] = at
        at += RING + SLOTS * (BYTES + layout.nbytes)
    return starts, at


def _lines(nbytes: int) -> int:
    return -(-nbytes // LINE) * LINE


def _lock(fd: int, kind: int, start: int, *, ask: bool = False) -> bool:
    """Lock one byte, or ask whether it could be locked; False where another process has it."""
    wish = struct.pack("hhqqi4x", kind, os.SEEK_SET, start, 1, 0)
    try:
        answer = fcntl.fcntl(fd, fcntl.F_OFD_GETLK if ask else fcntl.F_OFD_SETLK, wish)
    except OSError as error:
        if error.errno in (errno.EAGAIN, errno.EACCES):
            return False
        raise
    return not ask or struct.unpack_from("h", answer)[0] == fcntl.F_UNLCK


def _started(pid: int) -> int:
    """Return when a process started, in clock ticks since boot (proc(5), field 22); 0: it is not
    there."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_bytes()
    except OSError:
        return 0
    return int(stat[stat.rindex(b")") :].split()[20])


@dataclass
class Segment:
    """One mapped segment.

    Attributes:
        name: of the segment.
        groups: their layouts.
        starts: where each begins in `memory`, [B].
        hash: SHA-256 of the groups.
        pid: of the process that made it.
        inode: of its file; another one of the same name is another segment.
        memory: all of it; writable.
        owner: this process writes it, and removes it in the end.
    """

    name: str
    groups: dict[str, Layout]
    starts: dict[str, int]
    hash: str
    pid: int
    inode: int
    memory: memoryview
    owner: bool
    _fd: int

    @classmethod
    def create(cls, name: str, groups: Groups) -> Segment:
        """Make a segment; what a writer that died has left is replaced.

        Raises:
            StateError: a writer of that name lives, or there is no room.
        """
        path, text = segment_path(name), groups_json(groups).encode()
        starts, size = _offsets(groups, len(text))
        # Without a name until all of it is there: nobody ever reads half a header.
        flags = os.O_TMPFILE | os.O_RDWR | os.O_CLOEXEC
        try:
            fd = os.open(FOLDER, flags, 0o600)
        except OSError as error:
            raise StateError(f"store shm: cannot make {path}: {error.strerror}") from error
        try:
            try:
                os.posix_fallocate(fd, 0, size)  # no room is an error now, not a SIGBUS later
            except OSError as error:
                raise StateError(
                    f"store shm: {size} bytes for {path}: {error.strerror}; make room in {FOLDER}"
                ) from error
            memory = memoryview(mmap.mmap(fd, size))
            digest = groups_hash(groups)
            start = _started(os.getpid())
            head = MAGIC, VERSION, BYTE_ORDER, os.getpid(), start, size, len(text), digest.encode()
            HEAD.pack_into(memory, 0, *head)
            memory[JSON_AT : JSON_AT + len(text)] = text
            _lock(fd, fcntl.F_WRLCK, _WRITER_LOCK)
            _give_name(fd, name)
            inode = os.fstat(fd).st_ino
        except BaseException:
            os.close(fd)
            raise
        return cls(name, dict(groups), starts, digest, os.getpid(), inode, memory, True, fd)

    @classmethod
    def attach(cls, name: str, *, read_only: bool = False) -> Segment:
        """Map the segment of a name.

        Args:
            name: of the segment.
            read_only: for looking only: a reader that sleeps has to say so in it.

        Raises:
            StateError: there is none, it is somebody else's, or it is not a segment.
        """
        path = segment_path(name)
        flags = os.O_NOFOLLOW | os.O_CLOEXEC | (os.O_RDONLY if read_only else os.O_RDWR)
        try:
            fd = os.open(path, flags)
        except FileNotFoundError:
            there = ", ".join(found.name for found in segments()) or "none"
            raise StateError(f"no segment {name!r} in {FOLDER}; there are: {there}") from None
        except OSError as error:
            raise StateError(f"store shm: cannot read {path}: {error.strerror}") from error
        try:
            status = os.fstat(fd)
            if status.st_uid != os.getuid():
                raise StateError(f"store shm: {path} belongs to user {status.st_uid}; remove it")
            if status.st_size < JSON_AT:
                raise StateError(f"store shm: {path} is not a segment; remove it")
            access = mmap.ACCESS_READ if read_only else mmap.ACCESS_WRITE
            memory = memoryview(mmap.mmap(fd, status.st_size, access=access))
            groups, digest, pid = _read_head(path, memory)
            starts, size = _offsets(groups, len(groups_json(groups)))
            if size != status.st_size:
                raise StateError(f"store shm: {path} is not as long as it says; remove it")
        except BaseException:
            os.close(fd)
            raise
        return cls(name, groups, starts, digest, pid, status.st_ino, memory, False, fd)

    def alive(self) -> bool:
        """Return whether its writer lives."""
        return self.owner or not _lock(self._fd, fcntl.F_RDLCK, _WRITER_LOCK, ask=True)

    def replaced(self) -> bool:
        """Return whether another segment has taken the name."""
        try:
            return os.stat(segment_path(self.name)).st_ino != self.inode
        except OSError:
            return False

    def latest(self, group: str) -> tuple[int, int]:
        """Return number and stamp [ns] of a group's newest value; number 0: none yet."""
        start = self.starts[group]
        number = int.from_bytes(self.memory[start + LATEST : start + LATEST + 8], "little")
        slot = start + RING + number % SLOTS * (BYTES + self.groups[group].nbytes)
        stamp = int.from_bytes(self.memory[slot + STAMP : slot + STAMP + 8], "little")
        return number, stamp if number else 0

    def sleeper(self) -> int:
        """Return a place of this process's own among those that sleep.

        Raises:
            StateError: all are taken.
        """
        for place in range(MAX_SLEEPERS):
            if _lock(self._fd, fcntl.F_WRLCK, _SLEEPER_LOCKS + place):
                return place
        raise StateError(
            f"segment {self.name!r}: {MAX_SLEEPERS} readers wait for it; poll it, or end one"
        )

    def unlink(self) -> None:
        """Take its name away: whoever has it keeps it, and nothing is left when they have ended."""
        if not self.replaced():
            with suppress(OSError):
                os.unlink(segment_path(self.name))

    def close(self) -> None:
        """Let it go; its writer removes it. Safe to call twice."""
        if self._fd < 0:
            return
        if self.owner:
            self.unlink()
        # Python's mmap has a descriptor of its own, which would keep the locks of this one.
        with suppress(OSError):
            wish = struct.pack("hhqqi4x", fcntl.F_UNLCK, os.SEEK_SET, 0, 0, 0)
            fcntl.fcntl(self._fd, fcntl.F_OFD_SETLK, wish)
        os.close(self._fd)
        self._fd = -1


def _give_name(fd: int, name: str) -> None:
    """Give a new segment its name, and take that of a writer that died.

    Raises:
        StateError: a writer that lives has it.
    """
    path = segment_path(name)
    for _ in range(_TRIES):
        # Given a folder, Python follows the link: linkat(2) with AT_SYMLINK_FOLLOW.
        folder = os.open("/proc/self/fd", os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            os.link(str(fd), path, src_dir_fd=folder, follow_symlinks=True)
            return
        except FileExistsError:
            pass
        finally:
            os.close(folder)
        if not remove_dead(name):
            pid = _pid_of(path)
            raise StateError(
                f"store shm: {path} is written by process {pid} just now; end that run, or give "
                "this one another name (store: {shm: NAME})"
            )
    raise StateError(f"store shm: others make {path} all the time; give this run another name")


def remove_dead(name: str) -> bool:
    """Remove a segment if its writer has died; False where it lives. Two may try at once."""
    path = segment_path(name)
    try:
        fd = os.open(path, os.O_RDWR | os.O_NOFOLLOW | os.O_CLOEXEC)
    except FileNotFoundError:
        return True
    except OSError as error:
        raise StateError(f"store shm: cannot take over {path}: {error.strerror}") from error
    try:
        if not _lock(fd, fcntl.F_WRLCK, _WRITER_LOCK):
            return False
        with suppress(FileNotFoundError):
            if os.stat(path).st_ino == os.fstat(fd).st_ino:
                os.unlink(path)
        return True
    finally:
        os.close(fd)


def _pid_of(path: Path) -> int:
    with suppress(OSError, struct.error), path.open("rb") as file:
        return int(HEAD.unpack(file.read(HEAD.size))[3])
    return 0


def _read_head(path: Path, memory: memoryview) -> tuple[dict[str, Layout], str, int]:
    magic, version, order, pid, _, size, length, digest = HEAD.unpack_from(memory, 0)
    what = None
    if magic != MAGIC:
        what = "is not a segment of unicon"
    elif order != BYTE_ORDER:
        what = "has another byte order"
    elif version != VERSION:
        what = f"is of version {version}, and this program reads version {VERSION}"
    elif size != len(memory) or JSON_AT + length > size:
        what = "is not as long as it says"
    if what is None:
        try:
            text = bytes(memory[JSON_AT : JSON_AT + length]).decode()
            groups = groups_from_json(text)
            if groups_hash(groups).encode() == digest:
                return groups, digest.decode(), pid
        except (StateError, UnicodeDecodeError):
            pass
        what = "has a damaged description of its states"
    raise StateError(f"store shm: {path} {what}; end what writes it, or remove it")


class ShmWriter:
    """Publishes one group into a segment that this process made.

    Args:
        segment: as of `Segment.create`.
        group: name of the group.
        states: where its states are read.
    """

    def __init__(self, segment: Segment, group: str, states: States) -> None:
        self._segment, self._number = segment, 0
        start, nbytes = segment.starts[group], segment.groups[group].nbytes
        memory = segment.memory
        self._latest = memory[start : start + 8].cast("Q")
        self._sleepers = memory[start + SLEEPERS : start + SLEEPERS + MAX_SLEEPERS]
        self._nobody = bytes(MAX_SLEEPERS)
        self._wake, self._fence = Sleep(memory, start).wake, barrier()
        slots = []
        for place in range(SLOTS):
            at = start + RING + place * (BYTES + nbytes)
            head = memory[at : at + 16].cast("Q")
            bytes_ = memory[at + BYTES : at + BYTES + nbytes]
            slots.append((head, Copies(states, segment.groups[group], bytes_).pairs))
        self._slots = tuple(slots)

    def publish(self) -> None:
        """Publish the states as they are now."""
        number = self._number + 1
        head, pairs = self._slots[number % SLOTS]
        fence = self._fence
        head[0] = 0  # whoever copies it just now sees that it is going
        if fence is not None:
            fence()
        for packed, state in pairs:
            packed[:] = state
        head[1] = time.monotonic_ns()
        if fence is not None:
            fence()
        head[0] = number
        if fence is not None:
            fence()
        self._latest[0] = self._number = number
        if self._sleepers.tobytes() != self._nobody:
            self._wake()

    def close(self) -> None:
        """Close the segment, with all its groups."""
        self._segment.close()


class ShmReader:
    """Takes the newest value of one group of another process.

    It follows: where the writer has died and a new one has taken the name, `alive` attaches to
    the new segment. Numbers begin anew there.

    Args:
        name: of the segment.
        group: name of the group.
        states: into which values are copied; must have the group's states.
        layout: what the group must be; None for whatever it is.

    Attributes:
        starved: times at which a thousand looks met no whole value; the next `take` goes on.

    Raises:
        StateError: no such segment or group, or its states are others than here.
    """

    def __init__(self, name: str, group: str, states: States, layout: Layout | None = None) -> None:
        self._wanted = layout
        self._name, self._group, self._states = name, group, states
        self.number = self.stamp_ns = self.skipped = self.starved = 0
        self._scratch = memoryview(b"")
        self._attach(Segment.attach(name))

    def _attach(self, segment: Segment) -> None:
        if self._group not in segment.groups:
            segment.close()
            raise StateError(
                f"segment {self._name!r} has no group {self._group!r}; there are "
                f"{', '.join(segment.groups)}"
            )
        layout = segment.groups[self._group]
        what = difference(self._wanted or layout, layout)
        if what:
            segment.close()
            raise StateError(f"segment {self._name!r}, group {self._group!r}: {what}")
        self._wanted = layout
        start, nbytes, memory = segment.starts[self._group], layout.nbytes, segment.memory
        if not self._scratch:  # a new writer's are the same: the last value stands until its first
            self._scratch = memoryview(bytearray(nbytes))
            self._copies = Copies(self._states, layout, self._scratch).pairs
        self._segment = segment
        self._latest = memory[start : start + 8].cast("Q")
        self._flags = memory[start + SLEEPERS : start + SLEEPERS + MAX_SLEEPERS]
        self._sleep, self._place = Sleep(memory, start).wait, -1
        self._fence = barrier()
        slots = []
        for place in range(SLOTS):
            at = start + RING + place * (BYTES + nbytes)
            slots.append((memory[at : at + 16].cast("Q"), memory[at + BYTES : at + BYTES + nbytes]))
        self._slots = tuple(slots)
        self._seen = 0

    def take(self) -> bool:
        """Copy the newest value into the states; False where it has been taken before."""
        latest, fence = self._latest, self._fence
        for _ in range(_TRIES):
            number = latest[0]
            if number == self._seen:
                return False
            head, slot = self._slots[number % SLOTS]
            if head[0] != number:
                continue
            if fence is not None:
                fence()
            self._scratch[:] = slot
            stamp = head[1]
            if fence is not None:
                fence()
            if head[0] == number:
                for packed, state in self._copies:
                    state[:] = packed
                self.skipped += number - self._seen - 1
                self._seen = self.number = number
                self.stamp_ns = stamp
                return True
        self.starved += 1
        return False

    def restore(self) -> None:
        """Copy the value that was taken last into the states once more, if there was one."""
        if self.number:
            for packed, state in self._copies:
                state[:] = packed

    def wait(self, timeout: float) -> bool:
        """Return True when a value is there that has not been taken, False after `timeout` [s]."""
        latest, seen = self._latest, self._seen
        if latest[0] != seen:
            return True
        if self._place < 0:
            self._place = self._segment.sleeper()
        flags, place, sleep = self._flags, self._place, self._sleep
        end = time.monotonic() + timeout
        while latest[0] == seen:
            left = end - time.monotonic()
            if left <= 0.0:
                flags[place] = 0
                return False
            flags[place] = 1
            sleep(seen, min(left, _SLICE))
        flags[place] = 0
        return True

    def alive(self) -> bool:
        """Return whether the writer lives; where it has died, a new one of the name is taken up.

        Raises:
            StateError: the new one has other states.
        """
        if self._segment.alive():
            return True
        if not self._segment.replaced():
            return False
        try:
            segment = Segment.attach(self._name)
        except StateError:
            return False  # it has gone again, or is somebody else's
        old = self._segment
        self._attach(segment)
        old.close()
        return True

    def unlink(self) -> None:
        """Take the segment's name away, as `Segment.unlink`."""
        self._segment.unlink()

    def close(self) -> None:
        """Let go."""
        if self._place >= 0:
            self._flags[self._place] = 0
            self._place = -1
        self._segment.close()


@dataclass(frozen=True)
class Found:
    """A segment's file in the folder.

    Attributes:
        name: of the segment.
        size: in bytes.
        alive: its writer lives.
    """

    name: str
    size: int
    alive: bool


def segments() -> Iterator[Found]:
    """Yield this user's segments, by name."""
    prefix = f"unicon-{os.getuid()}-"
    for path in sorted(FOLDER.glob(prefix + "*")):
        with suppress(OSError):
            fd = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC)
            try:
                alive = not _lock(fd, fcntl.F_RDLCK, _WRITER_LOCK, ask=True)
                yield Found(path.name[len(prefix) :], os.fstat(fd).st_size, alive)
            finally:
                os.close(fd)


def clean() -> list[str]:
    """Remove the segments whose writer has died; return their names."""
    dead = [found.name for found in segments() if not found.alive]
    return [name for name in dead if remove_dead(name)]
