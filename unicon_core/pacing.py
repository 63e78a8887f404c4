"""Pacing: when the next tick starts, for the runner; absolute deadlines, so that nothing drifts.

A sleep ends late by the kernel's timer slack (50 µs unless told) and the scheduler's mood; with a
slack of 1 ns, two sleeps and a spin over the last 100 µs the deadline error stays near 1 µs, at
6.5 % of a core for 500 Hz.
"""

from __future__ import annotations

import ctypes
import gc
import os
import platform
import struct
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from unicon_base import TextSink
from unicon_base.schema.marks import Core, Unit, Within

_PR_SET_TIMERSLACK = 29  # linux/prctl.h
_SCHED_SETATTR = {"x86_64": 314, "aarch64": 274}  # asm/unistd.h


SHORTEST_HANG, LONGEST_HANG = 0.01, 60.0
"""Bounds of `hang` in [s]; the upper one is for a debugger."""


@dataclass(frozen=True)
class Pacing:
    """How a run keeps time.

    Attributes:
        trigger: `deadline`, ticks at fixed times; `state`, ticks when the platform's data arrive.
        every: with `state`, tick with each n-th arrival; None: with the one nearest to a deadline.
        overrun: `skip` lets missed ticks go and keeps the grid; `catch_up` runs up to
            `CATCH_UP` of them at once, on simulators only.
        hang: a tick that comes or ends later than this after its deadline is a fault, in [s];
            None: `HANG` or five periods, whichever is longer.
        spin_us: busy wait before the deadline in [µs].
        arrival_spin_us: with `state`, how long before and after the expected arrival to ask for
            data without a pause in [µs], at most half the time between two; 0 for never, None:
            `ARRIVAL_SPIN_US` for periods of `SPUN_PERIOD_NS` and longer.
        dry_run_us: how long before the deadline the blocks warm up at most in [µs]; 0 for never.
        priority: SCHED_FIFO priority 1…99, or None: what helps where others want the cores.
        cpu: core to stay on, or None; without a priority it waits whenever that core is busy.
        lock_memory: lock all memory.
    """

    trigger: Literal["deadline", "state"] = "deadline"
    every: Annotated[int | None, Within(1, 10_000)] = None
    overrun: Literal["skip", "catch_up"] = "skip"
    hang: Annotated[float | None, Within(SHORTEST_HANG, LONGEST_HANG, "s")] = None
    spin_us: Annotated[float, Unit("µs"), Within(0.0)] = 100.0
    arrival_spin_us: Annotated[float | None, Unit("µs"), Within(0.0)] = None
    dry_run_us: Annotated[float, Unit("µs"), Within(0.0)] = 1000.0
    priority: Annotated[int | None, Within(1, 99)] = None
    cpu: Core | None = None
    lock_memory: bool = False

    def hang_ns(self, period_ns: int, simulated: bool) -> int:
        """Return how late a tick may be before it counts as hung, in [ns]."""
        if self.hang is not None:
            return round(self.hang * 1e9)
        return max(round(HANG[simulated] * 1e9), 5 * period_ns)

    def arrival_spin_ns(self, period_ns: int) -> int:
        """Return how long before and after an expected arrival to stay awake, in [ns]."""
        if self.arrival_spin_us is not None:
            return round(self.arrival_spin_us * 1e3)
        return round(ARRIVAL_SPIN_US * 1e3) if period_ns >= SPUN_PERIOD_NS else 0


ARRIVAL_SPIN_US = 200.0
"""Awake so long before and after the expected arrival unless told (see `awaited`)."""

SPUN_PERIOD_NS = 16_000_000
"""Shortest period of ticks for which that costs at most 2.5 % of a core."""

CATCH_UP = 10
"""Most ticks that `catch_up` runs at once; what is missed beyond them is let go."""

HANG = {False: 0.25, True: 1.0}
"""How late a tick may be in [s], by whether the platform is a simulator: a robot whose command is
older than a quarter of a second no longer does what the policy thinks."""

REAL_TIME = "'<user> - rtprio 99' in /etc/security/limits.conf"
"""What gives a user the right to real-time priorities, from the next login on: limits.conf(5)."""


FIRST_WAKE_NS = 300_000
"""How long before its end a long sleep is interrupted, in [ns]."""


