"""Jobs side by side: all are done at each call, errors are those of the first, threads end."""

from __future__ import annotations

import gc
import threading
import time

import pytest

from unicon_core.platforms.mujoco.batch import SideBySide


def alive(name):
    return [thread for thread in threading.enumerate() if thread.name.startswith(name)]


def test_each_job_has_its_thread_and_the_callers_the_first():
    seen: list[tuple[int, str]] = []
    jobs = [lambda k=k: seen.append((k, threading.current_thread().name)) for k in range(3)]
    both = SideBySide(jobs, "abreast")
    for _ in range(5):
        seen.clear()
        both()
        names = [threading.current_thread().name, "abreast 1", "abreast 2"]
        assert sorted(seen) == list(enumerate(names))
    both.close()
    assert alive("abreast") == []


def test_they_run_at_the_same_time():
    meet = threading.Barrier(3, timeout=20.0)
    both = SideBySide([meet.wait] * 3, "meeting")
    both()  # one after the other nobody would come through
    both.close()


def failing(text, after=0.0):
    def job() -> None:
        time.sleep(after)
        raise ValueError(text)

    return job


@pytest.mark.parametrize("order", [(0.05, 0.0, 0.0), (0.0, 0.05, 0.0), (0.0, 0.0, 0.05)])
def test_of_several_errors_the_first_jobs_is_raised_once_all_have_ended(order):
    done: list[int] = []

    def slow() -> None:
        time.sleep(0.1)
        done.append(1)

    jobs = [failing(f"job {k}", after) for k, after in enumerate(order)]
    both = SideBySide([*jobs, slow], "failing")
    for count in (1, 2):
        with pytest.raises(ValueError, match="job 0"):
            both()
        assert len(done) == count
    both.close()
    one = SideBySide([slow, *jobs[1:]], "failing")
    with pytest.raises(ValueError, match="job 1"):
        one()
    one.close()


def test_once_closed_the_jobs_are_done_in_turn_and_no_thread_is_born():
    seen: list[str] = []
    both = SideBySide([lambda: seen.append(threading.current_thread().name)] * 3, "closed")
    both.close()
    both.close()
    both()
    assert seen == [threading.current_thread().name] * 3
    assert alive("closed") == []


def test_what_an_interrupted_call_left_is_not_taken_for_the_next_ones():
    hold = threading.Event()
    done = []

    def waits() -> None:
        assert hold.wait(20.0)
        done.append(1)

    interrupts = [KeyboardInterrupt, None]

    def first() -> None:
        raised = interrupts.pop(0)
        if raised is not None:
            threading.Timer(0.05, hold.set).start()
            raise raised

    both = SideBySide([first, waits], "interrupted")
    with pytest.raises(KeyboardInterrupt):
        both()
    assert done == [1]
    both()
    assert done == [1, 1]
    both.close()


def test_threads_end_with_whom_nobody_closed():
    both = SideBySide([int, int], "forgotten")
    both()
    threads = alive("forgotten")
    assert len(threads) == 1
    del both
    gc.collect()
    for thread in threads:
        thread.join(20.0)
    assert alive("forgotten") == []


def test_with_one_job_there_is_no_thread():
    before = threading.active_count()
    seen: list[int] = []
    alone = SideBySide([lambda: seen.append(1)], "alone")
    alone()
    assert seen == [1]
    assert threading.active_count() == before
    alone.close()
