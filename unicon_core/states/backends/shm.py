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

A process that forks keeps its segments for itself: the child lets go of what the parent writes, so
that the lock tells of the parent alone. It must neither publish nor read with what its parent made.
"""

from __future__ import annotations

import errno
import fcntl
import mmap
import os
import re
import stat
import struct
import time
import weakref
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from unicon_core.errors import StateError, alternatives
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

__all__ = ["FOLDER", "Found", "Segment", "ShmReader", "ShmWatcher", "ShmWriter", "clean"]
__all__ += ["places", "remove_dead", "segment_path", "segments"]

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
_NAME = re.compile(r"[A-Za-z0-9_.-]{1,100}")
_SLICE = 0.01
"""Longest sleep in [s]: x86 may look for sleepers before others see the new number, though a system
call of the sleeper lies between the two; whatever happened, the value is seen a slice later."""


def segment_path(name: str) -> Path:
    """Return the file of a segment.

    Raises:
        StateError: the name does not do for a file.
    """
    if not _NAME.fullmatch(name):
        raise StateError(
            f"a segment cannot be named {name!r}; use letters, digits, '_', '.' and '-'"
        )
    return FOLDER / f"unicon-{os.getuid()}-{name}"


def places(groups: Groups, json_length: int) -> tuple[dict[str, int], int]:
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
        told = Path(f"/proc/{pid}/stat").read_bytes()
    except OSError:
        return 0
    return int(told[told.rindex(b")") :].split()[20])


def _open(path: Path, flags: int) -> int:
    """Open what should be a segment, and never wait for it: anything may stand there.

    Raises:
        OSError: it cannot be opened.
        StateError: it is not a file of this user.
    """
    fd = os.open(path, flags | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    status = os.fstat(fd)
    if not stat.S_ISREG(status.st_mode):
        what = "is not a file"
    elif status.st_uid != os.getuid():
        what = f"belongs to user {status.st_uid}"
    else:
        return fd
    os.close(fd)
    raise StateError(f"store shm: {path} {what}; remove it")


@dataclass(eq=False)
class Segment:
    """One mapped segment.

    Attributes:
        name: of the segment.
        groups: their layouts.
        starts: where each begins in `memory`, [B].
        hash: SHA-256 of the groups.
        pid: of the process that made it; as that sees it, where it lives in another container.
        inode: of its file; another one of the same name is another segment.
        memory: all of it; writable unless it was attached to for reading only.
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
        starts, size = places(groups, len(text))
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
            memory = _mapped(fd, size)
            digest = groups_hash(groups)
            start = _started(os.getpid())
            head = MAGIC, VERSION, BYTE_ORDER, os.getpid(), start, size, len(text), digest.encode()
            HEAD.pack_into(memory, 0, *head)
            memory[JSON_AT : JSON_AT + len(text)] = text
            _lock(fd, fcntl.F_WRLCK, _WRITER_LOCK)
            inode = os.fstat(fd).st_ino
            try:
                _give_name(fd, name)
            except BaseException:  # a signal may raise just after it has got its name
                _unname(path, inode)
                raise
        except BaseException:
            os.close(fd)
            raise
        made = cls(name, dict(groups), starts, digest, os.getpid(), inode, memory, True, fd)
        _OWNED.add(made)
        return made

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
        try:
            fd = _open(path, os.O_RDONLY if read_only else os.O_RDWR)
        except FileNotFoundError:
            there = alternatives(name, (found.name for found in segments()))
            raise StateError(f"no segment {name!r} in {FOLDER}; {there}") from None
        except OSError as error:
            what = f"cannot read {path}: {error.strerror}; remove it"
            raise StateError(f"store shm: {what}") from error
        try:
            status = os.fstat(fd)
            if status.st_size < JSON_AT:
                raise StateError(f"store shm: {path} is not a segment of unicon; remove it")
            access = mmap.ACCESS_READ if read_only else mmap.ACCESS_WRITE
            try:
                memory = memoryview(mmap.mmap(fd, status.st_size, access=access))
            except (OSError, ValueError) as error:  # no memory, or it shrinks just now
                raise StateError(f"store shm: cannot map {path}: {error}") from error
            groups, digest, pid = _read_head(path, memory)
            starts, size = places(groups, len(groups_json(groups)))
            if size != status.st_size:
                raise StateError(f"store shm: {path} is not as long as it says; remove it")
        except BaseException:
            os.close(fd)
            raise
        return cls(name, groups, starts, digest, pid, status.st_ino, memory, False, fd)

    def alive(self) -> bool:
        """Return whether its writer lives; False where it was closed here."""
        if self._fd < 0 or self.owner:
            return self._fd >= 0
        return not _lock(self._fd, fcntl.F_RDLCK, _WRITER_LOCK, ask=True)

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

    def clear_dead(self, flags: memoryview) -> None:
        """Take the places of readers that died asleep back, of which `flags` still tell."""
        for place, flag in enumerate(flags):
            if flag and _lock(self._fd, fcntl.F_WRLCK, _SLEEPER_LOCKS + place):
                flags[place] = 0
                _lock(self._fd, fcntl.F_UNLCK, _SLEEPER_LOCKS + place)

    def unlink(self) -> None:
        """Take its name away: whoever has it keeps it, and nothing is left when they have ended."""
        _unname(segment_path(self.name), self.inode)

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


