"""Prediction of arrivals, on times that are made up."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from unicon_core.runtime import arrivals
from unicon_core.runtime.arrivals import Arrivals, awaited

MS = 1_000_000


def locked(interval: int, jitter_ns: float, steps: int, seed: int = 0, ticks: int = 200) -> float:
    """Return the median error in [ns] of the predictions of the last half of the ticks."""
    noise = np.random.default_rng(seed)

    def arrival(number: int) -> int:
        return number * interval + round(abs(noise.normal(0.0, jitter_ns)))

    predicted = Arrivals([arrival(i) for i in range(10)])
    errors = []
    for number in range(10, 10 + ticks * steps, steps):
        came = arrival(number)
        errors.append(abs(predicted.nearest(number * interval) - came))
        predicted.note(came)
    return float(np.median(errors[ticks // 2 :]))


@given(
    interval=st.integers(MS // 2, 50 * MS),
    jitter=st.floats(0.0, 0.04),
    steps=st.integers(1, 12),
    seed=st.integers(0, 2**32 - 1),
)
def test_predictions_err_by_no_more_than_the_sender(
    interval: int, jitter: float, steps: int, seed: int
) -> None:
    assert locked(interval, jitter * interval, steps, seed) <= 1.5 * jitter * interval + 2000


def test_a_drifting_clock_is_followed() -> None:
    interval = 2 * MS * 1.0002  # 200 ppm beside what the first arrivals told
    predicted = Arrivals([i * 2 * MS for i in range(10)])
    last = 18 * MS
    errors = []
    for number in range(1, 2000):
        came = round(last + number * 10 * interval)
        errors.append(abs(predicted.nearest(came) - came))
        predicted.note(came)
    assert max(errors[100:]) < 20_000


def test_a_late_message_does_not_move_the_phase_but_a_new_phase_is_found() -> None:
    predicted = Arrivals([i * 2 * MS for i in range(10)])
    for number in range(20, 420, 10):
        predicted.note(number * 2 * MS)
    predicted.note(420 * 2 * MS + 700_000)
    assert predicted.nearest(430 * 2 * MS) == pytest.approx(430 * 2 * MS, abs=20_000)
    shift = 900_000
    for number in range(430, 470, 10):
        predicted.note(number * 2 * MS + shift)
    due = 470 * 2 * MS + shift
    assert predicted.nearest(due) == pytest.approx(due, abs=20_000)


def test_lost_messages_at_the_start_do_not_change_the_interval() -> None:
    predicted = Arrivals([i * 2 * MS for i in (0, 1, 2, 4, 5, 6, 8, 9)])
    assert predicted.interval_ns == 2 * MS


@pytest.mark.parametrize("late", [0, 1, 9])
def test_an_arrival_that_was_late_at_the_start_does_not_keep_the_loop_from_locking(
    late: int,
) -> None:
    """A mean over the first ten was off by 2.4 %: a quarter of an interval at each tick."""
    times = [i * 2 * MS + (500_000 if i == late else 0) for i in range(10)]
    predicted = Arrivals(times)
    assert predicted.interval_ns == pytest.approx(2 * MS, rel=1e-3)
    errors = []
    for number in range(19, 1019, 10):
        errors.append(abs(predicted.nearest(number * 2 * MS) - number * 2 * MS))
        predicted.note(number * 2 * MS)
    assert max(errors[5:]) < 20_000
    assert not predicted.lost


def test_predictions_that_are_chance_are_lost_and_found_by_measuring_anew() -> None:
    predicted = Arrivals([i * 2 * MS for i in range(10)])
    noise = np.random.default_rng(1)
    for number in range(19, 2019, 10):
        predicted.note(number * 2 * MS + round(noise.uniform(-MS, MS)))
    assert predicted.lost
    predicted.measure([(3000 + i) * 2 * MS + 300_000 for i in range(6)])
    assert not predicted.lost
    due = 3100 * 2 * MS + 300_000
    assert predicted.nearest(due) == pytest.approx(due, abs=1000)


def test_few_late_arrivals_do_not_delay_what_is_expected() -> None:
    predicted = Arrivals([i * 2 * MS for i in range(10)])
    for number in range(19, 1019, 10):
        predicted.note(number * 2 * MS + (300_000 if number % 40 == 9 else 0))
    assert predicted.nearest(1019 * 2 * MS) == pytest.approx(1019 * 2 * MS, abs=60_000)


def test_the_lead_has_bounds() -> None:
    predicted = Arrivals([i * 2 * MS for i in range(10)])
    predicted.jitter_ns = 0.0
    assert predicted.lead_ns() == 150_000
    predicted.jitter_ns = 100_000.0
    assert predicted.lead_ns() == 400_000
    predicted.jitter_ns = 1e9
    assert predicted.lead_ns() == MS


class Source:
    """Data that come at a time; waiting and asking take time of a clock that is made up."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, come_ns: int) -> None:
        self.now, self.come_ns = 0, come_ns
        self.asleep: list[int] = []
        self.looks = 0
        clock = SimpleNamespace(perf_counter_ns=lambda: self.now)
        monkeypatch.setattr(arrivals, "time", clock)

    def wait(self, timeout: float) -> bool:
        slept = round(timeout * 1e9)
        self.now += 1000
        self.looks += not slept
        if slept:
            self.asleep.append(slept)
            self.now = max(self.now, min(self.now + slept, self.come_ns))
        return self.now >= self.come_ns


@pytest.mark.parametrize(
    ("come", "found", "asleep", "looks"),
    [
        (1_000_000, True, [800_000], 199),
        (1_150_000, True, [800_000], 349),
        (500_000, True, [800_000], 0),  # much too early
        (1_500_000, False, [800_000], 399),  # late
        (1 << 60, False, [800_000], 399),  # never
    ],
)
def test_data_are_asked_for_without_a_pause_around_their_time_only(
    monkeypatch: pytest.MonkeyPatch, come: int, found: bool, asleep: list[int], looks: int
) -> None:
    source = Source(monkeypatch, come)
    assert awaited(source.wait, 1_000_000, 200_000) is found
    assert source.asleep == asleep
    assert source.looks == pytest.approx(looks, abs=1)
    assert source.now <= 1_202_000


def test_who_is_late_asks_at_once_or_not_at_all(monkeypatch: pytest.MonkeyPatch) -> None:
    source = Source(monkeypatch, 1 << 60)
    source.now = 1_170_000
    assert not awaited(source.wait, 1_000_000, 200_000)
    assert (source.asleep, source.looks) == ([], 30)
    source.now = 5_000_000
    assert not awaited(source.wait, 1_000_000, 200_000)
    assert source.looks == 30
