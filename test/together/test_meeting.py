"""Meetings over shared memory and zmq, all in this process."""

from __future__ import annotations

import os
import re
import shutil
import socket
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from unicon_base.errors import Fault, StateError, UniconError, WorkflowError
from unicon_base.schema.read import read_value
from unicon_core.states.backends.shm import segments
from unicon_core.synchronised_start.meeting import Meeting, Party

GROUP = f"test-{os.getpid()}"
PERIOD = 0.01
Opens = Callable[..., Meeting]


def party_of(said: object) -> Party:
    party: Party = read_value(Party, said, lambda _, text: WorkflowError(text), "together")
    return party.within(Path())


@pytest.fixture
def opens() -> Iterator[Opens]:
    """Opens one robot's side; nothing is left in the end."""
    opened: list[Meeting] = []

    def of(
        robots: object,
        me: str,
        *,
        alone: bool = False,
        timeout: float = 5.0,
        keys: str | None = None,
    ) -> Meeting:
        said = {"robots": robots, "me": me, "group": GROUP, "timeout": timeout, "keys": keys}
        opened.append(Meeting(party_of(said), alone, PERIOD))
        return opened[-1]

    yield of
    for meeting in opened:
        meeting.close()
    assert not [found.name for found in segments() if GROUP in found.name]


def addresses(*names: str) -> dict[str, str]:
    pytest.importorskip("zmq", reason="store zmq needs pyzmq")
    held = [socket.socket() for _ in names]
    for each in held:
        each.bind(("127.0.0.1", 0))
    ports = [each.getsockname()[1] for each in held]
    for each in held:
        each.close()
    return {name: f"tcp://127.0.0.1:{port}" for name, port in zip(names, ports)}


def asked(*meetings: Meeting, ready: bool = True, seconds: float = 4.0) -> list[int]:
    """Ask all of them, tick by tick, until all have a moment."""
    end = time.monotonic() + seconds
    moments = [0] * len(meetings)
    while time.monotonic() < end and not all(moments):
        moments = [meeting.ask(ready) for meeting in meetings]
        time.sleep(PERIOD)
    return moments


def test_three_of_one_machine_agree_on_a_moment_and_say_who_lacks_before(opens: Opens) -> None:
    names = ["a", "b", "c"]
    a, b = opens(names, "a"), opens(names, "b")
    assert asked(a, b, seconds=0.2) == [0, 0]
    assert a.reason == "'c', which is not there"
    c = opens(names, "c")
    for _ in range(20):
        asked(c, ready=False, seconds=PERIOD)
        asked(a, seconds=PERIOD)
    assert (
        a.reason == "'b', which is silent; 'c', which is there and not ready: gates, operator "
        "or approach"
    )
    moments = asked(a, b, c)
    assert moments[0] == moments[1] == moments[2] > time.monotonic_ns()
    a.begun()
    assert c.facts() == {"robots": names}
    c.close()
    again = opens(names, "c")
    asked(again, seconds=0.4)
    assert "'a', which has begun already" in again.reason


@pytest.mark.slow
def test_two_agree_over_zmq(opens: Opens) -> None:
    robots = addresses("a", "b")
    moments = asked(opens(robots, "a"), opens(robots, "b"))
    assert moments[0] == moments[1] > time.time_ns()


def test_those_with_the_keys_of_the_group_agree_and_nobody_else_is_heard(
    opens: Opens, tmp_path: Path
) -> None:
    robots = addresses("a", "b")
    from zmq.auth import create_certificates

    keys, others = tmp_path / "keys", tmp_path / "others"
    for folder in (keys, others):
        (folder / "clients").mkdir(parents=True)
        for who in ("server", "client"):
            create_certificates(folder, who)
        shutil.copy(folder / "client.key", folder / "clients")
    a = opens(robots, "a", keys=str(keys))
    for stranger in (None, str(others)):
        b = opens(robots, "b", keys=stranger)
        assert asked(a, b, seconds=0.5) == [0, 0]
        b.close()
    moments = asked(a, opens(robots, "b", keys=str(keys)))
    assert moments[0] == moments[1] > time.time_ns()


def test_a_clock_that_is_off_is_told_by_name(opens: Opens, monkeypatch: pytest.MonkeyPatch) -> None:
    robots = addresses("a", "b")
    a, b = opens(robots, "a"), opens(robots, "b")
    monkeypatch.setattr(b, "clock", lambda: time.time_ns() + 2_000_000_000)
    assert asked(a, b, seconds=0.4) == [0, 0]
    off = r"'b', which has a clock (2.0|1.9)\d+ s ahead of the one here; synchronise both \(NTP, .*"
    assert re.fullmatch(off, a.reason)
    assert "s behind the one here" in b.reason


def test_who_never_comes_is_a_fault_by_name_or_left_behind(opens: Opens) -> None:
    names = ["a", "b"]
    with pytest.raises(Fault, match=r"not started, waited 0.2 s for 'b', which is not there"):
        asked(opens(names, "a", timeout=0.2))
    alone = opens(["b", "c"], "c", timeout=0.1, alone=True)
    (moment,) = asked(alone)
    assert moment > 0
    assert alone.late == "it goes without 'b', which is not there"
    assert alone.facts() == {"robots": ["c"]}


def test_a_name_is_one_robots(opens: Opens) -> None:
    opens(["a", "b"], "a")
    told = rf"cannot be robot 'a' of group '{GROUP}': .* is written by .*; end that run, or give"
    with pytest.raises(StateError, match=told):
        opens(["a", "b"], "a")


def test_an_address_is_one_robots(opens: Opens) -> None:
    robots = addresses("a", "b")
    opens(robots, "a")
    with pytest.raises(StateError, match="in use"):
        opens(robots, "a")


def test_strangers_and_garbage_are_nobody(opens: Opens) -> None:
    zmq = pytest.importorskip("zmq")
    robots = addresses("a", "b")
    context = zmq.Context()
    stranger = context.socket(zmq.PUB)
    stranger.bind(robots["b"])
    a = opens(robots, "a")
    for _ in range(20):
        for junk in (b"", b"x" * 300, b"UNICONZQ" + b"\xff" * 200):
            stranger.send(junk)
        assert asked(a, seconds=PERIOD) == [0]
    assert a.reason == "'b', which is not there"
    stranger.close(linger=0)
    context.term()


def test_slow_ticks_are_refused() -> None:
    with pytest.raises(UniconError, match="together needs 20 ticks a second and more, and there a"):
        Meeting(party_of({"robots": ["a", "b"], "me": "a"}), False, 0.1)
