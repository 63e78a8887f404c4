"""A robot's run: it waits, approaches, runs, winds down and damps, and no command jumps."""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass, field
from itertools import count
from typing import Any

import numpy as np
import pytest

from unicon_base.errors import Fault, UniconError
from unicon_core import Block, Program, Stage, Writes, block, policy, pose
from unicon_core.flow import Tick
from unicon_core.platforms.fake import FakeRobot, make_robot
from unicon_core.platforms.kit.command import BLEND, DAMPING_TIME
from unicon_core.robots import Robot
from unicon_core.runtime import Runner, RunOptions
from unicon_core.runtime.phases import Phase, describe
from unicon_core.runtime.startup_sequence import Waiting
from unicon_core.states import States

RATE = 50
ROBOT = {"robot": "go2", "rate": RATE, "platform": "fake_robot"}
QUICK = {"operator": False, "fade_in": 0.2, "approach": 10.0}
TIME_PASSES = pytest.mark.usefixtures("time_passes")


@dataclass
class Sent:
    """Commands as they left: phase, distance from the measured joints [rad], stiffness, target."""

    rows: list[tuple[Phase, float, float, float]] = field(default_factory=list)
    fails_at: int = -1

    def of(self, phase: Phase) -> np.ndarray:
        return np.array([row[1:] for row in self.rows if row[0] is phase])

    @property
    def phases(self) -> list[Phase]:
        return list(dict.fromkeys(row[0] for row in self.rows))


@pytest.fixture(autouse=True)
def told_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("unicon_core.runtime.startup_sequence.GRACE", 0.0)


class Battery:
    """A gate: holds from the so-many-th question on, or never can."""

    name = "battery"

    def __init__(self, holds_at: int = 1 << 62, dead_at: int = 1 << 62) -> None:
        self.asked, self._holds_at, self._dead_at = 0, holds_at, dead_at

    def __call__(self) -> str:
        self.asked += 1
        if self.asked >= self._dead_at:
            raise Fault("the battery is empty")
        return "" if self.asked >= self._holds_at else "it is at 3 %; charge it"


def made(sent: Sent, blocks: dict[Stage, list[Block]] | None = None, **given: Any) -> Program:
    """A program whose commands are watched."""

    def hook(program: Program) -> dict[Stage, list[Block]]:
        states, platform, send = program.states, program.platform, program.platform.send

        def watched() -> None:
            far = float(np.abs(states.joint_pos_target - states.joint_pos).max())
            stiffness, target = float(states.joint_stiffness.max()), states.joint_pos_target
            sent.rows.append((RUNNING[0].phase, far, stiffness, float(target[1])))
            if len(sent.rows) == sent.fails_at:
                raise OSError("the cable is out")
            send()

        platform.send = watched  # type: ignore[method-assign]
        return blocks or {}

    program = Program(hooks=[hook], **(ROBOT | {"start": QUICK} | given))
    program.gates[:] = []
    return program


RUNNING: list[Runner] = []


def runs(program: Program, **options: Any) -> tuple[Runner, list[str]]:
    told: list[str] = []
    runner = Runner(program, RunOptions(warn=told.append, **options))
    RUNNING[:] = [runner]
    return runner, told


def falls(sent: Sent) -> None:
    """The damping command: stiffness falls from what was sent last to zero in its time."""
    damped = sent.of(Phase.DAMP)
    assert len(damped) == round(DAMPING_TIME * RATE)
    before = [row for row in sent.rows if row[0] is not Phase.DAMP][-1]
    stiffness = damped[:, 1]
    assert stiffness[0] < before[2]
    assert np.all(np.diff(stiffness) <= 0.0)
    assert not stiffness[round(BLEND * RATE) :].any()
    assert np.allclose(damped[:, 2], before[3])


@TIME_PASSES
def test_a_robot_waits_approaches_runs_winds_down_and_damps() -> None:
    sent = Sent()
    program = made(
        sent,
        flow=policy("walk"),
        policies={"walk": "go2_velocity"},
        wind_down=pose("rest", duration=0.3),
        start={"operator": True, "fade_in": 0.4, "approach": 2.0},
    )

    class Eager(Battery):
        def __call__(self) -> str:
            assert self.asked >= 4 or not runner.go()  # not yet: the gate does not hold
            return super().__call__()

    program.gates[:] = [gate := Eager(holds_at=5)]
    runner, told = runs(program, duration=0.5, operator=True)

    def press() -> None:
        while "go" not in runner.waits_for:
            time.sleep(0.005)
        assert not sent.rows
        assert runner.go()

    operator = threading.Thread(target=press)
    operator.start()
    report = runner.run()
    operator.join()
    assert (report.faults, report.ended, report.ticks) == ([], "duration", 25)
    assert gate.asked >= 5
    assert told[0] == "waiting for battery: it is at 3 %; charge it"
    assert told[1].startswith("waiting for the operator's go: press Enter")
    assert sent.phases == [Phase.APPROACH, Phase.RUN, Phase.SOFT, Phase.DAMP]
    assert sent.rows[0][1] < 0.05
    steps = np.abs(np.diff([row[3] for row in sent.rows]))
    assert steps.max() < 0.1
    approach = sent.of(Phase.APPROACH)
    assert np.all(np.diff(approach[:20, 1]) > 0.0)
    assert runner.phase is Phase.OFF
    assert not runner.go()  # there is nothing to begin any more
    falls(sent)


