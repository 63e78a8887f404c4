"""The recurrent network of `unicon bench policy` remembers, and differs by nothing else."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from benchmarks import loops
from benchmarks.samples import random_policy
from unicon_core.policies import Policy, policy_states
from unicon_core.robots import load_robot
from unicon_core.states import States, standard_states
from unicon_ros.bench.report import Bench

pytest.importorskip("onnx", reason="writes the networks")
pytest.importorskip("onnxruntime", reason="runs the networks")


def test_only_the_recurrent_one_remembers(tmp_path: Path) -> None:
    robot, actions = load_robot("go2"), {}
    for name in ("plain", "recurrent"):
        contract = random_policy(tmp_path / name, robot, recurrent=name == "recurrent")
        specs = standard_states(robot.joint_names) | policy_states(contract, robot.joint_names)
        states = States(specs)
        states["joint_vel"][...] = 1.0
        policy, taken = Policy(contract, states, robot), []
        for _ in range(3):
            states["action"][...] = 0.0
            policy()
            taken.append(states["action"].copy())
        actions[name] = taken
    plain, recurrent = actions["plain"], actions["recurrent"]
    assert plain[0].tobytes() == plain[1].tobytes()
    # Before the first call the memory is zero: the same network.
    np.testing.assert_allclose(recurrent[0], plain[0], rtol=1e-5, atol=1e-6)
    assert (recurrent[1] != recurrent[0]).any()
    assert (recurrent[2] != recurrent[1]).any()


def test_a_tick_of_chunks_stands_beside_the_same_one_without_a_child(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if len(os.sched_getaffinity(0)) < 2:
        pytest.skip("a core for the tick, and one for the child")
    monkeypatch.setattr(loops, "SECONDS", 0.5)
    before = os.sched_getaffinity(0)
    bench = Bench("policy", 2)
    loops._chunks(bench, load_robot("go2"), tmp_path)
    assert os.sched_getaffinity(0) == before
    assert bench.facts["chunk_tick_p99, answers of the child"] >= 4
    assert bench.ratios["chunk_tick_p99"]["bar"] == 1.1
    assert {loops.BESIDE, loops.BESIDE_NONE} <= bench.cases.keys()