class WallClock:
    """Sleeps until absolute times of `time.perf_counter_ns`.

    A long sleep wakes `FIRST_WAKE_NS` early and sleeps once more: a core that was idle for
    milliseconds wakes up to 300 µs late in a virtual machine, one that was idle for 300 µs does not
    (p99 of the deadline error at 500 Hz 35 to 190 µs with one sleep, 1 to 30 µs with two).

    Args:
        spin_ns: busy wait before the deadline in [ns].
    """

    def __init__(self, spin_ns: int = 100_000) -> None:
        self.spin_ns = spin_ns

    def until(self, deadline_ns: int) -> int:
        """Return at the deadline with the present time in [ns]; at once if it has passed."""
        now = time.perf_counter_ns
        remaining = deadline_ns - now() - self.spin_ns
        if remaining > 2 * FIRST_WAKE_NS:
            time.sleep((remaining - FIRST_WAKE_NS) * 1e-9)
            remaining = deadline_ns - now() - self.spin_ns
        if remaining > 0:
            time.sleep(remaining * 1e-9)
        while (present := now()) < deadline_ns:
            pass
        return present


class WarmUp:
    """Waits for deadlines and warms the tick up before each of them.

    Once as early as it takes to bring everything into the caches, then again two to five times up
    to the deadline, for what comes back cold from the waiting in between. Policy tick at 50 Hz on a
    busy machine, p50: without it 250 µs, one warm-up 1 ms early 84, one as late as it goes 44, an
    early and a late one 30, an early and two late ones 25 (in a loop without waiting 17). Elsewhere
    two late ones 32 µs, five 29.5, eight 28.6: more than two where they are short beside a period.

    Args:
        warm_up: what is run; nothing observable may change by it.
        clock: waits.
        longest_ns: the first begins at most so long before the deadline in [ns]; 0 for never.

    Attributes:
        lead_ns: how long before the deadline the next one begins in [ns].
    """

    def __init__(self, warm_up: Callable[[], object], clock: WallClock, longest_ns: int) -> None:
        self._warm_up, self._clock, self._longest = warm_up, clock, longest_ns
        self._cold = self._warm = longest_ns // 8
        self._last = 0
        self.lead_ns = longest_ns

    def until(self, deadline_ns: int) -> int:
        """Return at the deadline with the present time in [ns]; at once if it has passed."""
        now, clock, warm_up = time.perf_counter_ns, self._clock, self._warm_up
        remaining = deadline_ns - self.lead_ns - now()
        if self._longest and remaining > 0:
            time.sleep(remaining * 1e-9)
            begin = now()
            warm_up()
            took = now() - begin
            # The cold one follows rises at once and falls slowly: the next is hardly longer.
            self._cold = took if took > self._cold else self._cold - ((self._cold - took) >> 3)
            warm = min(self._warm, self._cold)
            repeats = max(2, min(MOST_REPEATS, ((deadline_ns - self._last) >> 7) // (warm + 1)))
            latest = deadline_ns - warm - (warm >> 3) - MARGIN_NS
            # Awake until the deadline: of the ticks slower than 80 µs most had slept here once more
            # and been woken too late to warm up again.
            while now() < latest - repeats * warm:
                pass
            for _ in range(repeats + 2):
                begin = now()
                if begin > latest:
                    break
                warm_up()
                warm += (now() - begin - warm) >> 3
            self._warm = warm
            # Half as much again for the cold one, and 50 µs for a late wake.
            self.lead_ns = min((self._cold * 3 >> 1) + (repeats + 2) * warm + 50_000, self._longest)
        self._last = deadline_ns
        return clock.until(deadline_ns)


MARGIN_NS = 2_000
"""Between the end of the last warm-up and the deadline, and an eighth of a warm-up more."""

MOST_REPEATS = 5
"""Most repetitions that are planned before a deadline, two at least: as many as fit into 1/128 of a
period. Where they are quicker than expected, up to two more run."""


def staying(wait: Callable[[float], bool]) -> Callable[[float], bool]:
    """Return a wait in which the thread sleeps on the core where it has warmed up.

    The thread that brings the data wakes ours on its own core, in a virtual machine above all,
    where a core that sleeps counts as taken: half of the ticks moved so, and took 260 µs from
    waking to sending instead of 130 (p50). It may go where it likes again as soon as it is awake,
    and so may threads and processes that it makes.

    Args:
        wait: sleeps for at most a time in [s], returns True once data are there.
    """
    try:
        here = ctypes.CDLL(None).sched_getcpu
        cores_of, put = os.sched_getaffinity, os.sched_setaffinity
    except (OSError, AttributeError):  # no such thing on this system
        return wait

    def stay(timeout: float) -> bool:
        if not timeout:  # a look in passing: it may be one of hundreds
            return wait(timeout)
        anywhere = cores_of(0)  # each time: somebody may have moved the process
        core = here()
        if len(anywhere) < 2 or core not in anywhere:
            return wait(timeout)
        try:
            put(0, {core})
        except OSError:  # the core was taken away a moment ago
            return wait(timeout)
        try:
            return wait(timeout)
        finally:
            with suppress(OSError):
                put(0, anywhere)

    return stay


def prepare_process(pacing: Pacing, warn: TextSink) -> Callable[[], None]:
    """Set timer slack, priority, core and memory as asked; what is refused is told, not fatal.

    Returns:
        A function that undoes it.
    """
    undo: list[Callable[[], object]] = []
    if sys.platform == "linux":
        libc = ctypes.CDLL(None, use_errno=True)
        libc.prctl(_PR_SET_TIMERSLACK, ctypes.c_ulong(1), 0, 0, 0)
        undo.append(lambda: libc.prctl(_PR_SET_TIMERSLACK, ctypes.c_ulong(0), 0, 0, 0))
        if pacing.priority is None and _ask_slice(libc, SLICE_NS):
            undo.append(lambda: _ask_slice(libc, 0))
        if pacing.lock_memory:
            if libc.mlockall(3) != 0:  # MCL_CURRENT | MCL_FUTURE
                warn("pacing: memory not locked; raise the limit: ulimit -l unlimited")
            else:
                undo.append(lambda: libc.munlockall())
    if pacing.priority is not None:
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(pacing.priority))
            undo.append(lambda: os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0)))
        except (OSError, AttributeError) as error:
            warn(f"pacing: priority {pacing.priority} refused ({error}); allow it with {REAL_TIME}")
    if pacing.cpu is not None:
        try:
            before = os.sched_getaffinity(0)
            os.sched_setaffinity(0, {pacing.cpu})
            undo.append(lambda: os.sched_setaffinity(0, before))
        except (OSError, AttributeError) as error:
            last = (os.cpu_count() or 1) - 1
            warn(f"pacing: core {pacing.cpu} refused ({error}); known: 0 to {last}")
    gc.collect()
    gc.freeze()  # a collection of the oldest generation cost 1.6 to 2.5 ms without this
    undo.append(gc.unfreeze)

    def restore() -> None:
        for action in reversed(undo):
            action()

    return restore


