"""Time that passes at once: sleeps of this thread take none, and every clock goes on by them.

For tests of runs that wait for nothing but the time: what runs in between takes what it takes, and
times between two events are those of a run that slept.
"""

from __future__ import annotations

import threading
import time

import pytest

__all__ = ["let_time_pass"]

CLOCKS = {"perf_counter": 1e-9, "monotonic": 1e-9, "perf_counter_ns": 1, "monotonic_ns": 1}
"""Clocks of `time`, and how much 1 ns is of each."""


def let_time_pass(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let sleeps of this thread move the clocks instead of taking time; other threads sleep."""
    passed, sleep, here = 0, time.sleep, threading.get_ident()

    def pass_time(seconds: float) -> None:
        nonlocal passed
        if threading.get_ident() != here:
            sleep(seconds)
            return
        sleep(min(seconds, 0.0))  # lets other threads go on, and refuses less than nothing
        passed += round(seconds * 1e9)

    monkeypatch.setattr(time, "sleep", pass_time)
    for name, unit in CLOCKS.items():
        clock = getattr(time, name)
        monkeypatch.setattr(time, name, lambda clock=clock, unit=unit: clock() + passed * unit)
