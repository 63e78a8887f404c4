"""What is advised at the end of a run whose ticks began late."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from unicon_base.errors import Silence
from unicon_core import Program, block
from unicon_core.pacing import Pacing
from unicon_core.platforms.fake import FakeRobot
from unicon_core.platforms.kit.scene import Scene
from unicon_core.runtime import Report, Runner, RunOptions
from unicon_core.runtime.statistics import FEWEST, LATE, Starvation, TickStatistics, advice_of
from unicon_core.workflow import load_workflow

PERIOD = 20_000_000  # ns
TICKS = 2 * FEWEST


@pytest.fixture(autouse=True)
def usual_priority(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getscheduler", lambda pid: 0, raising=False)


def ticked(
    late: float, share: float = 1.0, took: float = 0.1, ticks: int = TICKS
) -> TickStatistics:
    """Return ticks of which a share begins late; all times in periods."""
    statistics = TickStatistics(["block"], frozenset(), capacity=TICKS + 2)
    for i in range(ticks + 1):
        due = (i + 1) * PERIOD
        begin = due + round(late * PERIOD * (i * share % 1.0 + share >= 1.0))
        end = begin + round(took * PERIOD)
        statistics.add(due, end, np.array([begin, begin, end]).data)
    return statistics


def advised(statistics: TickStatistics, speed: str = "real", **pacing: object) -> str:
    return advice_of(statistics, Pacing(**pacing), speed, PERIOD)  # type: ignore[arg-type]


def test_late_ticks_get_one_line_that_names_the_remedy() -> None:
    assert advised(ticked(0.18)) == (
        "one tick in 100 began 3.6 ms late or later, 18% of the period: others had the core; set "
        "pacing.priority=80, allowed by '<user> - rtprio 99' in /etc/security/limits.conf"
    )


def test_a_core_of_its_own_that_is_not_its_own_is_named_too() -> None:
    assert advised(ticked(0.5), cpu=1).endswith(
        "limits.conf, and leave out pacing.cpu, which waits for a busy core"
    )


@pytest.mark.parametrize(
    ("share", "told"), [(1 / 20, True), (1 / TICKS, False)], ids=["one in 20", "one in all"]
)
def test_single_late_ticks_are_not_advised_on(share: float, told: bool) -> None:
    assert bool(advised(ticked(0.5, share))) is told


def test_the_threshold_is_a_share_of_the_period() -> None:
    assert advised(ticked(LATE * 1.01))
    assert not advised(ticked(LATE * 0.99))


def test_a_block_that_holds_the_next_tick_up_is_not_the_priority_s_fault() -> None:
    assert advised(ticked(0.2, took=0.7))
    assert not advised(ticked(0.2, took=0.9))


@pytest.mark.parametrize(
    ("speed", "pacing"),
    [("max", {}), ("real", {"priority": 20}), ("real", {"trigger": "state"})],
    ids=["full speed", "has a priority", "comes with the data"],
)
def test_nothing_is_advised_where_it_would_not_help(speed: str, pacing: dict[str, object]) -> None:
    assert advised(ticked(0.5), speed, **pacing) == ""


def test_a_short_run_says_too_little() -> None:
    assert advised(ticked(0.5, ticks=FEWEST))
    assert not advised(ticked(0.5, ticks=FEWEST - 1))


def test_nothing_is_advised_to_who_was_given_a_priority(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getscheduler", lambda pid: os.SCHED_FIFO)
    assert advised(ticked(0.5)) == ""


def test_no_ticks_at_all_get_no_advice() -> None:
    assert advised(TickStatistics(["block"], frozenset())) == ""


def test_a_run_that_is_woken_late_tells_it_once_at_its_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "short.yaml"
    path.write_text("robot: go2\nplatform: fake\nrate: 500\nflow: {hold: {duration: 0.3}}\n")

    def report(speed: str) -> Report:
        runner = Runner(load_workflow(path), RunOptions(speed=speed))  # type: ignore[arg-type]
        made = runner.run()
        assert made.to_dict()["advice"] == made.advice
        return made

    monkeypatch.setattr("unicon_core.runtime.statistics.LATE", -1.0)  # whatever is late is too late
    told = report("real")
    assert "pacing.priority=80" in told.advice
    assert told.summary().count("\nadvice        one tick in 100 began ") == 1
    monkeypatch.setattr("unicon_core.runtime.statistics.LATE", 1e9)
    assert report("real").advice == ""
    quick = report("max")
    assert quick.advice == ""
    assert "advice" not in quick.summary()


class Told(FakeRobot):
    """A robot that falls silent in its tenth frame."""

    def recv(self) -> None:
        """Bring nothing from then on."""
        if self._ticks > 10:
            raise Silence("the robot is silent")
        super().recv()


def told(states: Any, robot: Any, period: float) -> Told:
    """Build it."""
    return Told(states, robot, period, Scene(), 0.0)


@pytest.mark.usefixtures("short_damping")
@pytest.mark.parametrize(
    ("waited", "stolen", "words"),
    [
        ("87.50", 20, "in 88 % of the last 10 s, and 10 % of its time was stolen"),
        ("3.0", 20, "in 3 % of the last 10 s, and 10 % of its time"),
        ("19.9", 9, ""),
        ("", 0, ""),
    ],
)
def test_a_silence_on_a_starved_machine_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, waited: str, stolen: int, words: str
) -> None:
    pressure, stat = tmp_path / "cpu", tmp_path / "stat"
    monkeypatch.setattr(Starvation, "PRESSURE", pressure)
    monkeypatch.setattr(Starvation, "STAT", stat)
    stat.write_text("cpu  100 0 50 800 0 0 0 40 0 0\ncpu0 1 2 3\n")
    if waited:
        pressure.write_text(f"some avg10={waited} avg60=1.0 avg300=0.0 total=1\nfull avg10=0\n")
    runner = Runner(
        Program(
            robot="go2", rate=100, platform=f"{__name__}:told", start="none", flow=block("hold")
        ),
        RunOptions(duration=5.0),
    )
    stat.write_text(f"cpu  200 0 80 {850 + 20 - stolen} 0 0 0 {40 + stolen} 0 0\ncpu0 1 2 3\n")
    (reason,) = runner.run().faults
    assert reason.startswith("the robot is silent")
    assert words in reason
    assert ("; this machine was starved: programs waited" in reason) == bool(words)
    assert ("pacing.priority=80" in reason) == bool(words)