_OWNED: weakref.WeakSet[Segment] = weakref.WeakSet()


def _let_go_in_child() -> None:
    """Let a forked child forget what its parent writes: closing would unlock and remove it."""
    for segment in list(_OWNED):
        if segment._fd >= 0:
            os.close(segment._fd)
            segment._fd = -1


os.register_at_fork(after_in_child=_let_go_in_child)


def _mapped(fd: int, size: int) -> memoryview:
    """Map a new segment through a description of its own: a mapping keeps the locks of the one
    that it is made with, and a forked child keeps the mapping."""
    mapped = os.open(f"/proc/self/fd/{fd}", os.O_RDWR | os.O_CLOEXEC)
    try:
        return memoryview(mmap.mmap(mapped, size))
    finally:
        os.close(mapped)


def _unname(path: Path, inode: int) -> None:
    """Remove a file where it is still the one meant."""
    with suppress(OSError):
        if os.stat(path, follow_symlinks=False).st_ino == inode:
            os.unlink(path)


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
            pid = _living_writer(path)
            if pid:
                raise StateError(
                    f"store shm: {path} is written by process {pid} just now; end that run, or "
                    "give this one another name (store: {shm: NAME})"
                )
            time.sleep(0.001)  # another process removes it just now
    raise StateError(
        f"store shm: {path} is held by a process that cannot be seen from here; give this run "
        "another name (store: {shm: NAME})"
    )


def remove_dead(name: str) -> bool:
    """Remove a segment if its writer has died; False where it lives. Two may try at once.

    Raises:
        StateError: it is not a segment, or not ours.
    """
    path = segment_path(name)
    try:
        fd = _open(path, os.O_RDWR)
    except FileNotFoundError:
        return True
    except OSError as error:
        what = f"cannot take over {path}: {error.strerror}; remove it"
        raise StateError(f"store shm: {what}") from error
    try:
        if not _lock(fd, fcntl.F_WRLCK, _WRITER_LOCK):
            return False
        if os.pread(fd, len(MAGIC), 0) != MAGIC:
            raise StateError(f"store shm: {path} is not a segment of unicon; remove it")
        _unname(path, os.fstat(fd).st_ino)
        return True
    finally:
        os.close(fd)


def _living_writer(path: Path) -> int:
    """Return who writes a segment; 0 where that process cannot be seen."""
    with suppress(OSError, struct.error), path.open("rb") as file:
        _, _, _, pid, start, *_ = HEAD.unpack(file.read(HEAD.size))
        return int(pid) if start and _started(pid) == start else 0
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
            if groups_hash(groups).encode() == digest and groups_json(groups) == text:
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
        self._segment, self._number, self._in_vain = segment, 0, 0
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
        if fence is not None:
            fence()  # the number is there before the flags are read; see docs/states.md
        if self._sleepers.tobytes() != self._nobody and self._wake() == 0:
            self._in_vain += 1  # a call to the kernel, 1 µs, for a reader that was killed asleep
            if self._in_vain % _TRIES == 0:
                self._segment.clear_dead(self._sleepers)

    def close(self) -> None:
        """Close the segment, with all its groups."""
        self._segment.close()


_Pairs = tuple[tuple[memoryview, memoryview], ...]
_NOTHING: tuple[memoryview, _Pairs] = (memoryview(b""), ())


