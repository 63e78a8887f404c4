"""What `start: {at: …, together: …}` says, and what is refused."""

from __future__ import annotations

from datetime import datetime, timezone
from typing import Any

import pytest

from unicon_base.errors import Fault, UniconError, WorkflowError
from unicon_base.located_yaml import Located
from unicon_core.synchronised_start import rendezvous as module
from unicon_core.synchronised_start.rendezvous import WallClock, moment_of
from unicon_core.workflow.document import WorkflowDocument
from unicon_core.workflow.settings import StartSettings
from unicon_core.workflow.settings import start_of as start_of_document

S = 1_000_000_000
NOON = int(datetime(2026, 11, 22, 12, tzinfo=timezone.utc).timestamp()) * S


@pytest.mark.parametrize(
    "text", ["2026-11-22T12:00:00Z", "2026-11-22 13:00:00+01:00", "2026-11-22T12:00:00.000+00:00"]
)
def test_a_moment_has_the_zone_that_it_says(text: str) -> None:
    assert moment_of(text).next_ns(0) == NOON


def test_a_moment_without_a_zone_is_of_this_machine() -> None:
    assert moment_of("2026-11-22T12:00").at_ns == datetime(2026, 11, 22, 12).timestamp() * S


def test_every_means_the_next_whole_one_that_is_far_enough_ahead() -> None:
    every = moment_of({"every": 10})
    assert every.next_ns(NOON + 1) == NOON + 10 * S
    assert every.next_ns(NOON + 10 * S - 1) == NOON + 20 * S
    every.refuse(NOON)


def test_a_moment_that_has_passed_or_is_too_far_ahead_is_refused_with_the_clock() -> None:
    noon = moment_of("2026-11-22T12:00:00Z")
    noon.refuse(NOON - S)
    with pytest.raises(UniconError, match=r"at 2026-11-22T12:00:00Z has passed 2.0 s ago, by the"):
        noon.refuse(NOON + 2 * S)
    with pytest.raises(UniconError, match=r"is 24.0 h ahead, by the clock .* give a time within 1"):
        noon.refuse(NOON - 86_400 * S)


