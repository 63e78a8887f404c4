"""Action chunks: which row runs when, where chunks overlap, and what follows the last one."""

from __future__ import annotations

import math
import os
import signal
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as some

from unicon_core.policies.chunks import ChunkSpec, Plan

pytest.importorskip("onnxruntime", reason="the networks are ONNX")
pytest.importorskip("onnx", reason="networks are written")

from chunk_network import ROWS, write_chunks
from slow_network import weights, workflow

from unicon_base.errors import PolicyError, UniconError
from unicon_core.policies.networks import child
from unicon_core.runtime import Runner, RunOptions
from unicon_core.runtime.report import Report
from unicon_core.workflow import Program
from unicon_core.workflow.tick_tree import memory_of

DT = 0.01
Mode = Literal["receding", "ensemble", "real_time"]


def row_at(ticks: int, row: float, size: int) -> int:
    return min(math.floor(ticks * DT / row + 1e-6), size - 1)


def reference(mode: Mode, answers: list[Any], row: float, size: int, tick: int) -> Any:
    """What runs in a tick by the papers' equations, chunk by chunk; NumPy's mean, no plan."""
    long = math.ceil(size * row / DT - 1e-6)
    there = [(of, chunk) for of, at, chunk in answers if at <= tick]
    if mode == "ensemble":
        rows = [c[row_at(tick - of, row, size)] for of, c in there if tick - of < long]
        return np.average(rows, 0, np.exp(-0.3 * np.arange(len(rows))))
    if mode == "receding":
        of, chunk = there[-1]
        return chunk[row_at(tick - of, row, size)]

    def planned(count: int, when: int) -> Any:
        of, at, chunk = answers[count]
        i = row_at(when - of, row, size)
        if count == 0 or when - answers[count - 1][0] >= long:
            return chunk[i]
        delay = math.ceil((at - of) * DT / row - 1e-6)
        overlap = size - (of - answers[count - 1][0]) * DT / row
        c = min(max((overlap - i) / max(overlap - delay + 1, 1), 0.0), 1.0)
        share = 1.0 if i < delay else c * (math.exp(c) - 1.0) / (math.e - 1.0)
        return share * planned(count - 1, when) + (1.0 - share) * chunk[i]

    return planned(len(there) - 1, tick)


@settings(deadline=None, max_examples=60)
@given(
    mode=some.sampled_from(["receding", "ensemble", "real_time"]),
    row=some.sampled_from([0.01, 0.02, 1 / 30, 0.05, 0.004, 0.0137]),
    size=some.integers(1, 12),
    pairs=some.lists(some.tuples(some.integers(1, 9), some.integers(1, 6)), min_size=1, max_size=6),
    seed=some.integers(0, 99),
)
def test_a_plan_is_the_equation_of_its_paper(
    mode: Mode, row: float, size: int, pairs: list[tuple[int, int]], seed: int
):
    plan = Plan(ChunkSpec(size, execution=mode, weight=0.3), row, DT, 2, False)
    random, asked, answers = np.random.default_rng(seed), 0, []
    for delay, pause in pairs:
        answers.append((asked, asked + delay, random.normal(size=(size, 2)).astype(np.float32)))
        asked += delay + pause
    for count, (of, at, chunk) in enumerate(answers):
        plan.add(chunk, of, at)
        end = answers[count + 1][1] if count + 1 < len(answers) else at + 20
        for tick in range(at, min(end, of + plan.ticks)):
            want = reference(mode, answers, row, size, tick)
            np.testing.assert_allclose(plan.at(tick), want, atol=2e-5)


def test_rows_that_run_meanwhile_stay_bit_exact():
    plan = Plan(ChunkSpec(10, execution="real_time"), 0.02, DT, 3, False)
    first, second = np.random.default_rng(1).normal(size=(2, 10, 3)).astype(np.float32)
    plan.add(first, 0, 2)
    before = [plan.at(tick).copy() for tick in range(13)]
    plan.add(second, 8, 11)  # 1.5 rows: the second one runs to its end
    for tick in (8, 9, 10, 11):
        np.testing.assert_array_equal(plan.at(tick), before[tick])
    assert np.abs(plan.at(12) - before[12]).max() > 0.0
    np.testing.assert_array_equal(plan.at(27), second[9])  # nothing overlaps


def chunked(folder: Path, child_: Any = True, rate: int = 100, **more: Any) -> dict[str, Any]:
    return workflow(folder, child_, rate=rate, **more)


def ticked(values: dict[str, Any], ticks: int) -> list[dict[str, Any]]:
    """Tick a program; what some states are after each tick."""
    program = Program(**values)
    runner = Runner(program, RunOptions(speed="max", warn=lambda _: None))
    names = ("action", "observation", "joint_pos_target", "action_age")
    try:
        found = []
        for _ in range(ticks):
            runner.tick(0)
            found.append({name: program.states[name].copy() for name in names})
        return found
    finally:
        program.close()


