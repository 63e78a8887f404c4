"""Pacing: options, what the system refuses, and deadlines that do not drift."""

from __future__ import annotations

import ctypes
import gc
import math
import os
import platform
import struct
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from unicon_base.errors import UniconError
from unicon_base.schema.read import read_value
from unicon_core import pacing
from unicon_core.runtime import Pacing, Runner, RunOptions, WallClock, prepare_process
from unicon_core.runtime.ticker import Ticker
from unicon_core.workflow import load_workflow

linux = pytest.mark.skipif(sys.platform != "linux", reason="scheduling of Linux")


class Libc:
    """Stands in for the C library; `mlockall` answers as told."""

    def __init__(self, answer: int) -> None:
        self.calls: list[tuple[str, Any]] = []
        self._answer = answer

    def prctl(self, option: int, value: Any, *rest: int) -> int:
        self.calls.append(("slack", value.value))
        return 0

    def mlockall(self, flags: int) -> int:
        self.calls.append(("lock", flags))
        return self._answer

    def munlockall(self) -> int:
        self.calls.append(("unlock", None))
        return 0


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (
            {"spin": 1},
            "pacing: unknown key 'spin'; did you mean 'spin_us'? known: arrival_spin_us, cpu, "
            "dry_run_us, every, hang, lock_memory, overrun, priority, spin_us, trigger",
        ),
        ({"trigger": "timer"}, "pacing.trigger 'timer' is not known; known: deadline, state"),
        ({"overrun": "drop"}, "pacing.overrun 'drop' is not known; known: catch_up, skip"),
        ({"spin_us": -1}, "pacing.spin_us is -1; write a number from 0 [µs]"),
        (
            {"arrival_spin_us": -1},
            "pacing.arrival_spin_us is -1; write a number from 0 [µs], or null",
        ),
        ({"spin_us": math.nan}, "pacing.spin_us is nan; write a number from 0 [µs]"),
        ({"dry_run_us": math.inf}, "pacing.dry_run_us is inf; write a number from 0 [µs]"),
        ({"dry_run_us": "long"}, "pacing.dry_run_us is 'long'; write a number from 0 [µs]"),
        ({"priority": 0}, "pacing.priority is 0; write a whole number from 1 to 99, or null"),
        ({"priority": "hi"}, "pacing.priority is 'hi'; write a whole number from 1 to 99 or null"),
        ({"cpu": -1}, "pacing.cpu is -1; write a whole number from 0 to 65536, or null"),
        ({"lock_memory": 1}, "pacing.lock_memory is 1; write true or false"),
    ],
)
def test_wrong_options_get_a_clear_line(values: dict[str, Any], message: str) -> None:
    with pytest.raises(UniconError) as caught:
        read_value(Pacing, values, lambda where, text: UniconError(text), "pacing")
    assert str(caught.value) == message


@linux
def test_what_the_system_refuses_is_told_and_the_run_goes_on(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def refuse(*arguments: Any) -> None:
        raise PermissionError(1, "Operation not permitted")

    def no_core(*arguments: Any) -> None:
        raise OSError(22, "Invalid argument")

    libc = Libc(answer=-1)
    monkeypatch.setattr(ctypes, "CDLL", lambda *a, **k: libc)
    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    monkeypatch.setattr(os, "sched_setaffinity", no_core)
    monkeypatch.setattr(os, "cpu_count", lambda: 4)
    told: list[str] = []
    restore = prepare_process(Pacing(priority=80, cpu=9, lock_memory=True), told.append)
    restore()
    assert told == [
        "pacing: memory not locked; raise the limit: ulimit -l unlimited",
        "pacing: priority 80 refused ([Errno 1] Operation not permitted); allow it with "
        "'<user> - rtprio 99' in /etc/security/limits.conf",
        "pacing: core 9 refused ([Errno 22] Invalid argument); known: 0 to 3",
    ]
    assert libc.calls == [("slack", 1), ("lock", 3), ("slack", 0)]


@linux
def test_what_was_set_is_undone_in_reverse_order(monkeypatch: pytest.MonkeyPatch) -> None:
    libc = Libc(answer=0)
    calls = libc.calls
    monkeypatch.setattr(ctypes, "CDLL", lambda *a, **k: libc)
    monkeypatch.setattr(
        os, "sched_setscheduler", lambda pid, kind, param: calls.append(("kind", kind))
    )
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: {0, 1})
    monkeypatch.setattr(os, "sched_setaffinity", lambda pid, cores: calls.append(("on", cores)))
    told: list[str] = []
    restore = prepare_process(Pacing(priority=50, cpu=1, lock_memory=True), told.append)
    assert gc.get_freeze_count() > 0
    restore()
    assert gc.get_freeze_count() == 0
    assert told == []
    assert calls == [
        ("slack", 1), ("lock", 3), ("kind", os.SCHED_FIFO), ("on", {1}),
        ("on", {0, 1}), ("kind", os.SCHED_OTHER), ("unlock", None), ("slack", 0),
    ]  # fmt: skip