def test_who_is_late_for_a_moment_faults_or_goes_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    noon = moment_of("2026-11-22T12:00:00Z")
    monkeypatch.setattr(WallClock, "clock", staticmethod(lambda: NOON + S // 4))
    late = WallClock(noon, alone=False)
    assert late.ask(False) == 0
    with pytest.raises(Fault, match=r"late: 2026-11-22T12:00:00Z passed 0.25 s before gates, go"):
        late.ask(True)
    goes = WallClock(noon, alone=True)
    assert goes.ask(True) == NOON + S // 4
    assert goes.late.startswith("it is late")


def test_a_clock_that_is_set_back_while_it_is_waited_is_a_fault(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    clock = WallClock(moment_of("2026-11-22T12:00:00Z"), alone=True)
    monkeypatch.setattr(WallClock, "clock", staticmethod(lambda: NOON - S))
    assert clock.ask(True) == NOON
    far = round((module.FARTHEST + 2) * S)
    monkeypatch.setattr(WallClock, "clock", staticmethod(lambda: NOON - far))
    with pytest.raises(Fault, match="the clock of this machine was set to"):
        clock.ask(True)


def test_a_moment_that_is_missed_while_it_is_waited_for_is_late(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """By a clock that is set ahead, or a process that was stopped: the others have begun."""
    for alone in (False, True):
        clock = WallClock(moment_of("2026-11-22T12:00:00Z"), alone)
        monkeypatch.setattr(WallClock, "clock", staticmethod(lambda: NOON - S))
        assert clock.ask(True) == NOON
        monkeypatch.setattr(WallClock, "clock", staticmethod(lambda: NOON + S // 10))
        assert clock.ask(True) == NOON  # a late tick is still the one
        assert not clock.late
        monkeypatch.setattr(WallClock, "clock", staticmethod(lambda: NOON + 100 * S))
        if alone:
            assert clock.ask(True) == NOON + 100 * S
            assert "passed 100.00 s ago: the clock was set, or this process" in clock.late
        else:
            with pytest.raises(Fault, match=r"not started, it is late: .* passed 100\.00 s ago"):
                clock.ask(True)


def start_of(said: Any) -> StartSettings:
    located = Located("w.yaml", {"start": said}, {(): 1})
    return start_of_document(WorkflowDocument("w", located.value, located))


TWO = {"robots": ["left", "right"], "me": "left"}
OVER = {"robots": {"left": "tcp://a:1", "right": "tcp://b:1"}, "me": "left"}


def test_what_is_said_is_taken() -> None:
    said = start_of({"together": TWO | {"timeout": 3}, "late": "go"})
    assert said.alone
    assert said.together is not None
    assert not said.together.over_zmq
    assert said.together.timeout == 3.0
    assert start_of({"together": OVER}).together.over_zmq  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("said", "words"),
    [
        ({"at": "2026-11-22"}, "start.at is '2026-11-22'; give a date with a time, as"),
        ({"at": 5}, "at is 5; give a date with a time"),
        ({"at": "noon:"}, "at is 'noon:'; give a date"),
        ({"at": "10000-01-01T00:00:00"}, "at is '10000-01-01T00:00:00'; give a date"),
        ({"at": {"every": 0.5}}, "start.at every is 0.5; give a number from 1 to 3600"),
        ({"at": {"every": float("nan")}}, "start.at every is nan; give a number from 1"),
        ({"at": {"each": 5}}, "give a date with a time"),
        ({"at": {"every": 5}, "together": TWO}, "at and together both say when; leave one out"),
        ({"late": "alone"}, "late 'alone' is not known; known: fault, go"),
        ({"late": []}, r"late is \[\]; write fault or go"),
        ({"together": "left"}, "together is 'left'; write a mapping with robots, me"),
        ({"together": {"robots": ["left"], "me": "left"}}, "name two or more"),
        ({"together": {"robots": ["left", "left"], "me": "left"}}, "robots has 'left' twice"),
        ({"together": {"robots": [1, 2], "me": 1}}, "me is 1; write a text"),
        ({"together": {"robots": [[], 2], "me": "[]"}}, r"robots has '\[\]'; use up to 40 letters"),
        ({"together": {"robots": ["left", "right"]}}, "missing key 'me'"),
        ({"together": TWO | {"me": ["left"]}}, r"me is \['left'\]; write a text"),
        ({"together": TWO | {"me": "rihgt"}}, "did you mean 'right'"),
        ({"together": TWO | {"group": "../x"}}, "group is '../x'; write up to 40"),
        ({"together": TWO | {"timeout": -1}}, "timeout is -1; write a number above 0 to 3600"),
        ({"together": TWO | {"timeout": float("inf")}}, "timeout is inf; write a number above 0"),
        ({"together": TWO | {"wait": 1}}, "unknown key 'wait'"),
        ({"together": TWO | {"keys": "keys"}}, "keys is for robots with addresses"),
        ({"together": OVER | {"keys": 1}}, "keys is 1; write the folder of the group's keys"),
        (
            {"together": {"robots": {"left": "a:1", "right": "tcp://b:1"}, "me": "left"}},
            "robots has 'a:1' as the address of 'left'; give tcp://HOST:PORT",
        ),
        (
            {"together": {"robots": {"left": "tcp://a:1", "right": "tcp://a:1"}, "me": "left"}},
            "robots has two robots of address 'tcp://a:1'",
        ),
    ],
)
def test_what_is_wrong_is_told_in_one_line(said: dict, words: str) -> None:
    with pytest.raises(WorkflowError, match=words) as told:
        start_of(said)
    assert str(told.value).startswith("w.yaml:1: start")
    assert "\n" not in str(told.value)
