"""The steps between phases, each looked at alone: what is sent in them, and what ends them."""

from __future__ import annotations

import re
import threading
import time
from typing import Any

import numpy as np
import pytest

from unicon_base.errors import Fault, Hung, PlatformError
from unicon_core import Block, Program, Stage, block, policy, pose
from unicon_core.blocks.approach import Approach, Entry, Target
from unicon_core.gates.build import first_command
from unicon_core.pacing import WallClock
from unicon_core.platforms.child.platform import SILENCE, WATCHDOG
from unicon_core.platforms.kit.command import BLEND, DAMPING_TIME, Damping, LastSent
from unicon_core.robots import load_robot
from unicon_core.runtime import Runner, RunOptions
from unicon_core.runtime.phases import WIND_DOWN
from unicon_core.runtime.phases import Damp as DampPhase
from unicon_core.runtime.startup_sequence import PATIENCE, REPEAT, Waiting
from unicon_core.states import States, standard_states
from unicon_core.states.standard import COMMAND_STATES
from unicon_core.workflow.program_data import Gate

GO2 = load_robot("go2")
PERIOD = 0.02
TIME_PASSES = pytest.mark.usefixtures("time_passes")


def states_of_go2() -> States:
    states = States(standard_states(GO2.joint_names))
    states.joint_pos = GO2.default_joint_pos
    return states


def test_the_times_that_the_documentation_promises() -> None:
    assert (PATIENCE, REPEAT, WIND_DOWN, BLEND, DAMPING_TIME) == (30.0, 5.0, 5.0, 0.3, 0.5)
    assert (SILENCE[False], WATCHDOG[False]) == (0.02, 0.1)


def test_an_approach_is_slow_and_pushes_nothing() -> None:
    states = states_of_go2()
    begin = states.joint_pos.copy()
    goal = Target(begin + 0.5, np.full(12, 40.0), np.full(12, 2.0), "a test")
    approach = Approach(states, goal, PERIOD, 0.5, 0.4)
    targets, stiffness = [begin], []
    done = False
    while not done:
        states.joint_vel_target, states.joint_effort_ff = 3.0, 7.0  # what others had left there
        done = approach()
        targets.append(states.joint_pos_target.copy())
        stiffness.append(float(states.joint_stiffness[0]))
        assert not states.joint_vel_target.any()
        assert not states.joint_effort_ff.any()
        assert states.joint_damping.tolist() == [2.0] * 12
    assert len(stiffness) == 50  # 0.5 rad at 0.5 rad/s
    assert np.abs(np.diff(targets, axis=0)).max() < 0.5 * PERIOD * 1.001
    np.testing.assert_allclose(targets[-1], begin + 0.5, rtol=1e-6)
    np.testing.assert_allclose(stiffness, np.minimum(40.0 * np.arange(1, 51) / 20, 40.0), rtol=1e-5)


def test_an_approach_lasts_as_long_as_stiffness_grows() -> None:
    states = states_of_go2()
    goal = Target(states.joint_pos.copy(), np.full(12, 40.0), np.full(12, 2.0), "a test")
    approach = Approach(states, goal, PERIOD, 0.5, 0.4)
    assert [approach() for _ in range(20)] == [False] * 19 + [True]


def test_an_entry_blends_all_commands_from_what_was_sent_last() -> None:
    states, ticks = states_of_go2(), 10
    last = LastSent(states)
    entry = Entry(states, last, ticks)
    for _ in range(2):  # again after a reset
        for name in COMMAND_STATES:
            states[name][...] = 1.0
        last.note()
        for tick in range(1, ticks + 3):
            for name in COMMAND_STATES:
                states[name][...] = 3.0
            entry()
            for name in COMMAND_STATES:
                wanted = 1.0 + 2.0 * min(tick / ticks, 1.0)
                np.testing.assert_allclose(states[name], wanted, rtol=1e-6)
        entry.reset()


