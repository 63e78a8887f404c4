"""The runner: ticks, deadlines, faults, reports and traces, on the fake platform."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from unicon_base.errors import Fault
from unicon_core.flow import Block, Stage
from unicon_core.platforms.kit.command import DAMPING_TIME
from unicon_core.runtime import Runner, RunOptions
from unicon_core.signals import SIGNALS
from unicon_core.workflow import HookBlocks, Program, load_workflow

TIME_PASSES = pytest.mark.usefixtures("time_passes")

WORKFLOW = """
robot: go2
platform: fake
rate: 100
flow:
  chain:
    - pose: {to: stand, duration: 0.1}
    - hold: {duration: 0.1}
safety: none
"""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    file = tmp_path / "short.yaml"
    file.write_text(WORKFLOW, encoding="utf-8")
    return file


def observer(tick: Any, **options: Any) -> Any:
    """A hook that adds one block."""
    return lambda program: {Stage.OBSERVE: [Block("observer", tick, **options)]}


def test_a_run_ends_when_its_flow_is_done(path: Path) -> None:
    runner = Runner(load_workflow(path), RunOptions(speed="max"))
    report = runner.run()
    assert runner.done
    assert report.ticks == 20
    assert report.duration_s == pytest.approx(0.2)
    assert report.faults == []


def test_a_run_ends_at_its_duration(path: Path) -> None:
    report = Runner(load_workflow(path), RunOptions(duration=0.05, speed="max")).run()
    assert report.ticks == 5


def test_the_same_run_sends_the_same_commands_and_another_does_not(path: Path) -> None:
    def digest(*overrides: str) -> str:
        return Runner(load_workflow(path, overrides), RunOptions(speed="max")).run().sha256_commands

    assert digest() == digest()
    assert digest() != digest("flow.chain.0.pose.to=rest")


def test_the_report_has_the_keys_of_the_contract(path: Path, tmp_path: Path) -> None:
    report = Runner(load_workflow(path), RunOptions(speed="max")).run()
    report.write(tmp_path / "new" / "report.json")
    values = json.loads((tmp_path / "new" / "report.json").read_text())
    expected = {
        "workflow", "robot", "ticks", "duration_s", "rate_hz", "overruns", "tick_us", "faults",
        "base_displacement_m", "fell", "sha256_commands",
    }  # fmt: skip
    assert expected <= set(values)
    assert set(values["tick_us"]) == {"p50", "p99", "max"}
    assert "bridge" not in values
    assert len(values["base_displacement_m"]) == 3


def test_a_fault_stops_before_send_and_closes_everything(path: Path) -> None:
    calls: list[str] = []
    stiffness: list[float] = []
    ticks = 0

    def trip() -> None:
        nonlocal ticks
        ticks += 1
        if ticks == 3:
            raise Fault("the test says so")

    def inputs(workflow: Program) -> HookBlocks:
        platform = workflow.platform
        send, close = platform.send, platform.close
        monitored: Any = platform
        stiff = workflow.states.joint_stiffness

        def sent() -> None:
            calls.append("send")
            stiffness.append(float(stiff.max()))
            send()

        monitored.send = sent
        monitored.close = lambda: (calls.append("close"), close())[1]
        return {Stage.INPUT: [Block("trip", trip, close=lambda: calls.append("trip closed"))]}

    # Hooks are asked before `send` is bound, so the counting one is what the graph calls.
    runner = Runner(load_workflow(path, hooks=[inputs]), RunOptions(speed="max"))
    report = runner.run()
    assert report.faults == ["the test says so"]
    damped = round(DAMPING_TIME / runner.program.period)
    assert calls == ["send"] * (2 + damped) + ["close", "trip closed"]
    assert np.all(np.diff(stiffness[1:]) <= 0.0)
    assert stiffness[2] < stiffness[1]
    assert stiffness[-1] == 0.0
    assert report.ticks == 2
    runner.close()
    assert calls.count("close") == 1


@TIME_PASSES
@pytest.mark.parametrize(("overrun", "wanted"), [("skip", 1), ("catch_up", 2)])
def test_a_slow_tick_is_an_overrun_and_the_policy_says_what_follows(
    path: Path, overrun: str, wanted: int
) -> None:
    starts: list[int] = []

    def slow_once() -> None:
        starts.append(time.perf_counter_ns())
        if len(starts) == 5:
            time.sleep(0.035)  # 3.5 periods

    workflow = load_workflow(path, [f"pacing.overrun={overrun}"], hooks=[observer(slow_once)])
    report = Runner(workflow).run()
    assert report.ticks == 20
    assert report.overruns >= wanted
    wall_periods = (starts[-1] - starts[0]) / 1e7
    # skip: the three missed ticks are gone, so 20 ticks span about 22 periods; catch_up: 19.
    assert wall_periods > 20.5 if overrun == "skip" else wall_periods < 20.5


def drift(path: Path) -> float:
    """Return by which share of their time the ticks of a run come too late."""
    starts: list[int] = []

    def note() -> None:
        starts.append(time.perf_counter_ns())
        time.sleep(0.002)  # a loop that sleeps a period after its work would lose 20 %

    # catch_up: where another process holds the core for a while, no tick is left out.
    overrides = ["flow.chain.1.hold.duration=0.6", "pacing.overrun=catch_up"]
    Runner(load_workflow(path, overrides, hooks=[observer(note)])).run()
    return (starts[-1] - starts[0]) / 1e7 / (len(starts) - 1) - 1.0


@TIME_PASSES
def test_deadlines_do_not_drift(path: Path) -> None:
    # Of several, since a busy machine may hold up the first or the last tick of one.
    assert any(abs(drift(path)) < 0.1 for _ in range(5))


def test_the_trace_opens_as_chrome_trace_events(path: Path, tmp_path: Path) -> None:
    runner = Runner(load_workflow(path), RunOptions(speed="max"))
    runner.run()
    runner.statistics.write_trace(tmp_path / "trace.json", "test")
    events = json.loads((tmp_path / "trace.json").read_text())["traceEvents"]
    spans = [event for event in events if event["ph"] == "X"]
    ticks = [event for event in spans if event["name"] == "tick"]
    assert [event["args"]["number"] for event in ticks] == list(range(20))
    for name, count in {"recv": 20, "send": 20, "pose": 10, "hold": 10}.items():
        assert sum(event["name"] == name for event in spans) == count
    for event in spans:
        inside = [t for t in ticks if t["ts"] <= event["ts"] <= t["ts"] + t["dur"]]
        assert inside
        assert event["dur"] >= 0


def test_the_block_table_names_every_block_with_its_share(path: Path) -> None:
    runner = Runner(load_workflow(path), RunOptions(speed="max"))
    runner.run()
    table = runner.statistics.table(period_us=1e4)
    for name in ("recv", "pose", "hold", "send", "report", "tick"):
        assert f"\n{name} " in table
    assert runner.statistics.block_us()["pose"]["calls"] == 10


def test_old_ticks_are_overwritten_and_the_newest_are_kept(path: Path) -> None:
    runner = Runner(load_workflow(path), RunOptions(speed="max", capacity=8))
    runner.run()
    rows = runner.statistics.kept()
    assert runner.statistics.count == 20
    assert len(rows) == 8
    assert (rows[1:, 2] > rows[:-1, 2]).all()


def test_a_signal_while_the_run_looks_for_one_is_not_lost(path: Path) -> None:
    class Arriving:
        """What was asked before: nothing; but a signal comes just as that is looked at."""

        def __bool__(self) -> bool:
            runner.stop()
            return False

    with SIGNALS:
        runner = Runner(load_workflow(path), RunOptions(speed="max"))
        SIGNALS.asked = Arriving()  # type: ignore[assignment]
        report = runner.run()
        SIGNALS.asked = 0
    assert report.ended == "stopped"
