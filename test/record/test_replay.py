"""Replay: a fresh program that gets a record's memory and inputs sends the same bytes."""

from __future__ import annotations

import gzip
import os
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

pytest.importorskip("onnxruntime", reason="the policies are ONNX networks")

from policies_of_all_kinds import KINDS, write_policy
from replaying import cut_off, replay

from unicon_base.errors import UniconError
from unicon_core.flow import Amends
from unicon_core.memory import Snapshot
from unicon_core.workflow import Program
from unicon_lab.recording import open_record
from unicon_lab.recording.ticks import to_json

pytestmark = pytest.mark.usefixtures("short_ring")

MORE = ("phase", "time_step")  # of the kinds of policies, in the slow tests
UNSAFE = {"safety": ["finite", "joint_limits", "rate_limit"]}  # noise would trip the others


def held(workflow: Any, folder: Path, ticks: int, **options: Any) -> None:
    """Cut a workflow off, and hold its replay against the record."""
    overrides = options.pop("overrides", UNSAFE)
    told = cut_off(workflow, folder, ticks, overrides=overrides, **options)
    record = told.record
    assert told.report.faults == ["tripped by the test"]
    assert all(not each["unproven"] for each in record.memories)
    assert int(record.ended.sum()) == len(record.ticks) - 1
    assert record.ticks.tolist() == list(range(ticks + 1))[-len(record.ticks) :]
    assert replay(record) == []


@pytest.mark.parametrize("ticks", [10, 149, 337])
def test_go2_walk(ticks: int, tmp_path: Path) -> None:
    behind_send = ["stale_stop", "imu_stop", "encoder_stop"]
    safety = {"safety": [*UNSAFE["safety"], *behind_send], "wind_down": None}
    held("go2_walk", tmp_path, ticks, overrides=safety)


@pytest.mark.parametrize("native", [False, True])
def test_native_and_python_ticks_replay_each_other(
    native: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    told = cut_off("go2_walk", tmp_path, 150, native=native)
    assert replay(told.record, native=not native) == []


def test_without_its_memory_a_replay_differs(tmp_path: Path) -> None:
    overrides = UNSAFE | {"flow.chain.0.pose.duration": 9.0}
    record = cut_off("go2_walk", tmp_path, 200, overrides=overrides).record
    for memory in record.memories:
        memory |= {"blocks": to_json(Snapshot())}
    assert replay(record)


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind not in MORE])
def test_a_policy_of_every_kind(kind: str, tmp_path: Path) -> None:
    folder = write_policy(tmp_path / kind, kind)
    workflow = written(tmp_path, {"policy": "walk"}, policies={"walk": str(folder)})
    held(workflow, tmp_path / "faults", 160)


