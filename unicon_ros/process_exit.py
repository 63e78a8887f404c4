"""How processes end: with the one that started them, within a time, and what they said last.

What --end-with does is SIGTERM, which damps, when the process that started the node ends. Launch
leaves its processes running where it is killed or gets SIGTERM. The kernel tells a child of its
parent's end, so nothing has to be asked while the node runs; where another process stands in
between (a launch prefix such as `xterm -e`), a thread waits for the end of the one further up.
"""

from __future__ import annotations

import ctypes
import itertools
import os
import select
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from unicon_base import UniconError

PARENT, NOBODY = "parent", "nobody"
SET_PARENT_DEATH_SIGNAL = 1  # PR_SET_PDEATHSIG of linux/prctl.h
PROC = Path("/proc")


def exit_with_parent(whom: str | None) -> None:
    """Let this process get SIGTERM when another one ends, by whatever signal.

    Args:
        whom: process id of our parent or of one further up, `parent`, or `nobody`; None is our
            parent where that is `ros2 launch`, else nobody.

    Raises:
        UniconError: it is something else, that process has ended, or the system cannot tell.
    """
    parent = os.getppid()
    if whom is None:
        whom = PARENT if is_launch(parent) else NOBODY
    if whom == NOBODY:
        return
    if whom != PARENT and not whom.isdecimal():
        raise UniconError(
            f"--end-with {whom}: give the id of the process that started this, {PARENT} or {NOBODY}"
        )
    number = parent if whom == PARENT else int(whom)
    if number == parent:
        _told_by_the_kernel()
    elif number in _further_up(parent):
        _watched(number)
    if os.getppid() != parent or number not in (parent, *_further_up(parent)):
        raise UniconError(
            f"--end-with {whom}: that process has ended, or is not the one that started this "
            f"({parent}); nothing was started"
        )


_IMPORTED_IN = os.getpid()


def die_with_parent(parent: int = 0) -> None:
    """End with the thread that starts this process; for `preexec_fn`, on Linux.

    Args:
        parent: its process, where it is known; 0: the one that imported this, unless it is gone and
            process 1 stands in. In a container our own may be process 1.
    """
    ctypes.CDLL(None).prctl(SET_PARENT_DEATH_SIGNAL, signal.SIGKILL, 0, 0, 0)
    now = os.getppid()
    died_before = now != parent if parent else now == 1 and _IMPORTED_IN != 1
    if died_before:
        os._exit(1)


def is_launch(process: int) -> bool:
    """Tell whether a process is `ros2 launch`, by its command line."""
    try:
        words = (PROC / str(process) / "cmdline").read_text("utf-8", "replace").split("\0")
    except OSError:  # not Linux, or it has ended
        return False
    # python3 /opt/ros/jazzy/bin/ros2 launch …, whatever options Python has
    return any(
        os.path.basename(word) == "ros2" and following == "launch"
        for word, following in itertools.pairwise(words[:9])
    )


def _told_by_the_kernel() -> None:
    try:
        status = ctypes.CDLL(None).prctl(SET_PARENT_DEATH_SIGNAL, signal.SIGTERM)
    except AttributeError:  # not Linux
        status = -1
    if status != 0:
        raise UniconError("--end-with: this system has no prctl(PR_SET_PDEATHSIG); leave it out")


def _further_up(process: int) -> list[int]:
    """Return the ancestors of a process, but for the first process of all."""
    found: list[int] = []
    while len(found) < 64:
        try:
            # PID (NAME) STATE PPID …, where the name may hold spaces and brackets
            process = int((PROC / str(process) / "stat").read_text().rpartition(")")[2].split()[1])
        except (OSError, ValueError, IndexError):
            break
        if process <= 1:
            break
        found.append(process)
    return found


def _watched(process: int) -> None:
    """Send SIGTERM to ourselves when a process ends that is not our parent."""
    try:
        handle = os.pidfd_open(process)
    except (AttributeError, OSError) as error:
        raise UniconError(
            f"--end-with {process}: that process is not the parent of this one, and this system "
            "cannot watch others (pidfd_open); start the node without a prefix"
        ) from error

    def watch() -> None:
        select.select([handle], [], [])
        os.kill(os.getpid(), signal.SIGTERM)

    threading.Thread(target=watch, name="end with", daemon=True).start()


PATIENCE = 5.0
"""How long the middleware may take to go, [s]; it takes 0.1 to 0.5 on a busy machine."""

_SIGEV_THREAD = 2  # asm-generic/siginfo.h
_CLOCK_MONOTONIC = 1


class _Event(ctypes.Structure):
    """struct sigevent of Linux with 64 bits, sigevent(7)."""

    _fields_ = (
        ("value", ctypes.c_void_p),
        ("signo", ctypes.c_int),
        ("notify", ctypes.c_int),
        ("function", ctypes.c_void_p),
        ("attributes", ctypes.c_void_p),
        ("padding", ctypes.c_char * 32),
    )


class _Times(ctypes.Structure):
    """struct itimerspec."""

    _fields_ = (("interval", ctypes.c_long * 2), ("value", ctypes.c_long * 2))


@contextmanager
def exit_watchdog(status: int, seconds: float = PATIENCE) -> Iterator[None]:
    """End the process with this status where what is done inside takes longer.

    Fast DDS 2.14 sometimes spins for ever in `DomainParticipant::set_listener` when a node is
    destroyed while another one is discovered (eProsima/Fast-DDS#6513), and rclpy holds Python's
    lock meanwhile: no thread of Python and no handler of a signal could end that. So the kernel's
    timer calls `_exit`. Where there is none, as on other systems, nothing is done.
    """
    timer = ctypes.c_void_p()
    libc = ctypes.CDLL(None)
    armed = False
    with suppress(AttributeError):  # not Linux, or glibc before 2.34
        leave = ctypes.cast(libc._exit, ctypes.c_void_p)
        event = _Event(value=status, notify=_SIGEV_THREAD, function=leave)
        if libc.timer_create(_CLOCK_MONOTONIC, ctypes.byref(event), ctypes.byref(timer)) == 0:
            times = _Times(value=(int(seconds), int(seconds % 1.0 * 1e9)))
            armed = libc.timer_settime(timer, 0, ctypes.byref(times), None) == 0
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError, AttributeError):
            stream.flush()
    try:
        yield
    finally:
        if armed:
            libc.timer_delete(timer)


LAST_WORDS = 4096
"""Bytes of a log that are looked at for a reason."""
LOG_BYTES = 10_000_000
"""Of a log that is kept: an engine that warns in every step must not fill the disk."""


def last_log_line(path: Path) -> str:
    """Return the last line of a log, in words if there is none."""
    try:
        with path.open("rb") as log:
            log.seek(max(0, os.fstat(log.fileno()).st_size - LAST_WORDS))
            lines = log.read().decode("utf-8", "replace").split("\n")
    except OSError:
        lines = []
    said = [line.strip() for line in lines if line.strip()]
    return said[-1][:300] if said else "it printed nothing"