SLICE_NS = 100_000
"""Time slice that the tick's thread asks for, the shortest there is. A thread that wakes goes at
once before one with a longer slice (Linux 6.12 and newer), else when that has had its own: ticks at
1 kHz beside a recorder's threads overran 14 times in 12 s so, 25 times without."""


def _ask_slice(libc: ctypes.CDLL, slice_ns: int) -> bool:
    """Ask for a time slice of this thread in [ns], 0 for the usual; False where it is refused.

    `sched_attr.sched_runtime` of a SCHED_OTHER thread (sched_setattr(2)); older kernels ignore it.
    """
    number = _SCHED_SETATTR.get(platform.machine())
    if number is None or os.sched_getscheduler(0) != os.SCHED_OTHER:
        return False
    nice = os.getpriority(os.PRIO_PROCESS, 0)
    # size, policy, flags, nice, priority, runtime, deadline, period: linux/sched/types.h
    attributes = struct.pack("=IIQiIQQQ", 48, os.SCHED_OTHER, 0, nice, 0, slice_ns, 0, 0)
    return bool(libc.syscall(number, 0, attributes, 0) == 0)


def process_age_s() -> float | None:
    """Return how long ago this process was started in [s], to 10 ms; None where nobody tells.

    Field 22 of `/proc/self/stat`, in clock ticks since the boot: proc_pid_stat(5).
    """
    try:
        text = Path("/proc/self/stat").read_text(encoding="ascii", errors="replace")
        started = int(text.rpartition(")")[2].split()[19]) / os.sysconf("SC_CLK_TCK")
        return time.clock_gettime(time.CLOCK_BOOTTIME) - started
    except (OSError, ValueError, AttributeError):
        return None