def test_an_entry_without_an_approach_begins_at_the_measured_posture() -> None:
    states = states_of_go2()
    entry = Entry(states, LastSent(states), 10)
    states.joint_pos_target = states.joint_pos + 1.0
    entry()
    np.testing.assert_allclose(states.joint_pos_target, states.joint_pos + 0.1, rtol=1e-5)


def test_a_robot_s_flow_comes_in_through_an_entry_before_the_safety_blocks() -> None:
    program = Program(robot="go2", platform="fake_robot", rate=50, flow=block("hold"))
    names = [each.name for each in Runner(program).graph.blocks]
    assert names.index("entry") == names.index("hold") + 1
    program.close()


# -- waiting ---------------------------------------------------------------------------------------


def test_go_counts_only_where_nothing_else_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("unicon_core.runtime.startup_sequence.GRACE", 0.0)
    said = ["it is cold"]

    class Warm:
        name = "warm"

        def __call__(self) -> str:
            return said[0]

    told: list[str] = []
    waiting = Waiting([Warm()], True, told.append)
    assert not waiting.go()
    assert not waiting()
    assert not waiting.go()
    said[0] = ""
    assert not waiting()
    assert waiting.go()
    assert waiting()
    assert [line.split(":")[0] for line in told] == [
        "waiting for warm",
        "waiting for the operator's go",
    ]


@TIME_PASSES
def test_what_looks_at_the_policy_is_left_out_of_approach_and_wind_down() -> None:
    program = Program(
        robot="go2",
        platform="fake_robot",
        rate=50,
        policies={"walk": "go2_velocity"},
        flow=policy("walk"),
        wind_down=pose("rest", duration=0.1),
        safety=["finite", block("action_stop", limit=8.5)],
        start={"operator": False, "fade_in": 0.1, "approach": 10.0},
    )
    program.gates[:] = []
    runner = Runner(program, RunOptions(duration=0.1, warn=lambda _: None))
    fused = {
        phase: int(
            next(
                re.findall(r"\((\d+) fused\)", b.name)[0] for b in graph.blocks if "fused" in b.name
            )
        )
        for phase, graph in runner.graphs().items()
    }
    assert fused["soft"] == fused["run"] - 1
    report = runner.run()
    assert (report.faults, report.ticks) == ([], 5)


# -- the run ---------------------------------------------------------------------------------------


def test_a_simulator_may_run_at_full_speed_and_a_robot_may_not() -> None:
    program = Program(robot="go2", platform="fake_robot", rate=50, flow=block("hold"))
    with pytest.raises(PlatformError, match="is a robot, which takes its time"):
        Runner(program, RunOptions(speed="max"))
    program.close()


def simulated(hooks: Any = (), **given: Any) -> tuple[Program, list[float]]:
    sent: list[float] = []

    def watch(program: Program) -> dict[Any, Any]:
        send, states = program.platform.send, program.states

        def watched() -> Any:
            sent.append(float(states.joint_stiffness.max()))
            return send()

        program.platform.send = watched  # type: ignore[method-assign]
        return {}

    program = Program(robot="go2", platform="fake", rate=50, hooks=[watch, *hooks], **given)
    return program, sent


def test_a_wind_down_commands_no_motion_and_ends_in_time() -> None:
    seen: list[float] = []

    def look(program: Program) -> dict[Any, Any]:
        states = program.states
        note = Block("note", lambda: seen.append(float(states.velocity_command[0])))
        return {Stage.OBSERVE: [note]}

    program, _ = simulated(flow=block("hold"), wind_down=block("hold"), hooks=[look])
    program.states.velocity_command[0] = 0.7
    report = Runner(program, RunOptions(duration=0.2, speed="max")).run()
    assert report.faults == []
    assert seen[:10] == pytest.approx([0.7] * 10)
    assert seen[10:] == [0.0] * round(WIND_DOWN * 50)


def test_what_never_sent_anything_neither_winds_down_nor_is_damped() -> None:
    program, sent = simulated(flow=block("hold"), wind_down=block("hold"))
    runner = Runner(program, RunOptions(speed="max"))
    runner.stop()
    report = runner.run()
    assert (report.ended, sent) == ("stopped", [])