@pytest.mark.parametrize("workflow", ["g1_walk", "g1_holosoma", "go1_walk", "go2_teleop"])
def test_other_peoples_policies(
    workflow: str, assets: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("UNICON_ASSETS", str(assets))
    safety = {"safety": ["finite", "joint_limits"], "wind_down": None}
    held(workflow, tmp_path, 130, overrides=safety, inputs=velocities)


def test_a_torchscript_policy_that_remembers(tmp_path: Path) -> None:
    pytest.importorskip("torch")
    from torch_modules import Lstm, write_torchscript  # type: ignore[import-not-found]

    folder = write_torchscript(tmp_path / "lstm", Lstm)
    workflow = written(tmp_path, {"policy": "walk"}, policies={"walk": str(folder)})
    held(workflow, tmp_path / "faults", 130)


def test_a_fault_in_the_wind_down(tmp_path: Path) -> None:
    ending = {"chain": [{"pose": {"to": "rest", "duration": 1.0}}, "hold"]}
    flow = {"chain": [{"pose": {"duration": 0.5}}, "hold"]}
    workflow = written(tmp_path, flow, duration=0.8, wind_down=ending)
    told = cut_off(workflow, tmp_path / "faults", 70)
    assert told.record.phases == ("run",) * 40 + ("soft",) * 31
    assert replay(told.record) == []


def test_a_platform_in_a_process_of_its_own(tmp_path: Path) -> None:
    workflow = written(tmp_path, {"chain": [{"pose": {"duration": 1.0}}, "hold"]})
    child = {"platform": {"child": "fake", "silence": 10}}
    told = cut_off(workflow, tmp_path / "faults", 60, overrides=child)
    assert len(told.record.ticks) == 61
    assert replay(told.record) == []  # in one process


def test_a_part_keeps_what_it_received(tmp_path: Path) -> None:
    parts = {"robot": {"publishes": ["joint_pos"]}, "desk": {"publishes": ["velocity_command"]}}
    commands = [{"on": "desk", "velocity_command": {"constant": [0.1, 0.0, 0.0]}}]
    flow = {"chain": [{"pose": {"duration": 1.0}}, "hold"]}
    workflow = written(
        tmp_path, flow, parts=parts, commands=commands, store="shm", name=f"record-{os.getpid()}"
    )
    told = cut_off(workflow, tmp_path / "faults", 60, part="robot")
    assert told.record.facts["part"] == "robot"
    assert replay(told.record) == []


def test_a_batch(tmp_path: Path) -> None:
    workflow = written(tmp_path, {"chain": [{"pose": {"duration": 1.0}}, "hold"]}, num_robots=3)
    held(workflow, tmp_path / "faults", 120)


def test_damping_leaves_the_oldest_tick_as_it_was(tmp_path: Path) -> None:
    gains = {"*_thigh_joint": [0.1, 0.0, 0.0]}
    flow = {"chain": [{"pose": {"duration": 1.0}}, {"sway": {"gains": gains}}]}
    workflow = written(tmp_path, flow)
    # The ring is full to the last tick: what comes next would take the place of the first.
    held(workflow, tmp_path / "faults", 174, inputs=velocities)


def test_a_topic_that_no_block_needs(tmp_path: Path) -> None:
    flow = {"chain": [{"pose": {"duration": 0.2}}, {"every": {"n": 3, "do": "hold"}}]}
    # What the topic gives is heard in the slack: nothing that is sent depends on it.
    held(written(tmp_path, flow), tmp_path / "faults", 174, inputs=velocities)


def test_what_stands_before_a_topic_is_computed_before_it(tmp_path: Path) -> None:
    def leaning(program: Program, rng: np.random.Generator) -> Callable[[], object]:
        return lambda: np.copyto(program.states["lean"], rng.normal(0.0, 0.4, 3))

    commands = [
        {"linear_map": {"source": "velocity_command", "target": "lean", "scale": 0.4}},
        {"copy": {"source": "lean", "target": "asked"}},
    ]
    cases = {"a": {"pose": {"to": "rest", "duration": 9.0}}, "b": "hold"}
    flow = {"switch": {"on": "lean[0] > 0.1", "cases": cases}}
    states = {"asked": {"shape": [3]}, "lean": {"shape": [3]}}
    workflow = written(tmp_path, flow, commands=commands, states=states)
    held(workflow, tmp_path / "faults", 60, inputs=leaning, amends="lean")


@pytest.mark.slow
@pytest.mark.parametrize("kind", MORE)
def test_a_policy_of_every_other_kind(kind: str, tmp_path: Path) -> None:
    test_a_policy_of_every_kind(kind, tmp_path)


@pytest.mark.slow
def test_many_random_flows(tmp_path: Path) -> None:
    for seed in range(4, 44):
        (tmp_path / str(seed)).mkdir()
        test_random_flows(seed, tmp_path / str(seed))


@pytest.mark.parametrize("seed", range(4))
def test_random_flows(seed: int, tmp_path: Path) -> None:
    """Chains, loops, switches that blend, every, when; ramps and schedules; a topic beside."""
    rng = random.Random(seed)
    policy = write_policy(tmp_path / "policy", rng.choice(KINDS))
    schedule = [[0.3 * i, *(round(rng.uniform(-0.3, 0.3), 2) for _ in range(3))] for i in range(9)]
    workflow = written(
        tmp_path,
        {
            "loop": {
                "do": {"chain": [*(some_flow(rng) for _ in range(3)), "hold"]},
                "until": {"elapsed": 99},
            }
        },
        policies={"walk": str(policy)},
        commands=[{"velocity_command": {"schedule": schedule, "ramp": rng.choice([0.5, None])}}],
    )
    ticks = rng.randint(60, 260)
    held(workflow, tmp_path / "faults", ticks, inputs=velocities if seed % 2 else None)


def velocities(program: Program, rng: np.random.Generator) -> Callable[[], object]:
    """Return a topic's work: now and then another velocity command."""
    command = program.states["velocity_command"]
    wanted = np.zeros(3, np.float32)

    def given() -> None:
        if rng.random() < 0.05:
            wanted[:] = rng.normal(0.0, 0.4, 3)
        command[...] = wanted

    return given


def written(folder: Path, flow: Any, **more: Any) -> Path:
    """Write a workflow for the fake go2."""
    values = {
        "schema": "unicon.workflow/1",
        "robot": "go2",
        "platform": "fake",
        "rate": 50,
        "flow": flow,
    }
    path = folder / "workflow.yaml"
    path.write_text(yaml.safe_dump(values | more, sort_keys=False), "utf-8")
    return path


def some_flow(rng: random.Random, depth: int = 0) -> Any:
    """Return a random flow of postures, policies and every kind of node."""
    kinds = ["pose", "hold", "sway", "policy", "damp"]
    if depth < 3:
        kinds += ["chain", "chain", "loop", "switch", "every", "when"] * (2 if depth < 2 else 1)
    kind = rng.choice(kinds)
    seconds = round(rng.uniform(0.1, 0.8), 2)
    if kind == "pose":
        return {"pose": {"to": rng.choice(["stand", "rest"]), "duration": seconds}}
    if kind in ("hold", "damp"):
        return {kind: {"duration": seconds}}
    if kind == "sway":
        gains = {"*_thigh_joint": [0.1, 0.0, 0.0]}
        return {"sway": {"gains": gains, "amplitude": [0.3, 0.0, 0.1], "duration": seconds}}
    if kind == "policy":
        return {"loop": {"do": {"policy": "walk"}, "until": {"elapsed": seconds}}}
    below = [some_flow(rng, depth + 1) for _ in range(rng.randint(2, 3))]
    if kind == "chain":
        return {"chain": below}
    if kind == "loop":
        return {"loop": {"do": below[0], "until": {"elapsed": seconds}}}
    if kind == "every":
        return {"every": {"n": rng.randint(2, 4), "do": below[0]}}
    if kind == "when":
        return {"when": {"if": "commanded", "do": below[0]}}
    blend = rng.choice([0, 0.1, 0.2])
    return {"switch": {"on": "commanded", "blend": blend, "cases": {"a": below[0], "b": below[1]}}}


def test_a_live_twin_goes_on_where_it_was(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    twin = {"twin": {"platform": "mujoco", "window": 0.14}}
    told = cut_off("go2_walk", tmp_path, 610, overrides=twin)
    assert told.record.ticks[0] % 7 != 1  # it begins within a window of the twin
    assert replay(told.record) == []


def test_the_record_of_an_older_version_is_read_and_its_replay_refused(tmp_path: Path) -> None:
    packed = Path(__file__).with_name("data") / "hold_0_3.mcap.gz"
    path = tmp_path / "hold.mcap"
    path.write_bytes(gzip.decompress(packed.read_bytes()))
    record = open_record(path)
    assert len(record.ticks) == 10
    assert np.isfinite(record.states("joint_pos")).all()
    with pytest.raises(UniconError, match=r"needs that version: pip install unicon_ros==0\.3\.0"):
        replay(record)


class Counting:
    """A user's block that remembers and does not say so."""

    def __init__(self, joint_effort_ff: Amends) -> None:
        self.effort, self.count = joint_effort_ff, 0

    def __call__(self) -> None:
        self.count += 1
        self.effort += np.float32(1e-3 * self.count)


def test_a_replay_names_blocks_that_declare_no_memory(tmp_path: Path) -> None:
    flow = {"zip": [{"hold": {}}, {"call": "test_replay:Counting"}]}
    record = cut_off(written(tmp_path, flow), tmp_path / "faults", 30).record
    (note,) = [each for each in replay(record) if "lacks the memory" in each]
    assert note == (
        "the record lacks the memory of block 'call' (declares no memory); unicon check names it"
    )
