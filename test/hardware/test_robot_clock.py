"""The robot's own clock, and frames that come again."""

from __future__ import annotations

import random
from collections.abc import Iterable

import pytest

from unicon_base.errors import Fault
from unicon_hardware.endpoint import Milliseconds
from unicon_hardware.robot_clock import Repeats, RobotClock

SECOND = 1_000_000_000


class Link:
    """Frames of a robot whose clock runs, taken at 50 Hz.

    Args:
        rate: of the robot's clock, of ours.
    """

    def __init__(self, rate: float = 1.0) -> None:
        self.clock, self.now, self.rate = RobotClock("platform 'it'"), 5 * SECOND, rate
        self.count = 2**32 - 700  # it wraps soon

    def tick(self, late: float = 0.0, pause: float = 0.02) -> int:
        """Take a frame that is late by so much; return how old it is said to be, [ns]."""
        self.now += round(pause * SECOND)
        self.count += pause * 1e3 * self.rate
        return self.now - self.clock(self.now, round(self.count - late * 1e3) % 2**32)

    def settled(self) -> Link:
        """Let the clock be believed."""
        for _ in range(60):
            self.tick()
        assert self.clock.believed
        return self


def ages(link: Link, late: Iterable[float]) -> None:
    for each in late:
        link.tick(each)


def test_frames_that_get_older_are_a_fault_and_stamps_say_how_old_they_are() -> None:
    link = Link().settled()
    assert link.tick(0.05) == pytest.approx(0.05 * SECOND, rel=0.05)
    since = iter(range(100))
    with pytest.raises(Fault, match=r"is 0\.1\d s older than it was, by its own clock"):
        ages(link, (0.3 * 0.02 * k for k in since))
    assert 0.30 <= 0.02 * next(since) <= 0.45


def test_jitter_loss_drift_and_pauses_are_none() -> None:
    rng = random.Random(1)
    for rate in (0.999, 1.0, 1.001, 0.985):
        link = Link(rate).settled()
        for _ in range(3000):
            link.tick(rng.uniform(0.0, 0.02), 0.04 if rng.random() < 0.01 else 0.02)
    link = Link().settled()
    link.count -= 2000  # it stood still for 2 s, and said nothing
    link.now -= 2 * SECOND
    for k in range(100):
        link.now += 2 * SECOND * (k == 0)
        link.tick(pause=2.0 if k == 0 else 0.02)
    link.tick(0.5)  # one frame is late
    link.tick()


@pytest.mark.parametrize("rate", [0.0, 0.5])
def test_a_clock_that_counts_something_else_is_not_believed(rate: float) -> None:
    link = Link(rate)
    ages = [link.tick() for _ in range(1000)]
    assert not link.clock.believed
    assert set(ages) == {0}


def test_a_clock_from_the_beginning_behind_is_believed_once_it_keeps_step() -> None:
    link = Link(0.5)
    for _ in range(100):
        link.tick()
    link.rate = 1.0
    for _ in range(30):
        link.tick()
    assert link.clock.believed


def frames(seed: int, count: int = 500) -> list[bytes]:
    rng = random.Random(seed)
    return [rng.randbytes(40) for _ in range(count)]


def test_measurements_that_come_again_are_a_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0]
    monkeypatch.setattr("unicon_hardware.robot_clock.time.monotonic_ns", lambda: now[0])
    look, past = Repeats("platform 'it'", slice(4, 36)), frames(0)
    rng = random.Random(2)
    for frame in past:
        if rng.random() > 0.01:  # some are lost, the first time and the second
            look(frame)

    def again() -> None:
        for k, frame in enumerate(past):
            now[0] += 2_000_000
            count = k.to_bytes(4, "little")
            if rng.random() > 0.01:
                look(count + frame[4:36] + count)

    with pytest.raises(
        Fault, match=r"repeat: for 0\.2 s they have been those of 49\d frames before"
    ):
        again()
    assert now[0] < 0.25 * SECOND


def test_what_stands_still_or_comes_twice_is_none() -> None:
    look = Repeats("platform 'it'", slice(0, 40))
    still = bytes(40)
    for frame in frames(1, 3000):
        for each in (frame, still, frame, frame):  # one that was doubled on its way
            look(each)
    for _ in range(3000):
        look(still)
    assert len(look._seen) <= Repeats.KEPT + 1


def test_an_emulated_clock_goes_on_where_frames_are_left_out() -> None:
    clock = Milliseconds(2.0)
    assert [clock(float("nan")) for _ in range(3)] == [2, 4, 6]
    assert [clock(10.0), clock(10.0), clock(10.1), clock(10.5)] == [7, 8, 106, 506]
