"""Segment: one mapped file in shared memory, with the layouts of its groups in its head."""

from __future__ import annotations

import fcntl
import mmap
import os
import struct
import weakref
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from unicon_base.errors import StateError, alternatives
from unicon_core.states.backends.shm import files
from unicon_core.states.backends.shm.files import (
    HEAD,
    MAGIC,
    SLEEPER_LOCKS,
    WRITER_LOCK,
    give_name,
    lock,
    open_file,
    segment_path,
    segments,
    started,
    unname,
)
from unicon_core.states.groups import Groups, groups_from_json, groups_hash, groups_json
from unicon_core.states.layout import Layout

VERSION = 1
BYTE_ORDER = 0x01020304
SLOTS = 4
LINE = 64
"""A cache line; everything begins on one."""
JSON_AT = 128

# Of a group, from its start: the latest number, then a line of one byte for each sleeping reader,
# then the slots. Of a slot: number, stamp in [ns] of CLOCK_MONOTONIC, then the bytes.
LATEST, SLEEPERS, RING = 0, LINE, 2 * LINE
BYTES = LINE
MAX_SLEEPERS = LINE


def places(groups: Groups, json_length: int) -> tuple[dict[str, int], int]:
    """Return where each group begins, and the size of the segment."""
    at, starts = _lines(JSON_AT + json_length), {}
    for name, layout in groups.items():
        starts[name] = at
        at += RING + SLOTS * (BYTES + layout.nbytes)
    return starts, at


def _lines(nbytes: int) -> int:
    return -(-nbytes // LINE) * LINE


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
            fd = os.open(files.FOLDER, flags, 0o600)
        except OSError as error:
            raise StateError(f"store shm: cannot make {path}: {error.strerror}") from error
        try:
            try:
                os.posix_fallocate(fd, 0, size)  # no room is an error now, not a SIGBUS later
            except OSError as error:
                what = f"{size} bytes for {path}: {error.strerror}"
                raise StateError(f"store shm: {what}; make room in {files.FOLDER}") from error
            memory = _mapped(fd, size)
            digest = groups_hash(groups)
            start = started(os.getpid())
            head = MAGIC, VERSION, BYTE_ORDER, os.getpid(), start, size, len(text), digest.encode()
            HEAD.pack_into(memory, 0, *head)
            memory[JSON_AT : JSON_AT + len(text)] = text
            lock(fd, fcntl.F_WRLCK, WRITER_LOCK)
            inode = os.fstat(fd).st_ino
            try:
                give_name(fd, name)
            except BaseException:  # a signal may raise just after it has got its name
                unname(path, inode)
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
            fd = open_file(path, os.O_RDONLY if read_only else os.O_RDWR)
        except FileNotFoundError:
            there = alternatives(name, (found.name for found in segments()))
            raise StateError(f"no segment {name!r} in {files.FOLDER}; {there}") from None
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
        return not lock(self._fd, fcntl.F_RDLCK, WRITER_LOCK, ask=True)

    def replaced(self) -> bool:
        """Return whether another segment has taken the name."""
        try:
            return os.stat(segment_path(self.name)).st_ino != self.inode
        except OSError:
            return False

    def slots(self, group: str) -> list[tuple[memoryview, memoryview]]:
        """Return number and stamp, and the bytes, of each slot of a group."""
        start, nbytes, memory = self.starts[group] + RING, self.groups[group].nbytes, self.memory
        places = [start + place * (BYTES + nbytes) for place in range(SLOTS)]
        return [(memory[at : at + 16].cast("Q"), memory[at + BYTES :][:nbytes]) for at in places]

    def latest(self, group: str) -> tuple[int, int]:
        """Return number and stamp [ns] of a group's newest value; number 0: none yet."""
        start = self.starts[group]
        number = int.from_bytes(self.memory[start + LATEST : start + LATEST + 8], "little")
        return number, self.slots(group)[number % SLOTS][0][1] if number else 0

    def sleeper(self) -> int:
        """Return a place of this process's own among those that sleep.

        Raises:
            StateError: all are taken.
        """
        for place in range(MAX_SLEEPERS):
            if lock(self._fd, fcntl.F_WRLCK, SLEEPER_LOCKS + place):
                return place
        raise StateError(
            f"segment {self.name!r}: {MAX_SLEEPERS} readers wait for it; poll it, or end one"
        )

    def clear_dead(self, flags: memoryview) -> None:
        """Take the places of readers that died asleep back, of which `flags` still tell."""
        for place, flag in enumerate(flags):
            if flag and lock(self._fd, fcntl.F_WRLCK, SLEEPER_LOCKS + place):
                flags[place] = 0
                lock(self._fd, fcntl.F_UNLCK, SLEEPER_LOCKS + place)

    def unlink(self) -> None:
        """Take its name away: processes that have it keep it, and it is gone when they end."""
        unname(segment_path(self.name), self.inode)

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