@linux
def test_the_timer_slack_is_the_kernels_own_after_a_run() -> None:
    libc = ctypes.CDLL(None)
    before = libc.prctl(30, 0, 0, 0, 0)  # PR_GET_TIMERSLACK
    restore = prepare_process(Pacing(), print)
    assert libc.prctl(30, 0, 0, 0, 0) == 1
    restore()
    assert libc.prctl(30, 0, 0, 0, 0) == before


@linux
def test_the_time_slice_is_the_kernels_own_after_a_run() -> None:
    """`sched_getattr` tells it as `sched_runtime` where threads can ask for one (Linux 6.12)."""
    number = {"x86_64": 315, "aarch64": 275}.get(platform.machine())
    if number is None:
        pytest.skip("the number of the system call is not known here")
    libc = ctypes.CDLL(None)

    def asked() -> int:
        raw = ctypes.create_string_buffer(48)
        assert libc.syscall(number, 0, raw, 48, 0) == 0
        return int(struct.unpack_from("=Q", raw, 24)[0])

    before = asked()
    if not before:
        pytest.skip("this kernel knows no time slices of threads")
    restore = prepare_process(Pacing(), print)
    assert asked() == 100_000 < before
    restore()
    assert asked() == before


def test_the_clock_never_returns_before_the_deadline() -> None:
    import time

    clock = WallClock(50_000)
    for ahead in (-1_000_000, 0, 20_000, 300_000, 2_000_000):
        due = time.perf_counter_ns() + ahead
        assert clock.until(due) >= due


def test_a_long_sleep_wakes_once_before_its_end(monkeypatch: pytest.MonkeyPatch) -> None:
    """A core that was idle for long wakes late; one that was idle for 300 µs does not."""
    present, slept = 0, list[int]()

    def sleep(seconds: float) -> None:
        nonlocal present
        slept.append(round(seconds * 1e9))
        present += slept[-1]

    def now() -> int:
        nonlocal present
        present += 100
        return present

    monkeypatch.setattr(pacing.time, "sleep", sleep)
    monkeypatch.setattr(pacing.time, "perf_counter_ns", now)
    clock = WallClock(100_000)
    clock.until(2_000_000)
    assert len(slept) == 2
    assert slept[1] == pytest.approx(pacing.FIRST_WAKE_NS, abs=1000)
    slept.clear()
    clock.until(present + 500_000)
    assert len(slept) == 1


WORKFLOW = """\
robot: go2
platform: fake
rate: 500
flow: {sway: {gains: {"*_hip_joint": [1.0, 0, 0]}}}
"""


def drift_in_periods(folder: Path, seconds: float) -> float:
    """How much later the last ticks begin than the first ones, beside the grid of deadlines."""
    path = folder / "drift.yaml"
    path.write_text(WORKFLOW, encoding="utf-8")
    ticks = round(seconds * 500)  # where the machine makes some late, others are left out
    runner = Runner(load_workflow(path), RunOptions(duration=seconds, capacity=ticks))
    assert runner.run().ticks == ticks
    starts = runner.statistics.kept()[:, 2]
    # The deadlines are a grid of whole periods from the first on, and the ticks keep to it.
    deadlines = runner.statistics.kept()[:, 0]
    assert ((deadlines - deadlines[0]) % runner.period_ns == 0).all()
    late = starts - deadlines
    # Of 100 ticks each the median: one may be late for the machine, drift makes them all so.
    return float(np.median(late[-100:]) - np.median(late[:100])) / runner.period_ns


@pytest.mark.alone
def test_a_run_of_a_second_drifts_less_than_a_period(tmp_path: Path) -> None:
    assert abs(drift_in_periods(tmp_path, 1.0)) < 1.0


@pytest.mark.alone
@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_run_of_ten_minutes_drifts_less_than_a_period(tmp_path: Path) -> None:
    assert abs(drift_in_periods(tmp_path, 600.0)) < 1.0


@pytest.mark.alone
@pytest.mark.parametrize("late", [0.4, 2.4])
def test_a_first_tick_that_is_late_leaves_the_deadlines_behind_it_where_they_were(
    tmp_path: Path, late: float
) -> None:
    path = tmp_path / "hold.yaml"
    path.write_text("robot: go2\nplatform: fake\nrate: 50\nflow: hold\n")
    program = load_workflow(path)
    ticker = Ticker(program, program.root, 16, None)
    ticker.first_ns = first = time.perf_counter_ns() - round(late * ticker.period_ns)
    ticker.run(3)
    program.close()
    due = ticker.statistics.kept()[:, 0] - first
    assert not np.any(due % ticker.period_ns)
    assert due[0] >= int(late) * ticker.period_ns
    assert ticker.statistics.overruns >= int(late)