def test_a_robot_that_was_sent_nothing_is_sent_nothing_at_its_end() -> None:
    sent: list[int] = []

    def watch(program: Program) -> dict[Any, Any]:
        program.platform.send = lambda: sent.append(1)  # type: ignore[method-assign]
        return {}

    program = Program(
        robot="go2", platform="fake_robot", rate=50, flow=block("hold"), hooks=[watch], start="none"
    )
    runner = Runner(program, RunOptions(warn=lambda _: None))
    runner.stop()
    assert runner.run().faults == []
    assert sent == []


def test_a_fault_acts_before_the_platform_damps() -> None:
    program, sent = simulated(flow=block("hold"))
    runner = Runner(program, RunOptions(speed="max"))
    acted: list[int] = []
    runner.at_fault.append(lambda: acted.append(len(sent)))

    def trip() -> None:
        raise Fault("tripped")

    runner.call_soon(trip)
    report = runner.run()
    assert report.faults == ["tripped"]
    assert acted == [0]


@TIME_PASSES
def test_a_block_that_hung_is_not_asked_again_while_it_damps() -> None:
    asked: list[int] = []

    def hear(program: Program) -> dict[Any, Any]:
        def slow() -> None:
            asked.append(1)
            if len(asked) == 3:
                time.sleep(1.0)

        return {Stage.ESTIMATE: [Block("slow", slow)]}

    program = Program(
        robot="go2",
        platform="fake_robot",
        rate=50,
        flow=block("hold"),
        hooks=[hear],
        start="none",
        pacing={"hang": 0.5},
    )
    report = Runner(program, RunOptions(duration=2.0, warn=lambda _: None)).run()
    assert "a tick hung: slow took" in report.faults[0]
    assert len(asked) == 3


@TIME_PASSES
def test_a_pause_between_ticks_is_no_hang() -> None:
    program, sent = simulated(flow=block("hold"), pacing={"hang": 0.1})
    runner = Runner(program, RunOptions(duration=0.2))
    runner.call_soon(lambda: time.sleep(0.3))
    assert runner.run().faults == []
    assert len(sent) == 10


@TIME_PASSES
def test_a_tick_in_a_long_pause_is_sent() -> None:
    counts: list[int] = []

    def pause() -> None:
        time.sleep(0.3)
        counts.append(len(sent))
        runner.tick(time.perf_counter_ns())
        counts.append(len(sent))

    def third(program: Program) -> dict[Any, Any]:
        def look() -> None:
            if program.states["tick"] == 3 and not counts:
                runner.call_soon(pause)

        return {Stage.OBSERVE: [Block("look", look)]}

    program, sent = simulated(flow=block("hold"), pacing={"hang": 0.2}, hooks=[third])
    runner = Runner(program, RunOptions(duration=0.4))
    assert runner.run().faults == []
    assert counts[1] == counts[0] + 1


@TIME_PASSES
def test_time_in_which_no_tick_ran_is_a_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    program, sent = simulated(flow=block("hold"), pacing={"hang": 0.2})
    until = WallClock.until

    def late(clock: WallClock, deadline_ns: int) -> int:
        if len(sent) == 4:
            time.sleep(0.5)
        return until(clock, deadline_ns)

    monkeypatch.setattr(WallClock, "until", late)
    report = Runner(program, RunOptions(duration=0.4)).run()
    assert "no tick ran for 0." in report.faults[0]
    assert report.overruns >= 20
    assert sent.count(60.0) == 4  # then it is damped


# -- damping ---------------------------------------------------------------------------------------


def damped(sending: Any = None) -> tuple[Program, list[str]]:
    done: list[str] = []

    def watch(program: Program) -> dict[Any, Any]:
        platform: Any = program.platform
        recv = platform.recv
        platform.recv = lambda: (done.append("recv"), recv())[1]
        platform.send = lambda: (done.append("send"), sending and sending(program, done))[1]
        return {}

    program = Program(
        robot="go2", platform="fake_robot", rate=50, flow=block("hold"), hooks=[watch]
    )
    return program, done


