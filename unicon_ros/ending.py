"""The end of a process that has used ROS: it comes, whatever the middleware does."""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress

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
def exits_within(status: int, seconds: float = PATIENCE) -> Iterator[None]:
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
