"""Warm-ups: they change nothing that can be observed, keep to their time, and come when due."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from policy_workflows import KINDS, write_workflow

from unicon_base.errors import Fault
from unicon_core.flow import Amends, Reads, as_block
from unicon_core.runtime import Runner, RunOptions, WallClock, WarmUp
from unicon_core.workflow import load_workflow
from unicon_core.workflow.build import LARGEST

TICKS = 75


@pytest.fixture(scope="module")
def paths(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return {kind: write_workflow(tmp_path_factory.mktemp(kind), kind) for kind in KINDS}


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=8)
@given(
    warm_up=st.lists(st.integers(0, 3), min_size=TICKS, max_size=TICKS),
    resets=st.frozensets(st.integers(1, TICKS - 1), max_size=2),
    kicks=st.integers(0, 1000),
)
def test_the_states_of_every_tick_are_the_same_with_and_without_warm_ups(
    kind: str, paths: dict[str, Path], warm_up: list[int], resets: frozenset[int], kicks: int
) -> None:
    one, two = (Runner(load_workflow(paths[kind]), RunOptions(speed="max")) for _ in range(2))
    random = np.random.default_rng(kicks)
    for tick, count in enumerate(warm_up):
        kick = random.normal(size=3).astype(np.float32)
        for runner in (one, two):
            if tick in resets:
                runner.reset()
            runner.program.states.base_ang_vel = kick
        before = two.program.states.snapshot()
        for _ in range(count):
            two.graph.warm_up()
        assert two.program.states.snapshot() == before
        assert one.tick(0) == two.tick(0)
        assert one.program.states.snapshot() == two.program.states.snapshot()
    assert one.report().sha256_commands == two.report().sha256_commands
    for runner in (one, two):
        runner.close()


@pytest.mark.usefixtures("time_passes")
@pytest.mark.parametrize("kind", KINDS)
def test_a_paced_run_sends_the_same_bytes_with_and_without_warm_ups(
    kind: str, paths: dict[str, Path]
) -> None:
    digests, counts = [], []
    for microseconds in (0, 1000, 5000):
        overrides = [f"pacing.dry_run_us={microseconds}", "pacing.overrun=catch_up"]
        runner = Runner(load_workflow(paths[kind], overrides), RunOptions(duration=0.8))
        calls: list[int] = []
        warm_up = runner.graph.warm_up
        runner.graph.warm_up = lambda warm_up=warm_up, calls=calls: (calls.append(1), warm_up())[1]  # type: ignore
        digests.append(runner.run().sha256_commands)
        counts.append(len(calls))
    assert digests[0] == digests[1] == digests[2]
    assert counts[0] == 0
    assert min(counts[1:]) > 5


def test_every_built_in_block_of_the_flow_warms_up(paths: dict[str, Path]) -> None:
    workflow = load_workflow(paths["plain"])
    without = {block.name for block in workflow.blocks if block.warm_up is None}
    assert without == set()
    workflow.close()


def test_no_second_device_is_opened_for_a_warm_up(tmp_path: Path) -> None:
    path = tmp_path / "keys.yaml"
    path.write_text("{robot: go2, platform: fake, rate: 50, flow: hold, commands: [keyboard]}")
    workflow = load_workflow(path)
    assert [b.name for b in workflow.blocks if b.warm_up is None] == ["device"]
    workflow.close()


def busy(microseconds: float) -> None:
    end = time.perf_counter_ns() + microseconds * 1e3
    while time.perf_counter_ns() < end:
        pass


def test_the_lead_follows_what_a_warm_up_takes_and_keeps_to_its_bound() -> None:
    runs: list[int] = []
    waiting = WarmUp(lambda: (runs.append(1), busy(50.0)), WallClock(), 4_000_000)
    for _ in range(30):
        due = time.perf_counter_ns() + 6_000_000
        assert waiting.until(due) >= due
    short = waiting.lead_ns
    assert 30 < len(runs) <= 30 * 5
    assert short < 4_000_000
    waiting._warm_up = lambda: busy(3_000.0)
    for _ in range(3):
        waiting.until(time.perf_counter_ns() + 6_000_000)
    assert short < waiting.lead_ns == 4_000_000


def test_a_deadline_that_is_near_or_past_is_not_missed_for_a_warm_up() -> None:
    runs: list[int] = []
    waiting = WarmUp(lambda: runs.append(1), WallClock(), 1_000_000)
    waiting.until(time.perf_counter_ns() - 1)
    waiting.until(time.perf_counter_ns() + 500_000)
    assert runs == []


def test_no_warm_ups_are_wanted_with_a_lead_of_0() -> None:
    runs: list[int] = []
    waiting = WarmUp(lambda: runs.append(1), WallClock(), 0)
    waiting.until(time.perf_counter_ns() + 3_000_000)
    assert runs == []


BUILT: list[str] = []


def quiet(velocity_command: Reads, joint_pos_target: Amends) -> Any:
    """Not said to be pure: built once."""
    BUILT.append("quiet")
    return lambda: False


def pure_trap(velocity_command: Reads, joint_pos_target: Amends) -> Any:
    """Pure: built twice; trips when the command is positive."""
    BUILT.append("pure_trap")

    def tick() -> bool:
        joint_pos_target[...] += 1.0
        if velocity_command[0] > 0.0:
            raise Fault("tripped")
        return False

    return tick


pure_trap.pure = True  # type: ignore[attr-defined]

CALLS = """\
robot: go2
platform: fake
rate: 50
commands: [{velocity_command: {constant: [0.1, 0.0, 0.0]}}]
flow: {hold: {}}
safety: [{call: "test_warm_up:quiet"}, {call: "test_warm_up:pure_trap"}]
"""


def test_pure_blocks_are_warmed_up_on_a_copy_and_their_faults_wait(tmp_path: Path) -> None:
    path = tmp_path / "calls.yaml"
    path.write_text(CALLS, encoding="utf-8")
    BUILT.clear()
    workflow = load_workflow(path)
    assert sorted(BUILT) == ["pure_trap", "pure_trap", "quiet"]
    runner = Runner(workflow)
    workflow.states.velocity_command = 1.0
    before = workflow.states.snapshot()
    runner.graph.warm_up()
    assert workflow.states.snapshot() == before
    with pytest.raises(Fault, match="tripped"):
        runner.tick(0)
    runner.close()


def test_large_states_keep_no_block_from_warming_up_but_those_that_use_them(
    paths: dict[str, Path],
) -> None:
    def warmed(*sets: str) -> list[str]:
        workflow = load_workflow(paths["plain"], sets)
        workflow.close()
        return [block.name for block in workflow.blocks if block.warm_up is not None]

    usual = warmed()
    assert len(usual) > 4
    assert warmed("states={image: {shape: [1000, 1000]}}") == usual
    program = load_workflow(paths["plain"], ["states={image: {shape: [1000, 1000]}}"])
    program.states["image"][...] = 1.0
    recv = as_block(program.hearing[0]).warm_up
    assert recv is not None
    recv()
    cells = [each.cell_contents for each in recv.__closure__ or ()]
    copied = sum(len(here) for parts in cells if isinstance(parts, list) for here, _ in parts)
    assert 0 < copied < LARGEST
    program.close()
    of_many = warmed("num_robots=2000")
    assert "policy" in of_many  # it has one of its own
    assert len(of_many) < len(usual)