@TIME_PASSES
def test_damping_hears_and_takes_its_time_on_a_robot() -> None:
    program, done = damped()
    began = time.monotonic()
    DampPhase(program).run(hear=True)
    assert time.monotonic() - began >= DAMPING_TIME - 2 * PERIOD
    assert done.count("send") == done.count("recv") == round(DAMPING_TIME / PERIOD)
    program.close()


def test_a_program_that_is_closed_while_it_damps_sends_nothing_more() -> None:
    program, done = damped(lambda program, done: len(done) >= 5 and program.gate.close())
    with pytest.raises(Fault, match="closed while it damped"):
        DampPhase(program).run(hear=False)
    assert done == ["send"] * 5
    program.close()


def test_the_first_command_is_the_same_however_often_it_is_asked_for() -> None:
    program = Program(robot="go2", platform="fake_robot", rate=50, flow=pose("rest", duration=0.2))
    program.platform.recv()
    first, again = (first_command(program).joint_pos.tolist() for _ in range(2))
    assert first == again
    program.close()


# -- the last gate ---------------------------------------------------------------------------------


def test_nothing_passes_a_gate_that_is_closed_or_late() -> None:
    states = states_of_go2()
    gate, sent = Gate(LastSent(states)), []
    send = gate.before(lambda: sent.append(1))
    send()
    assert gate.sent.any
    gate.until_ns = time.perf_counter_ns() - 1
    with pytest.raises(Hung, match="too late"):
        send()
    gate.until_ns = 1 << 62
    gate.close()
    with pytest.raises(Fault, match="the workflow is closed"):
        send()
    assert sent == [1]


def test_what_passed_is_remembered_for_the_damping_command() -> None:
    states = states_of_go2()
    last = LastSent(states)
    assert last.limp
    assert not last.any
    gate = Gate(last)
    states.joint_stiffness = 30.0
    gate.before(lambda: None)()
    states.joint_stiffness = 99.0
    assert last.any
    assert last.states.joint_stiffness.tolist() == [30.0] * 12


@pytest.mark.parametrize("said", [True, False])
def test_the_damping_command_keeps_targets_within_limits_and_falls(said: bool) -> None:
    states = states_of_go2()
    last = LastSent(states)
    source = states.joint_pos_target if said else states.joint_pos
    source[...] = GO2.upper + 0.5
    states.joint_stiffness, states.joint_damping = 5000.0, 900.0
    states.joint_effort_ff, states.joint_vel_target = 9.0, 9.0
    if said:
        last.note()
    damping = Damping(states, GO2, last, PERIOD)
    stiffness = []
    for _ in range(25):
        damping()
        stiffness.append(float(states.joint_stiffness.max()))
    assert states.joint_pos_target.tolist() == GO2.upper.tolist()
    assert not states.joint_effort_ff.any()
    assert not states.joint_vel_target.any()
    assert states.joint_damping.tolist() == GO2.joint_damping.tolist()
    assert stiffness[0] == (pytest.approx(2000.0 * (1 - PERIOD / 0.3)) if said else 0.0)
    assert stiffness[15:] == [0.0] * 10
    for wrong in (GO2.upper + 1.5, GO2.lower - 1.5, np.full(12, np.nan)):
        other = states_of_go2()
        other.joint_pos = wrong  # no measurement: the pose of the robot file
        Damping(other, GO2, LastSent(other), PERIOD)()
        np.testing.assert_allclose(other.joint_pos_target, GO2.default_joint_pos)


def test_a_closer_that_waits_in_vain_closes_the_gate(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("unicon_core.runtime.runner.CLOSING", 0.05)
    program, sent = simulated(flow=block("hold"), pacing={"hang": 10.0})
    runner = Runner(program, RunOptions())
    hangs = threading.Event()

    def hang() -> None:
        hangs.set()
        time.sleep(0.4)

    runner.call_soon(hang)
    thread = threading.Thread(target=runner.run)
    thread.start()
    assert hangs.wait(5.0)
    with pytest.raises(Exception, match="sends nothing any more"):
        runner.close()
    assert program.gate.closed
    thread.join(5.0)
    assert sent == []
