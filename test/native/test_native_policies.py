"""Policies in native ticks: observation, network, action and memory against Python's."""

from __future__ import annotations

import gc
import json
import os
import shutil
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.samples import random_policy
from unicon_base.errors import Fault
from unicon_core.flow import Zip, as_block, compile_graph
from unicon_core.memory import Memory
from unicon_core.native import network, tick
from unicon_core.native.build import COMPILERS
from unicon_core.native.operands import NotNative
from unicon_core.native.tick import NativeTick
from unicon_core.policies import Policy, load_policy, policy_states
from unicon_core.robots import load_robot
from unicon_core.states import States, standard_states

ROBOT = load_robot("go2")
pytestmark = pytest.mark.skipif(
    not any(map(shutil.which, COMPILERS)), reason="no C++ compiler (apt install g++)"
)
pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")

VARIANTS: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "plain": ({}, {}),
    "history": ({"history": 4}, {}),
    "zeros at first": ({"history": 3}, {"observation": {"start": "zeros"}}),
    "recurrent": ({"recurrent": True}, {}),
    "clipped targets": ({}, {"action": {"clip": [-0.2, 0.3]}}),
    "clipped action": (
        {"history": 2, "recurrent": True},
        {"action": {"clip": [-0.2, 0.3], "feedback": "clipped"}},
    ),
}


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))


class World:
    def __init__(self, folder: Path, variant: str = "plain") -> None:
        options, changes = VARIANTS[variant]
        random_policy(folder, ROBOT, **options)
        document = json.loads((folder / "policy.yaml").read_text())
        for key, words in changes.items():
            document[key] |= words
        (folder / "policy.yaml").write_text(json.dumps(document))
        contract = load_policy(folder / "policy.yaml")
        names = ROBOT.joint_names
        self.states = States({**standard_states(names), **policy_states(contract, names)})
        self.policy = Policy(contract, self.states, ROBOT)
        self.root = Zip(as_block(self.policy))
        self.memory = Memory({"policy": self.policy})

    def ticks(self, graph: Any, first: int = 0) -> list[Any]:
        random, seen = np.random.default_rng(first), []
        for number in range(first, 16):
            for name in ("joint_pos", "joint_vel", "base_ang_vel", "velocity_command"):
                self.states[name][...] = random.normal(size=self.states[name].shape)
            if number == 11:
                self.states["joint_vel"][3] = np.nan
            graph.warm_up()
            try:
                said = str(graph.step() or graph.deferred())
            except Fault as fault:
                said = str(fault)
                graph.reset()
            self.states["joint_vel"][3] = 0.0
            seen.append((said, self.states.snapshot().data, str(self.memory.take())))
        return seen


@pytest.mark.parametrize("variant", VARIANTS)
def test_policies_give_the_same_bits(variant: str, tmp_path: Path) -> None:
    fast, slow = World(tmp_path / "a", variant), World(tmp_path / "a", variant)
    graph = NativeTick(fast.states, pytest.fail).compile(fast.root, trace=True)
    assert "network()" not in graph.source  # it runs inside the stretch
    found, expected = fast.ticks(graph), slow.ticks(compile_graph(slow.root, trace=True))
    assert found == expected
    assert "joint_vel" in found[11][0]


@pytest.mark.parametrize("from_native", [False, True])
def test_memory_goes_from_one_to_the_other(from_native: bool, tmp_path: Path) -> None:
    worlds = [World(tmp_path / "a", "clipped action") for _ in range(2)]
    graphs = [
        NativeTick(worlds[0].states, pytest.fail).compile(worlds[0].root),
        compile_graph(worlds[1].root),
    ]
    if not from_native:
        worlds.reverse()
        graphs.reverse()
    worlds[0].ticks(graphs[0])
    worlds[1].states.restore(worlds[0].states.snapshot())
    worlds[1].memory.put_back(worlds[0].memory.take())
    assert worlds[0].ticks(graphs[0], 12) == worlds[1].ticks(graphs[1], 12)


def test_without_the_shared_library_python_runs_the_network(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def missing() -> None:
        raise NotNative("none")

    monkeypatch.setattr(network, "_table", missing)
    fast, slow = World(tmp_path / "a", "history"), World(tmp_path / "a", "history")
    graph = NativeTick(fast.states, pytest.fail).compile(fast.root)
    assert "network()" in graph.source
    assert fast.ticks(graph) == slow.ticks(compile_graph(slow.root))


def test_python_runs_a_network_in_whose_place_stands_something_else(tmp_path: Path) -> None:
    fast, slow = World(tmp_path / "a"), World(tmp_path / "a")
    for world in (fast, slow):

        def infer(lane: Any = world.policy.lane, own: Any = world.policy.lane.infer) -> None:
            own()
            lane.action[0] = 0.25

        world.policy.lane.infer = infer
    graph = NativeTick(fast.states, pytest.fail).compile(fast.root)
    assert "network()" in graph.source
    assert fast.ticks(graph) == slow.ticks(compile_graph(slow.root))


def test_a_network_that_computes_otherwise_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tick, "compare", lambda *_: False)
    warnings: list[str] = []
    fast, slow = World(tmp_path / "a"), World(tmp_path / "a")
    graph = NativeTick(fast.states, warnings.append).compile(fast.root)
    assert "other bits by ONNX Runtime's C interface" in warnings[0]
    assert fast.ticks(graph) == slow.ticks(compile_graph(slow.root))


def test_a_tick_allocates_nothing_that_grows(tmp_path: Path) -> None:
    world = World(tmp_path / "a", "history")
    graph = NativeTick(world.states, pytest.fail).compile(world.root)
    step = graph.step
    for _ in range(100):
        step()
    before = sys.getallocatedblocks()
    for _ in range(2000):
        step()
    assert sys.getallocatedblocks() - before < 10


def test_a_graph_that_goes_leaves_no_library_and_no_session(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    left = dict.fromkeys(network.RELEASES, 0)
    makes = network._made

    def made(stack: Any, name: str, *arguments: Any) -> Any:
        def gone() -> None:
            left[name] -= 1

        left[name] += 1
        stack.callback(gone)
        return makes(stack, name, *arguments)

    monkeypatch.setattr(network, "_made", made)
    files = []
    for _ in range(3):
        world = World(tmp_path / "a")
        NativeTick(world.states, pytest.fail).compile(world.root).step()
        assert left["CreateSession"] == 1
        del world
        gc.collect()
        files.append(len(os.listdir("/proc/self/fd")))
    assert files[0] == files[-1]
    assert not any(count for name, count in left.items() if name != "CreateEnv")
