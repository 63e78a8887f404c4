"""What passes as fresh: by epoch, number and times alone, without a clock or a socket."""

from __future__ import annotations

import pytest

from unicon_core.states.backends.zmq_socket import SETTLE, SILENCE, Freshness

MS = 1_000_000
PERIOD = 10 * MS
AHEAD = 5_000_000_000_000  # of the sender's clock before ours, [ns]
WAY = 1 * MS  # of the fastest value


class Line:
    """Values of one writer, every 10 ms, with a way of 1 ms."""

    def __init__(self, judge: Freshness, epoch: int = 1, ahead: int = AHEAD) -> None:
        self.judge, self.epoch, self.ahead = judge, epoch, ahead

    def send(self, number: int, delay: int = 0, *, now: int | None = None) -> bool:
        sent = number * PERIOD
        arrival = sent + WAY + delay if now is None else now
        return self.judge.passes(self.epoch, number, sent + self.ahead, arrival)

    def settle(self, first: int = 1) -> int:
        """Let it pass; return the next number."""
        number = first
        while not self.send(number):
            number += 1
            assert number - first < 10
        return number + 1


def test_a_new_writer_is_watched_before_its_values_pass():
    judge = Freshness(0.2)
    number = Line(judge).settle()
    assert (number - 2) * PERIOD == SETTLE * 1e9
    assert (judge.skipped, judge.lost, judge.late) == (0, 0, 0)
    assert Line(judge).send(number)


@pytest.mark.parametrize("ahead", [-AHEAD, 0, AHEAD])
def test_what_comes_late_does_not_pass_whatever_the_clocks_say(ahead):
    judge = Freshness(0.2)
    line = Line(judge, ahead=ahead)
    number = line.settle()
    assert line.send(number, 199 * MS)
    assert judge.delay == pytest.approx(199 * MS, abs=MS)
    assert not line.send(number + 50, 202 * MS)
    assert judge.late == 1
    assert line.send(number + 100)
    assert judge.delay == 0


def test_what_a_cut_link_has_kept_does_not_pass():
    judge = Freshness(0.2)
    line = Line(judge)
    number = line.settle()
    cut = (number + 100) * PERIOD + WAY  # one second
    passed = [line.send(number + i, now=cut + i * 1000) for i in range(101)]
    assert passed == [False] * 80 + [True] * 21  # those of the last 0.2 s
    assert judge.late == 80


def test_what_a_link_has_kept_does_not_pass_at_the_first_sight_of_a_writer():
    judge = Freshness(0.2)
    line = Line(judge)
    now = 100 * PERIOD + WAY
    assert not any(line.send(1 + i, now=now + i * 1000) for i in range(100))
    passed = line.settle(101) - 1
    assert judge.delay < MS
    assert (passed - 100) * PERIOD >= SETTLE * 1e9


def test_numbers_do_not_go_back_and_none_comes_twice():
    judge = Freshness(0.2)
    line = Line(judge)
    number = line.settle()
    assert line.send(number + 2)
    assert not line.send(number + 1, 20 * MS)
    assert not line.send(number + 2)
    assert judge.reordered == 2
    assert judge.skipped == 2


def test_missing_values_are_lost_where_they_were_looked_for_in_vain():
    judge = Freshness(0.2)
    line = Line(judge)
    number = line.settle()
    line.send(number)
    last = number * PERIOD
    judge.nothing(last + 1000 * MS)
    assert line.send(number + 101)  # 1.01 s after the last: those due 0.2 s before the look
    assert judge.lost == pytest.approx(80, abs=2)
    assert judge.lost + judge.skipped == 100
    assert line.send(number + 111)  # nobody has looked
    assert judge.lost == pytest.approx(80, abs=2)


def test_one_writer_is_followed_while_it_lives():
    judge = Freshness(0.2)
    one, two = Line(judge), Line(judge, epoch=2, ahead=0)
    number = one.settle()
    for i in range(100):
        assert one.send(number + i)
        assert not two.send(number + i)
    assert judge.rivals > 90
    # The first falls silent; the second has been watched all the time.
    dead = number + 100
    passed = [two.send(dead + i) for i in range(100)]
    assert passed.index(True) == pytest.approx(SILENCE * 1e9 / PERIOD, abs=2)
    # Now the first is the rival, and what it sent long ago is late even when all are silent.
    assert not one.send(dead + 100)
    assert not one.send(dead + 101, 5_000 * MS)
    assert judge.late == 1


def test_a_third_writer_does_not_push_out_the_second():
    judge = Freshness(0.2)
    lines = [Line(judge, epoch=epoch) for epoch in (1, 2, 3)]
    passed = {1: 0, 2: 0, 3: 0}
    for number in range(1, 50):
        for line in lines:
            passed[line.epoch] += line.send(number)
    assert passed[1] > 40
    assert passed[2] == passed[3] == 0


def test_a_drift_of_the_clocks_makes_nothing_late():
    judge = Freshness(0.2)
    line = Line(judge)
    number = line.settle()
    for i in range(100_000):  # a thousand seconds at 500 ppm
        assert line.send(number + i, now=(number + i) * PERIOD + WAY + i * PERIOD // 2000)
    assert judge.delay < MS


def test_stamps_that_go_back_do_not_pass():
    judge = Freshness(0.2)
    line = Line(judge)
    number = line.settle()
    assert not judge.passes(1, number + 1, AHEAD, number * PERIOD + WAY)
    assert judge.reordered == 1
