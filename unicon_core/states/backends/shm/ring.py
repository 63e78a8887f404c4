"""The ring of a group: its writer, its readers, and how readers sleep and are woken.

They sleep on a futex, a word in shared memory: the kernel puts a caller to sleep only while the
word still has the value that the caller saw, so that no wake is lost between looking and sleeping.
Any number of processes may wait (futex(2)).
"""

from __future__ import annotations

import ctypes
import errno
import platform
import time
from collections.abc import Callable
from ctypes.util import find_library

from unicon_base.errors import PlatformError, StateError
from unicon_core.states.backends.shm.segment import (
    MAX_SLEEPERS,
    SLEEPERS,
    SLOTS,
    Segment,
)
from unicon_core.states.groups import Copies, difference
from unicon_core.states.layout import Layout
from unicon_core.states.states import States

_CALLS = {"x86_64": 202, "aarch64": 98, "riscv64": 98}  # numbers of futex(2)
_ORDERED = {"x86_64", "AMD64"}  # stores are seen in program order: total store order
_WAIT, _WAKE = 0, 1
_EVERYBODY = 0x7FFFFFFF
_EARLY = {errno.EAGAIN, errno.EINTR, errno.ETIMEDOUT}


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
        self._syscall = ctypes.CDLL(None, use_errno=True).syscall
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
        if (
            self._syscall(*self._wait_args, low, self._until) == -1
            and ctypes.get_errno() not in _EARLY
        ):
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


LOOKS = 1000
"""How often a reader that is overtaken looks before it gives up for this time, and how often a
writer wakes nobody before it looks for readers that were killed asleep."""

SLICE = 0.01
"""Longest sleep in [s]: x86 may look for sleepers before others see the new number, though a system
call of the sleeper lies between the two; whatever happened, the value is seen a slice later."""


class ShmWriter:
    """Publishes one group into a segment that this process made.

    Args:
        segment: as of `Segment.create`.
        group: name of the group.
        states: where its states are read.
    """

    def __init__(self, segment: Segment, group: str, states: States) -> None:
        self._segment, self._number, self._in_vain = segment, 0, 0
        start, memory, layout = segment.starts[group], segment.memory, segment.groups[group]
        self._latest = memory[start : start + 8].cast("Q")
        self._sleepers = memory[start + SLEEPERS : start + SLEEPERS + MAX_SLEEPERS]
        self._nobody = bytes(MAX_SLEEPERS)
        self._wake, self._fence = Sleep(memory, start).wake, barrier()
        self._slots = tuple(
            (head, Copies(states, layout, packed).pairs) for head, packed in segment.slots(group)
        )

    def publish(self) -> None:
        """Publish the states as they are now."""
        number = self._number + 1
        head, pairs = self._slots[number % SLOTS]
        fence = self._fence
        head[0] = 0  # a reader that copies it just now sees that it is going
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
            fence()  # the number is there before the flags are read; see docs/reference/states.md
        if self._sleepers.tobytes() != self._nobody and self._wake() == 0:
            self._in_vain += 1  # a call to the kernel, 1 µs, for a reader that was killed asleep
            if self._in_vain % LOOKS == 0:
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
        start = segment.starts[self._group]
        if self._taken is _NOTHING:  # a new writer's first value may be awaited: it stays
            # Two: what is copied while it is overwritten must not stand in for what was taken last.
            self._fill, self._taken = self._packed(layout), self._packed(layout)
        self._wanted, self._segment = layout, segment
        self._latest = segment.memory[start : start + 8].cast("Q")
        self._slots = tuple(segment.slots(self._group))
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
        for _ in range(LOOKS):
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
            sleep(seen, min(left, SLICE))
        flags[place] = 0
        return True

    def close(self) -> None:
        """Let go."""
        if self._place >= 0:
            self._flags[self._place] = 0
            self._place = -1
        super().close()
