"""Time that passes at once: sleeps of one thread move the clocks, and only while a test says so."""

from __future__ import annotations

import threading
import time

import pytest
from passing import CLOCKS


@pytest.mark.usefixtures("time_passes")
def test_a_sleep_takes_no_time_and_every_clock_goes_on_by_it() -> None:
    before = {name: getattr(time, name)() for name in CLOCKS}
    used = time.process_time()
    time.sleep(1000.0)
    for name, unit in CLOCKS.items():
        assert 1000.0 <= (getattr(time, name)() - before[name]) / unit * 1e-9 < 1100.0
    assert time.process_time() - used < 10.0
    with pytest.raises(ValueError, match="non-negative"):
        time.sleep(-1.0)


@pytest.mark.usefixtures("time_passes")
def test_other_threads_sleep_and_move_no_clock() -> None:
    before, took = time.monotonic(), []

    def sleeps() -> None:
        began = time.monotonic()
        time.sleep(0.05)
        took.append(time.monotonic() - began)

    thread = threading.Thread(target=sleeps)
    thread.start()
    thread.join()
    assert took[0] >= 0.05
    assert time.monotonic() - before < 1000.0


def test_without_it_a_sleep_takes_its_time() -> None:
    before = time.monotonic()
    time.sleep(0.01)
    assert time.monotonic() - before >= 0.01
    assert time.sleep.__name__ == "sleep"