def test_a_gate_that_cannot_hold_refuses() -> None:
    sent = Sent()
    program = made(sent, flow=block("hold"))
    program.gates[:] = [Battery(dead_at=3)]
    runner, told = runs(program)
    report = runner.run()
    assert (report.ticks, report.faults, sent.rows) == (0, ["the battery is empty"], [])
    assert told == ["waiting for battery: it is at 3 %; charge it"]


@TIME_PASSES
def test_where_nobody_looks_on_waiting_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("unicon_core.runtime.startup_sequence.PATIENCE", 0.1)
    sent = Sent()
    program = made(sent, flow=block("hold"))
    program.gates[:] = [Battery()]
    runner, _ = runs(program)
    report = runner.run()
    assert "waited 0.1 s for battery: it is at 3 %" in report.faults[0]
    assert not sent.rows


def test_what_is_waited_for_is_told_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("unicon_core.runtime.startup_sequence.REPEAT", 0.05)
    told: list[str] = []
    waiting = Waiting([Battery(holds_at=3)], True, told.append)
    assert not waiting()
    assert not waiting()
    assert len(told) == 1
    time.sleep(0.06)
    assert not waiting()
    assert len(told) == 2
    assert "go" in told[1]
    assert waiting.go()
    assert waiting()


@pytest.mark.parametrize("where", ["wait", "approach"])
def test_a_stop_before_the_run_ends_it_without_a_tick(where: str) -> None:
    sent = Sent()
    program = made(sent, flow=block("hold"), wind_down=pose("rest"))
    stop = Battery(holds_at=1 << 62 if where == "wait" else 1)
    program.gates[:] = [stop]
    runner, _ = runs(program)

    def press() -> None:
        while not (stop.asked if where == "wait" else sent.rows):
            time.sleep(0.001)
        runner.stop()

    presser = threading.Thread(target=press)
    presser.start()
    report = runner.run()
    presser.join()
    assert (report.ticks, report.faults, report.ended) == (0, [], "stopped")
    if where == "wait":
        assert not sent.rows
    else:
        assert sent.phases == [Phase.APPROACH, Phase.DAMP]


def test_a_stop_before_it_runs_lets_nothing_begin() -> None:
    sent = Sent()
    runner, _ = runs(made(sent, flow=block("hold"), wind_down=pose("rest")))
    runner.stop()
    report = runner.run()
    assert (report.ticks, report.faults, report.ended) == (0, [], "stopped")
    assert not sent.rows


@TIME_PASSES
@pytest.mark.parametrize("error", [Fault("tripped"), ValueError("a block"), SystemExit(7)])
def test_after_a_fault_only_the_damping_command_leaves(error: BaseException) -> None:
    sent, ticks = Sent(), 0

    def trip() -> None:
        nonlocal ticks
        ticks += 1
        if ticks == 30:
            raise error

    program = made(
        sent, {Stage.SAFETY: [Block("trip", trip)]}, flow=pose("stand"), wind_down=pose("rest")
    )
    report = runs(program)[0].run()
    assert report.ended == "fault"
    assert Phase.SOFT not in sent.phases
    falls(sent)


@TIME_PASSES
def test_a_fault_behind_send_counts_the_tick_whose_command_has_left() -> None:
    sent = Sent()

    class Patient:
        patient = True

        def __call__(self) -> None:
            if [row[0] for row in sent.rows].count(Phase.RUN) == 10:
                raise Fault("tripped")

    program = made(sent, {Stage.SAFETY: [Block("late", Patient())]}, flow=pose("stand"))
    report = runs(program)[0].run()
    assert report.faults == ["tripped"]
    assert report.ticks == [row[0] for row in sent.rows].count(Phase.RUN) == 10
    falls(sent)


