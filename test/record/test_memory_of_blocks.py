"""Every registered block remembers what it declares, and nothing else."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from unicon_base.errors import Fault, StateError, WorkflowError
from unicon_core import Zip, pose
from unicon_core.blocks.controls.device import declares_controls
from unicon_core.check.memory_proof import prove
from unicon_core.flow import Block, Stage, compile_graph
from unicon_core.flow.compiled import CompiledGraph
from unicon_core.flow.nodes import unfused
from unicon_core.gates.build import first_command
from unicon_core.memory import Memory, Snapshot
from unicon_core.runtime import Runner, RunOptions
from unicon_core.states import StateSpec
from unicon_core.states.standard import forwarded_states, hardware_states
from unicon_core.testing import Bench
from unicon_core.workflow import Program, load_document, workflow_names
from unicon_core.workflow.live_twin import twin_states
from unicon_core.workflow.registry import known
from unicon_core.workflow.tick_tree import memory_of
from unicon_lab.recording.ticks import from_json, to_json

OPTIONS: dict[str, dict[str, Any]] = {
    "action_stop": {},
    "blend_in": {},
    "commanded": {},
    "command_stop": {},
    "copy": {"source": "joint_pos", "target": "joint_pos_target"},
    "damp": {"duration": 0.3},
    "effort_limits": {"scale": 0.3},
    "elapsed": {"seconds": 0.2},
    "encoder_stop": {},
    "excite": {"signal": "chirp"},
    "fade_in": {},
    "finite": {},
    "forward_command": {"integral": 2.0, "silent": "home", "start_tolerance": 0.2},
    "hardware_stop": {},
    "height_stop": {"lowest": 0.1},
    "hold": {"duration": 0.3},
    "imu_stop": {},
    "joint_limits": {},
    "joint_sensor_stop": {},
    "linear_map": {"source": "joint_vel", "target": "joint_effort_ff", "scale": -0.5},
    "motor_heat": {},
    "observation_range": {"file": "seen.npz"},
    "observation_stop": {"file": "known.npz"},
    "overrun_stop": {},
    "range_stop": {},
    "pose": {"to": "stand", "duration": 0.2, "fade_in": 0.1},
    "power_stop": {"limit": 900.0},
    "projected_gravity": {},
    "rate_limit": {},
    "remote_stop": {"on": ["L2", "B"]},
    "settled": {"velocity": 0.1},
    "stale_stop": {},
    "sway": {"gains": {"*": [0.1, 0.2, 0.3]}, "amplitude": [0.1, 0.2, 0.3]},
    "tilt_stop": {},
    "tilted": {},
    "tracking_stop": {},
    "twin_stop": {},
    "velocity_command": {"constant": [1, 2, 3], "ramp": 1.0},
    "velocity_limits": {"scale": 0.02},
    "velocity_stop": {},
}
"""Blocks that are built alone, with options that make them remember."""

DEVICES = {"camera", "external", "gamepad", "keyboard", "livox", "realsense", "webcam", "webxr"}
"""Blocks whose values come from outside; a record has them at their moment."""


class Ticks:
    """The compiled tick of a program."""

    def __init__(self, program: Program) -> None:
        self.program, self.graph = program, compile_graph(program.root)

    def graphs(self) -> dict[str, CompiledGraph]:
        return {"run": self.graph}

    def run(self, count: int) -> list[bytes]:
        """Return the states behind each tick, also of one that raised a fault."""
        found = []
        for _ in range(count):
            try:
                self.graph.step()
                self.graph.deferred()
            except Fault:
                self.graph.reset()
            found.append(self.program.states.buffer.tobytes())
        return found


@pytest.fixture
def program(at_hand: Callable[[str], None]) -> Iterator[Callable[..., Program]]:
    made: list[Program] = []

    def build(name: str, **overrides: Any) -> Program:
        at_hand(name)
        made.append(Program(load_document(name, overrides)))
        return made[-1]

    yield build
    for each in made:
        each.close()


def proven(blocks: list[Block], states: Any) -> set[str]:
    """Return the names of blocks, all of which are proven."""
    for block in blocks:
        proof = prove(block, states)
        assert (block.name, proof.hidden, proof.trouble) == (block.name, (), "")
        assert block.name == "overrun_stop" or not proof.undeclared  # which has a clock
    return {block.name.split(" of ")[0].rstrip(" 0123456789") for block in blocks}


def own(program: Program) -> list[Block]:
    """Return the blocks of a program that a snapshot holds."""
    blocks = [part for block in program.blocks for part in unfused(block)]
    return [
        block
        for block in blocks
        if block.stage not in (Stage.RECV, Stage.SEND) and not getattr(block.tick, "outside", False)
    ]


@pytest.mark.parametrize("name", OPTIONS)
def test_a_block_remembers_what_it_declares(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    np.savez("known.npz", lower=np.full(4, -9.0, np.float32), upper=np.full(4, 9.0, np.float32))
    robot = Bench().robot
    states = forwarded_states(robot.joint_names) | hardware_states(robot.joint_names)
    states |= twin_states(robot) | declares_controls()
    states |= {"observation": StateSpec((4,)), "action": StateSpec((4,))}
    bench = Bench(states=states)
    block = bench.block(name, **OPTIONS[name])
    assert Memory({name: block.tick}, bench.states.buffer).unproven == {}
    proven([block], bench.states)


@pytest.mark.parametrize("name", workflow_names())
def test_blocks_of_shipped_workflows_do(name: str, program: Callable[..., Program]) -> None:
    built = program(name, platform="fake")
    assert memory_of(built, Ticks(built).graphs()).unproven == {}
    proven(own(built), built.states)


def test_no_registered_block_is_left_out() -> None:
    there = {*OPTIONS, *DEVICES, "recorded"}  # whose replay is test_replay's
    there |= {"elevation_map", "grid_map"}  # see test_elevation_map, test_grid_map
    for name in workflow_names():
        text = load_document(name).path.read_text(encoding="utf-8")
        there |= {block for block in known("blocks") if block in text}
    assert set(known("blocks")) <= there


QUICK = {("go2_walk", None), ("go2_buttons", None), ("go2_stand", 16)}


@pytest.mark.parametrize(
    ("name", "batch"),
    [
        case if case in QUICK else pytest.param(*case, marks=pytest.mark.slow)
        for case in itertools.product(workflow_names(), (None, 16))
    ],
)
def test_what_is_restored_ticks_on_with_the_same_bytes(
    name: str, batch: int | None, program: Callable[..., Program]
) -> None:
    try:
        built = program(name, platform="mujoco", **({} if batch is None else {"num_robots": batch}))
    except WorkflowError as error:
        if batch is None:
            raise
        pytest.skip(f"it is for one robot: {error}")
    ticks = Ticks(built)
    memory = memory_of(built, ticks.graphs(), platform=built.platform)
    assert memory.unproven == {}
    ticks.run(150)
    states, snapshot = built.states.snapshot(), memory.take()
    written = from_json(to_json(snapshot))
    first = ticks.run(1000 if batch is None else 200)
    built.states.restore(states)
    memory.put_back(written)
    assert ticks.run(len(first)) == first


def written(folder: Path, values: dict[str, Any]) -> Path:
    path = folder / "switching.yaml"
    path.write_text(yaml.safe_dump(values), "utf-8")
    return path


SWITCHING: dict[str, Any] = {
    "schema": "unicon.workflow/1",
    "name": "switching",
    "robot": "go2",
    "platform": "mujoco",
    "rate": 50,
    "states": {"wanted": {"dtype": "int32", "initial": -1}},
    "skills": {
        "rise": {"do": {"pose": {"to": "stand", "duration": 0.4}}, "next": "stand"},
        "stand": {"do": "hold", "from": ["rise", "sit"], "blend": 0.3},
        "sit": {"do": {"loop": {"do": "damp", "until": "tick > 200"}}, "blend": 0.3},
    },
    "flow": {
        "chain": [{"loop": {"do": {"skills": {"on": "wanted"}}, "until": "tick > 150"}}, "hold"]
    },
    "safety": ["finite", "joint_limits", "rate_limit"],
    "wind_down": {"pose": {"to": {"*_thigh_joint": 1.2, "*_calf_joint": -2.4}, "duration": 0.5}},
}


@pytest.mark.parametrize("at", [1, 22, 27, 60, 63, 66])
def test_a_snapshot_in_the_middle_of_a_blend_or_a_swap_of_skills(at: int, tmp_path: Path) -> None:
    built = Program(load_document(written(tmp_path, SWITCHING)))
    try:
        ticks = Ticks(built)
        wish = {62: 2, 75: 1}  # sit, stand

        def run(first: int, last: int) -> list[bytes]:
            found = []
            for tick in range(first, last):
                built.states["wanted"][...] = wish.get(tick, built.states["wanted"])
                found += ticks.run(1)
            return found

        memory = memory_of(built, ticks.graphs(), platform=built.platform)
        assert memory.unproven == {}
        run(0, at)
        states, snapshot = built.states.snapshot(), memory.take()
        first = run(at, at + 90)
        built.states.restore(states)
        memory.put_back(from_json(to_json(snapshot)))
        assert run(at, at + 90) == first
        assert len(set(first)) == len(first)  # something moves
    finally:
        built.close()


def test_a_snapshot_in_the_middle_of_a_wind_down(tmp_path: Path) -> None:
    built = Program(load_document(written(tmp_path, SWITCHING)))
    try:
        runner = Runner(built, RunOptions(warn=str))
        graphs = runner.graphs()
        memory = memory_of(built, graphs, platform=built.platform)
        for _ in range(40):
            graphs["run"].step()
            graphs["run"].deferred()
        ending = graphs["soft"]

        def run(count: int) -> list[bytes]:
            found = []
            for _ in range(count):
                ending.step()
                ending.deferred()
                found.append(built.states.buffer.tobytes())
            return found

        run(7)
        states, snapshot = built.states.snapshot(), memory.take()
        first = run(15)
        built.states.restore(states)
        memory.put_back(snapshot)
        assert run(15) == first
    finally:
        built.close()


def test_the_memory_of_another_file_is_refused_with_what_differs(tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    one = Program(load_document(written(tmp_path, SWITCHING)))
    more = {**SWITCHING, "flow": "hold", "robot": "g1_29dof", "platform": "fake", "wind_down": None}
    del more["skills"]
    other = Program(load_document(written(tmp_path / "other", more)))
    try:
        memories = [
            memory_of(each, Ticks(each).graphs(), platform=each.platform) for each in (one, other)
        ]
        snapshot = memories[0].take()
        with pytest.raises(StateError, match=r"it has a block '.*', which this one lacks; this"):
            memories[1].put_back(snapshot)
        shared = Snapshot({key: each for key, each in snapshot.items() if key == "hold"})
        with pytest.raises(StateError, match=r"hold\._held is float32\[12\] in it and float32\[29"):
            memories[1].put_back(shared)
    finally:
        one.close()
        other.close()


class Counter:
    """A block that remembers and has no `reset`."""

    memory = ("count",)

    def __init__(self) -> None:
        self.count = 0

    def __call__(self) -> bool:
        self.count += 1
        return False


def test_asking_for_the_first_command_changes_no_memory() -> None:
    counter = Counter()
    program = Program(robot="go2", platform="fake", rate=50, flow=Zip(counter, pose("stand")))
    try:
        program.platform.recv()
        first_command(program)
        assert counter.count == 0
    finally:
        program.close()