def run(values: dict[str, Any], duration: float, speed: Any = "max") -> tuple[Report, list[str]]:
    said: list[str] = []
    program = Program(**values)
    options = RunOptions(duration=duration, speed=speed, warn=said.append)
    return Runner(program, options).run(), said


@pytest.mark.parametrize(("period", "steps"), [(0.02, None), (1 / 30, 3), (0.01, 8)])
def test_each_tick_has_the_row_of_its_time(tmp_path: Path, period: float, steps: int | None):
    write_chunks(tmp_path, period=period, steps=steps)
    found = ticked(chunked(tmp_path, {"delay": 3}), 60)
    w, every, asked, pending, newest = weights()[0], 4, -99, None, None
    for tick, now in enumerate(found):
        if pending is not None and tick - pending[0] == 3:
            newest, pending = pending, None
        if newest is not None:
            row = row_at(tick - newest[0], period, ROWS)
            np.testing.assert_allclose(now["action"], newest[1] + 0.01 * row, atol=1e-6)
            assert now["action_age"] == np.float32((tick - newest[0]) * DT)
        due = (steps or 0) * period / DT - 1e-6
        if tick % every == 0 and pending is None and tick - asked >= due:
            asked, pending = tick, (tick, np.tanh(now["observation"] @ w))
    assert newest is not None


@pytest.mark.parametrize(
    "execution",
    [
        pytest.param("receding", marks=pytest.mark.slow),
        "ensemble",
        pytest.param("real_time", marks=pytest.mark.slow),
    ],
)
def test_a_restored_tick_goes_on_alike(tmp_path: Path, execution: Mode):
    write_chunks(tmp_path, period=0.03, execution=execution)
    values = chunked(tmp_path, {"delay": 2})
    program = Program(**values)
    runner, memory = Runner(program, RunOptions(speed="max", warn=lambda _: None)), None
    try:
        for tick in range(40):
            if tick == 21:
                memory = memory_of(program, runner.graphs(), platform=program.platform)
                kept, states = memory.take(), program.states.snapshot()
            runner.tick(0)
        assert memory is not None
        after = program.states["joint_pos_target"].copy()
        memory.put_back(kept)
        program.states.restore(states)
        for _ in range(19):
            runner.tick(0)
        np.testing.assert_array_equal(program.states["joint_pos_target"], after)
    finally:
        program.close()


def test_a_network_may_take_the_rows_that_are_planned(tmp_path: Path):
    write_chunks(tmp_path, prefix=True, period=0.02, execution="real_time")
    found = ticked(chunked(tmp_path, {"delay": 3}), 40)
    actions = np.array([now["action"][0] for now in found])
    # Zeros and no delay are known at first; then each answer is the rows of before plus its delay.
    assert not actions[:3].any()
    assert {*np.unique(np.diff(actions))} == {0.0, 2.0}
    assert actions[-1] == 2.0 * np.count_nonzero(np.diff(actions))


def test_wrong_chunks_are_refused(tmp_path: Path):
    path = write_chunks(tmp_path) / "policy.yaml"
    path.write_text(path.read_text().replace("size: 8", "size: 4"))
    told = "is no chunk of 4 × 12; correct chunk.size in policy.yaml"
    with pytest.raises(PolicyError, match=told):
        Program(**chunked(tmp_path))
    write_chunks(tmp_path, steps=9)
    with pytest.raises(UniconError, match="a chunk has 8 rows; give at most as many"):
        Program(**chunked(tmp_path))
    write_chunks(tmp_path, period=9.0)
    with pytest.raises(UniconError, match="8 rows, 72 s; a minute is the most"):
        Program(**chunked(tmp_path))
    write_chunks(tmp_path, period=0.01, hold=0.0)
    with pytest.raises(PolicyError, match=r"the time of a chunk with chunk.hold is 0\.07 s"):
        Program(**chunked(tmp_path, {"delay": 7}))
    write_chunks(tmp_path)
    with pytest.raises(PolicyError, match="add child: true beside its path"):
        Program(**chunked(tmp_path, None))


FLOWS = {"fault": {"policy": "slow"}, "done": {"chain": [{"policy": "slow"}, "hold"]}}
SUDDEN = [{"velocity_command": {"schedule": [[0.0, 0.2, 0.0, 0.0], [0.2, 0.8, 0.0, 0.0]]}}]


@pytest.mark.parametrize("underrun", ["fault", "done"])
def test_a_chunk_with_nan_never_reaches_a_joint(tmp_path: Path, underrun: str):
    write_chunks(tmp_path, nan=True, underrun=underrun)
    report, said = run(chunked(tmp_path, commands=SUDDEN, flow=FLOWS[underrun]), 0.6)
    told = "the action is not finite: joint 'FR_hip_joint' is nan in row 0"
    if underrun == "fault":
        assert told in report.faults[0]
    else:
        assert (report.faults, report.ticks) == ([], 60)
        assert told in said[-1]
        assert "the flow goes on" in said[-1]


