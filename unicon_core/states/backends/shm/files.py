"""The files of segments: their names, who lives, and what dead writers have left."""

from __future__ import annotations

import errno
import fcntl
import os
import re
import stat
import struct
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from unicon_base.errors import StateError

FOLDER = Path("/dev/shm")
MAGIC = b"UNICONSH"

HEAD = struct.Struct("<8sIIqQQQ64s")
"""magic, version, byte order, writer's pid, its start in clock ticks, size of the segment, length
of the JSON behind the header, its SHA-256 in hexadecimal."""

WRITER_LOCK, REMOVER_LOCK, SLEEPER_LOCKS = 0, 1, 1 << 32
"""Bytes of the file that are locked: by the writer, by who removes what a dead one has left, and
from there on by readers that sleep."""

NAME = re.compile(r"[A-Za-z0-9_.-]{1,100}")
_TRIES = 1000


def segment_path(name: str) -> Path:
    """Return the file of a segment.

    Raises:
        StateError: the name does not do for a file.
    """
    if not NAME.fullmatch(name):
        raise StateError(
            f"a segment cannot be named {name!r}; use letters, digits, '_', '.' and '-'"
        )
    return FOLDER / f"unicon-{os.getuid()}-{name}"


def lock(fd: int, kind: int, start: int, *, ask: bool = False) -> bool:
    """Lock one byte, or ask whether it could be locked; False where another process has it."""
    wish = struct.pack("hhqqi4x", kind, os.SEEK_SET, start, 1, 0)
    try:
        answer = fcntl.fcntl(fd, fcntl.F_OFD_GETLK if ask else fcntl.F_OFD_SETLK, wish)
    except OSError as error:
        if error.errno in (errno.EAGAIN, errno.EACCES):
            return False
        raise
    return not ask or struct.unpack_from("h", answer)[0] == fcntl.F_UNLCK


def started(pid: int) -> int:
    """Return when a process started, in clock ticks since boot (proc(5), field 22); 0: it is not
    there."""
    try:
        told = Path(f"/proc/{pid}/stat").read_bytes()
    except OSError:
        return 0
    return int(told[told.rindex(b")") :].split()[20])


def open_file(path: Path, flags: int) -> int:
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


def unname(path: Path, inode: int) -> None:
    """Remove a file where it is still the one meant."""
    with suppress(OSError):
        if os.stat(path, follow_symlinks=False).st_ino == inode:
            os.unlink(path)


def give_name(fd: int, name: str) -> None:
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
        fd = open_file(path, os.O_RDWR)
    except FileNotFoundError:
        return True
    except OSError as error:
        what = f"cannot take over {path}: {error.strerror}; remove it"
        raise StateError(f"store shm: {what}") from error
    try:
        # Asked, not taken: another reader must not think just now that the writer lives.
        if not lock(fd, fcntl.F_RDLCK, WRITER_LOCK, ask=True):
            return False
        if not lock(fd, fcntl.F_WRLCK, REMOVER_LOCK):
            return False
        if os.pread(fd, len(MAGIC), 0) != MAGIC:
            raise StateError(f"store shm: {path} is not a segment of unicon; remove it")
        unname(path, os.fstat(fd).st_ino)
        return True
    finally:
        os.close(fd)


def _living_writer(path: Path) -> int:
    """Return who writes a segment; 0 where that process cannot be seen."""
    with suppress(OSError, struct.error), path.open("rb") as file:
        _, _, _, pid, start, *_ = HEAD.unpack(file.read(HEAD.size))
        return int(pid) if start and started(pid) == start else 0
    return 0


@dataclass(frozen=True)
class SegmentFile:
    """A segment's file in the folder.

    Attributes:
        name: of the segment.
        size: in bytes.
        alive: its writer lives.
    """

    name: str
    size: int
    alive: bool


def segments() -> Iterator[SegmentFile]:
    """Yield this user's segments, by name; what is not a file of ours is not one."""
    prefix = f"unicon-{os.getuid()}-"
    for path in sorted(FOLDER.glob(prefix + "*")):
        name = path.name[len(prefix) :]
        if not NAME.fullmatch(name):
            continue
        with suppress(OSError, StateError):
            fd = open_file(path, os.O_RDONLY)
            try:
                alive = not lock(fd, fcntl.F_RDLCK, WRITER_LOCK, ask=True)
                yield SegmentFile(name, os.fstat(fd).st_size, alive)
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