class ShmWatcher:
    """Takes the newest value of one group of another process, and leaves no trace in the segment:
    for looking in. It cannot sleep until there is a value; `ShmReader` can.

    It follows: where the writer has died and a new one has taken the name, `alive` attaches to
    the new segment. Numbers begin anew there.

    Args:
        name: of the segment.
        group: name of the group.
        states: into which values are copied; must have the group's states.
        layout: what the group must be; None for whatever it is.

    Attributes:
        number: see `Reader`; so are `stamp_ns` and `skipped`.
        starved: times at which a thousand looks met no whole value; the next `take` goes on.

    Raises:
        StateError: no such segment or group, or its states are others than here.
    """

    _read_only = True

    def __init__(self, name: str, group: str, states: States, layout: Layout | None = None) -> None:
        self._wanted = layout
        self._name, self._group, self._states = name, group, states
        self.number = self.stamp_ns = self.skipped = self.starved = 0
        self._fill = self._taken = _NOTHING
        self._fence = barrier()
        segment = Segment.attach(name, read_only=self._read_only)
        try:
            self._attach(segment)
        except BaseException:
            segment.close()
            raise

    def _attach(self, segment: Segment) -> None:
        if self._group not in segment.groups:
            raise StateError(
                f"segment {self._name!r} has no group {self._group!r}; there are "
                f"{', '.join(segment.groups)}"
            )
        layout = segment.groups[self._group]
        what = difference(self._wanted or layout, layout)
        if what:
            raise StateError(f"segment {self._name!r}, group {self._group!r}: {what}")
        start, nbytes, memory = segment.starts[self._group], layout.nbytes, segment.memory
        if self._taken is _NOTHING:  # a new writer's first value may be awaited: it stays
            # Two: what is copied while it is overwritten must not stand in for what was taken last.
            self._fill, self._taken = self._packed(layout), self._packed(layout)
        self._wanted, self._segment = layout, segment
        self._latest = memory[start : start + 8].cast("Q")
        slots = []
        for place in range(SLOTS):
            at = start + RING + place * (BYTES + nbytes)
            slots.append((memory[at : at + 16].cast("Q"), memory[at + BYTES : at + BYTES + nbytes]))
        self._slots = tuple(slots)
        self._seen = 0

    def _packed(self, layout: Layout) -> tuple[memoryview, _Pairs]:
        """Return memory for a value, and the pieces by which it goes into the states."""
        memory = memoryview(bytearray(layout.nbytes))
        copies = Copies(self._states, layout, memory)
        copies.pack()  # so that `restore` leaves the states as they are until one is taken
        return memory, copies.pairs

    def take(self) -> bool:
        """Copy the newest value into the states; False where it has been taken before."""
        latest, fence = self._latest, self._fence
        memory, pairs = self._fill
        for _ in range(_TRIES):
            number = latest[0]
            if number == self._seen:
                return False
            head, slot = self._slots[number % SLOTS]
            if head[0] != number:
                continue
            if fence is not None:
                fence()
            memory[:] = slot
            stamp = head[1]
            if fence is not None:
                fence()
            if head[0] == number:
                for packed, state in pairs:
                    state[:] = packed
                self._fill, self._taken = self._taken, self._fill
                if self._seen:
                    self.skipped += number - self._seen - 1
                self._seen = self.number = number
                self.stamp_ns = stamp
                return True
        self.starved += 1
        return False

    def restore(self) -> None:
        """Copy the value that was taken last into the states once more."""
        for packed, state in self._taken[1]:
            state[:] = packed

    @property
    def pid(self) -> int:
        """Process of the writer."""
        return self._segment.pid

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
            segment = Segment.attach(self._name, read_only=self._read_only)
        except StateError:
            return False  # it has gone again, or is somebody else's
        old = self._segment
        try:
            self._attach(segment)
        except BaseException:
            segment.close()
            raise
        old.close()
        return segment.alive()

    def unlink(self) -> None:
        """Take the segment's name away, as `Segment.unlink`."""
        self._segment.unlink()

    def close(self) -> None:
        """Let go."""
        self._segment.close()


class ShmReader(ShmWatcher):
    """A watcher that can sleep until there is a value: it says so in the segment, in a place that
    it holds among those that sleep.

    Raises:
        StateError: as `ShmWatcher`.
    """

    _read_only = False

    def _attach(self, segment: Segment) -> None:
        super()._attach(segment)
        start, memory = segment.starts[self._group], segment.memory
        self._flags = memory[start + SLEEPERS : start + SLEEPERS + MAX_SLEEPERS]
        self._sleep, self._place = Sleep(memory, start).wait, -1

    def wait(self, timeout: float) -> bool:
        """Return True when a value is there that has not been taken, False after `timeout` [s].

        Raises:
            StateError: more readers sleep than there are places.
        """
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

    def close(self) -> None:
        """Let go."""
        if self._place >= 0:
            self._flags[self._place] = 0
            self._place = -1
        super().close()


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
    """Yield this user's segments, by name; what is not a file of ours is not one."""
    prefix = f"unicon-{os.getuid()}-"
    for path in sorted(FOLDER.glob(prefix + "*")):
        name = path.name[len(prefix) :]
        if not _NAME.fullmatch(name):
            continue
        with suppress(OSError, StateError):
            fd = _open(path, os.O_RDONLY)
            try:
                alive = not _lock(fd, fcntl.F_RDLCK, _WRITER_LOCK, ask=True)
                yield Found(name, os.fstat(fd).st_size, alive)
            finally:
                os.close(fd)


def clean() -> list[str]:
    """Remove the segments whose writer has died; return their names."""
    removed = []
    for found in segments():
        with suppress(StateError):  # it is not a segment, whatever its name says
            if not found.alive and remove_dead(found.name):
                removed.append(found.name)
    return removed