@pytest.mark.parametrize("speed", ["real", pytest.param("max", marks=pytest.mark.slow)])
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
@pytest.mark.parametrize("underrun", ["fault", "done"])
def test_a_process_that_is_gone_leaves_a_robot_that_stands(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, speed: Any, number: Any, underrun: str
):
    monkeypatch.setattr(child, "PATIENCE", 0.3)
    monkeypatch.setattr(child, "_CLOSING", 0.1)
    write_chunks(tmp_path, period=0.02, hold=0.1, underrun=underrun)
    targets: list[Any] = []

    def look() -> None:
        targets.append(program.states["joint_pos_target"].copy())
        if program.states["tick"] == 20:
            os.kill(process.pid, number)

    program = Program(**chunked(tmp_path, flow=FLOWS[underrun], deferred=[lambda: look()]))
    (process,) = {b.tick.network.process for b in program.blocks if hasattr(b.tick, "network")}
    said: list[str] = []
    options = RunOptions(duration=0.8, speed=speed, warn=said.append)
    report = Runner(program, options).run()
    told = "was killed by SIGKILL" if number is signal.SIGKILL else "hangs or was stopped"
    if underrun == "fault":
        assert report.ended == "fault"
        assert told in report.faults[0]
        return
    assert report.faults == []
    assert any(told in line for line in said)
    assert len(targets) > 70
    # What was sent last is held to the end, with the policy's gains or those of hold.
    np.testing.assert_array_equal(targets[55], targets[70])
    assert program.states["joint_stiffness"].min() > 0.0


@pytest.mark.slow
def test_the_hash_is_the_same_twice_and_at_real_rate(tmp_path: Path):
    write_chunks(tmp_path, period=0.03, execution="ensemble")
    values = chunked(tmp_path, {"delay": 3})
    first, second = (run(values, 0.4)[0].sha256_commands for _ in range(2))
    assert first == second
    paced = (run(values, 0.4, "real")[0].sha256_commands for _ in range(5))
    assert first in paced


@pytest.mark.slow
def test_a_network_slower_than_its_chunk_skips_rows_and_then_underruns(tmp_path: Path):
    """At real rate its answers come late: their first rows are never sent."""
    write_chunks(tmp_path, period=0.01, turns=60_000, hold=5.0)
    rows: list[float] = []
    values = chunked(tmp_path, deferred=[lambda: rows.append(float(states["action_age"]))])
    program = Program(**values)
    states = program.states
    report = Runner(program, RunOptions(duration=1.5, warn=lambda _: None)).run()
    assert report.faults == []
    fresh = [age for before, age in pairwise(rows) if age < before]
    assert len(fresh) > 2
    assert min(fresh) > 0.03  # by so much the first row that runs is behind the observation
    assert report.blocks["policy"]["p50"] < 5_000.0
    write_chunks(tmp_path, period=0.01, turns=600_000, hold=0.05, underrun="done")
    report, said = run(chunked(tmp_path, flow=FLOWS["done"]), 1.0, "real")
    assert report.faults == []
    assert "the time of a chunk with chunk.hold" in said[-1]


def test_a_policy_that_is_entered_again_begins_with_no_rows(tmp_path: Path):
    write_chunks(tmp_path, period=0.02)
    cases = {"a": {"policy": "slow"}, "b": "hold"}
    flow = {"switch": {"on": "(tick > 20) * (tick < 25)", "cases": cases}}
    found = ticked(chunked(tmp_path, {"delay": 3}, flow=flow), 40)
    targets = [now["joint_pos_target"] for now in found]
    left = next(i for i, now in enumerate(found) if i > 5 and not now["action_age"])
    for target in targets[left : left + 7]:  # hold, then the ticks until the first answer
        np.testing.assert_array_equal(target, targets[left - 1])
    assert np.abs(targets[left + 7] - targets[left - 1]).max() > 1e-3
    assert found[left + 7]["action_age"] == np.float32(0.03)


@pytest.mark.slow
def test_two_policies_have_a_plan_each(tmp_path: Path):
    (one := tmp_path / "one").mkdir()
    (other := tmp_path / "other").mkdir()
    write_chunks(one, period=0.02, execution="ensemble")
    write_chunks(other, period=0.03, execution="real_time")
    policies = {
        "left": {"path": str(one), "child": {"delay": 2}},
        "right": {"path": str(other), "child": {"delay": 3}},
    }
    legs = {"left": ["FL_*", "RL_*"], "right": ["FR_*", "RR_*"]}
    flow = {"zip": [{"policy": {"policy": key, "drives": legs[key]}} for key in legs]}
    values = chunked(tmp_path, policies=policies, flow=flow)
    hashes = {run(values, 0.4)[0].sha256_commands for _ in range(2)}
    alone = chunked(tmp_path, policies=policies, flow={"policy": "left"})
    assert len(hashes) == 1
    assert run(alone, 0.4)[0].sha256_commands not in hashes