@TIME_PASSES
def test_what_hears_and_looks_and_fails_stops_no_damping() -> None:
    sent, looked = Sent(), 0

    def broken() -> None:
        nonlocal looked
        looked += 1
        if looked >= 20:
            raise OSError("gone")

    looking = Block("look", broken)
    program = made(sent, {Stage.OBSERVE: [looking]}, flow=pose("stand"))
    report = runs(program)[0].run()
    assert "gone" in report.faults[0]
    falls(sent)
    assert looked == 21  # and then left alone


@TIME_PASSES
def test_where_commands_cannot_be_sent_the_platform_closes_at_once() -> None:
    sent = Sent(fails_at=30)
    closed: list[int] = []
    program = made(sent, flow=pose("stand"))
    program.platform.close = lambda: closed.append(len(sent.rows))  # type: ignore[method-assign]
    report = runs(program)[0].run()
    assert report.faults[0].startswith("OSError: the cable is out")
    assert len(sent.of(Phase.DAMP)) == round(DAMPING_TIME * RATE)  # it failed but once
    assert closed == [len(sent.rows)]


@TIME_PASSES
def test_start_none_sends_the_flow_at_once() -> None:
    sent = Sent()
    program = made(sent, flow=pose("stand", duration=0.2), start="none")
    report = runs(program)[0].run()
    assert report.faults == []
    assert sent.phases == [Phase.RUN, Phase.DAMP]


@TIME_PASSES
def test_a_simulator_neither_waits_nor_approaches_nor_is_damped_when_all_is_well() -> None:
    sent = Sent()
    program = made(sent, platform="fake", flow=pose("stand", duration=0.2), start=None)
    program.gates[:] = [Battery()]
    report = runs(program, operator=True)[0].run()
    assert (report.faults, sent.phases) == ([], [Phase.RUN])


def test_phases_are_told() -> None:
    told = dict(describe(made(Sent(), flow=pose("stand"))))
    assert list(told) == ["wait", "approach", "run", "soft", "damp", "off"]
    assert "10 rad/s" in told["approach"]


@pytest.mark.parametrize(
    ("start", "message"),
    [
        ({"fade": 1}, "unknown key 'fade'; did you mean 'fade_in'?"),
        ({"approach": 0}, "start.approach is 0"),
        ({"fade_in": float("nan")}, "start.fade_in is nan"),
        ({"operator": 1}, "start.operator is 1; write true or false"),
        ("quick", "start is 'quick'; write none or a mapping"),
    ],
)
def test_wrong_settings_are_refused(start: Any, message: str) -> None:
    with pytest.raises(UniconError, match=message.replace("?", r"\?")):
        Program(flow=block("hold"), **(ROBOT | {"start": start}))


@TIME_PASSES
def test_a_stall_while_it_waits_harms_nobody() -> None:
    sent = Sent()
    program = made(sent, flow=pose("stand", duration=0.2), pacing={"hang": 0.05})

    class Slow(Battery):
        def __call__(self) -> str:
            time.sleep(0.2)
            return super().__call__()

    program.gates[:] = [Slow(holds_at=3)]
    runs(program)[0].run()
    assert sent.rows


def test_a_robot_that_goes_while_it_waits_is_a_fault() -> None:
    sent = Sent()
    program = made(sent, flow=pose("stand"), platform=f"{__name__}:leaving")
    program.gates[:] = [Battery()]
    report = runs(program)[0].run()
    (fault,) = report.faults
    assert "has gone while it was waited for battery: it is at 3 %" in fault
    assert not sent.rows


def leaving(states: States, robot: Robot, period: float) -> FakeRobot:
    platform = make_robot(states, robot, period)
    recv, asked = platform.recv, count()

    def received() -> bool:
        recv()
        return next(asked) > 3

    platform.recv = received  # type: ignore[method-assign]
    return platform


def test_what_looks_at_commands_stays_where_another_flow_writes_fewer() -> None:
    def nudge(joint_pos_target: Writes) -> Tick:
        return lambda: joint_pos_target.fill(0.1)

    kept = {"only": ["finite", "joint_limits"]}
    with pytest.raises(UniconError, match=r"'finite' reads 'joint_\w+', which no block writes"):
        made(Sent(), flow=pose("stand"), wind_down=block(nudge), safety=kept)


@TIME_PASSES
def test_what_looks_at_the_flow_of_the_run_is_left_out_elsewhere() -> None:
    sent = Sent()
    program = made(
        sent,
        flow=policy("walk"),
        policies={"walk": "go2_velocity"},
        wind_down=pose("rest", duration=0.3),
        safety={"only": ["finite", "action_stop"]},
    )
    assert runs(program, duration=0.2)[0].run().faults == []
    assert sent.phases == [Phase.APPROACH, Phase.RUN, Phase.SOFT, Phase.DAMP]
