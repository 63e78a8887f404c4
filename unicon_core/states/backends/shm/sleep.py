"""Sleeping until another process has stored a number, and waking who sleeps: Linux's futex.

A futex is a word in shared memory: the kernel puts a caller to sleep only while the word still has
the value that the caller saw, so that no wake is lost between looking and sleeping. Nothing has to
be passed between the processes, and any number of them may wait (futex(2)).
"""

from __future__ import annotations

import ctypes
import errno
import platform
import time
from collections.abc import Callable
from ctypes.util import find_library

from unicon_base.errors import PlatformError

_CALLS = {"x86_64": 202, "aarch64": 98, "riscv64": 98}  # numbers of futex(2)
_ORDERED = {"x86_64", "AMD64"}  # stores are seen in program order: total store order
_WAIT, _WAKE = 0, 1
_EVERYBODY = 0x7FFFFFFF


class _Timespec(ctypes.Structure):
    _fields_ = (("seconds", ctypes.c_long), ("nanoseconds", ctypes.c_long))


class Sleep:
    """Sleeps on, and wakes sleepers of, one 64-bit counter in shared memory.

    Args:
        memory: writable, shared; what it is cut from.
        offset: of the counter in it, [B].

    Raises:
        PlatformError: this machine's processor is not known.
    """

    def __init__(self, memory: memoryview, offset: int) -> None:
        call = _CALLS.get(platform.machine())
        if call is None:
            raise PlatformError(
                f"store shm: waiting is not known for {platform.machine()} processors; use zmq"
            )
        # The low half of the counter, little-endian as all these processors are.
        self._word = ctypes.c_uint32.from_buffer(memory, offset)
        libc = ctypes.CDLL(None, use_errno=True)
        self._syscall = libc.syscall
        address = ctypes.c_void_p(ctypes.addressof(self._word))
        self._time = _Timespec()
        self._wait_args = (ctypes.c_long(call), address, ctypes.c_int(_WAIT))
        self._until = ctypes.byref(self._time)
        nothing = ctypes.c_void_p(None)
        self._wake_args = (
            *self._wait_args[:2],
            ctypes.c_int(_WAKE),
            ctypes.c_int(_EVERYBODY),
            nothing,
        )

    def wake(self) -> int:
        """Wake everybody who sleeps on the counter; return how many did."""
        return int(self._syscall(*self._wake_args))

    def wait(self, seen: int, timeout: float) -> None:
        """Sleep while the counter has the value `seen`, at most `timeout` [s].

        It may return early: look again. Signals of Python are handled on return.
        """
        self._time.seconds = seconds = int(timeout)
        self._time.nanoseconds = int((timeout - seconds) * 1e9)
        low = ctypes.c_uint32(seen & 0xFFFFFFFF)
        if self._syscall(*self._wait_args, low, self._until) == -1:
            code = ctypes.get_errno()
            if code not in (errno.EAGAIN, errno.EINTR, errno.ETIMEDOUT):
                time.sleep(min(timeout, 0.0005))  # no futex here: look often instead


def barrier() -> Callable[[], object] | None:
    """Return what keeps loads and stores before it from those behind it; None where nothing must.

    x86 needs none (Intel SDM 3A, 9.2.3: stores are not reordered with stores, loads not with
    loads). Elsewhere, on aarch64 first of all, it is the sequentially consistent fence of C11.

    Raises:
        PlatformError: it is needed and libatomic is not there.
    """
    if platform.machine() in _ORDERED:
        return None
    try:
        thread_fence = ctypes.CDLL(find_library("atomic") or "libatomic.so.1").atomic_thread_fence
    except (OSError, AttributeError):
        raise PlatformError(
            f"store shm: {platform.machine()} processors need a fence of libatomic, which is not "
            "installed; sudo apt install libatomic1"
        ) from None
    order = ctypes.c_int(5)  # memory_order_seq_cst
    return lambda: thread_fence(order)
