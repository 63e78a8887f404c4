"""Recordings of whole runs: every state of every tick, which replays bit-exactly, at any moment."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

pytest.importorskip("rosbags")

from replaying import replay

from unicon_base.errors import Fault, StateError
from unicon_core.flow import Block, Stage
from unicon_core.policies import load_policy
from unicon_core.runtime import Runner, RunOptions
from unicon_core.workflow import HookBlocks, Program, WorkflowDocument, load_document
from unicon_lab.fault_record import FaultRecord
from unicon_lab.recording import Record, open_record
from unicon_lab.recording.run_recording import Recording

FLOW = {"chain": [{"pose": {"duration": 0.4}}, "hold"]}


def written(folder: Path, **more: Any) -> Path:
    """Write a workflow for the fake go2."""
    values = {
        "schema": "unicon.workflow/1",
        "robot": "go2",
        "platform": "fake",
        "rate": 50,
        "duration": 2.0,
        "flow": FLOW,
    }
    path = folder / "workflow.yaml"
    path.write_text(yaml.safe_dump(values | more, sort_keys=False), "utf-8")
    return path


def recorded(
    workflow: str | Path,
    file: Path,
    hooks: tuple[Callable[[Program], Any], ...] = (),
    faults: str = "off",
    act: Callable[[Runner], object] = bool,
    part: str = "",
    declare: Callable[[WorkflowDocument], object] = bool,
    **options: Any,
) -> tuple[Record, dict[str, Any]]:
    """Record a run at full speed; return the record and what its report says of the recording."""
    warnings: list[str] = []
    recording = Recording(file, warn=warnings.append, patient=True)
    record = FaultRecord(faults, warnings.append, recording)
    document = load_document(workflow, {"platform": "fake"} | options)
    declare(document)
    program = Program(document, hooks=[*hooks, recording.hook, record.hook], part=part)
    runner = Runner(program, RunOptions(speed="max", warn=str))
    record.attach(runner)
    act(runner)
    report = runner.run()
    record.write(report)
    assert warnings == []
    return open_record(file), recording.counts()


def every_tick(into: list[bytes]) -> Callable[[Program], HookBlocks]:
    """Return a hook that keeps all states where a tick ends."""

    def hook(program: Program) -> HookBlocks:
        def keep() -> None:
            into.append(program.states.buffer.tobytes())

        return {Stage.OBSERVE: [Block("keep", keep)]}

    return hook


def noise(program: Program) -> HookBlocks:
    """Sensors that are noise, and say what they change."""
    rng = np.random.default_rng(3)
    names = ("joint_pos", "joint_vel")
    views = [program.states[name] for name in names]

    def disturb() -> None:
        for view in views:
            view += rng.normal(0.0, 0.05, view.shape).astype(np.float32)

    return {Stage.RECV: [Block("noise", disturb, amends=names)]}


def test_every_state_of_every_tick_is_in_it(tmp_path: Path) -> None:
    ticks: list[bytes] = []
    workflow = written(tmp_path)
    record, counts = recorded(workflow, tmp_path / "run.mcap", (noise, every_tick(ticks)))
    assert counts["dropped"] == 0
    assert len(record.ticks) == len(ticks) == 100
    assert record.ticks.tolist() == list(range(100))
    assert record.ended.all()
    for name, slot in record.layout.slots.items():
        there = record.states(name)
        for row, whole in enumerate(ticks):
            assert there[row].tobytes() == whole[slot.offset : slot.offset + slot.nbytes]
    assert set(record.kept) == {"received", "sent"}
    assert "joint_pos_target" not in record.kept["received"]
    assert record.states("joint_pos", "received").shape == (100, 12)
    with pytest.raises(StateError, match="no state 'joint_pos_target' at 'received', where"):
        record.states("joint_pos_target", "received")
    facts = record.facts
    assert facts["layout_hash"] == record.layout.hash
    assert facts["workflow_file"] == workflow.read_text("utf-8")
    assert json.loads(facts["options"]) == {"speed": "max", "duration": None}
    assert json.loads(facts["versions"])["numpy"] == np.__version__
    assert facts["seed"] == "0"
    assert replay(record) == []


def test_a_run_with_policy_input_and_reset_replays_to_the_bit(tmp_path: Path) -> None:
    pytest.importorskip("onnxruntime")
    rng = np.random.default_rng(5)
    runners: list[Runner] = []

    def given(program: Program) -> HookBlocks:
        command, tick = program.states["velocity_command"], program.states["tick"]

        def put() -> None:
            command[:] = rng.normal(0.0, 0.3, 3)
            if tick.flat[0] == 70:
                runners[0].call_soon(runners[0].reset)

        return {Stage.INPUT: [Block("given", put, amends=("velocity_command",))]}

    options = {"safety": ["finite"], "duration": 3.0, "flow.chain.0.pose.duration": 0.4}
    record, _ = recorded(
        "go2_walk", tmp_path / "run.mcap", (noise, given), act=runners.append, **options
    )
    assert record.kept["input"] == ("velocity_command", "tick")
    assert [each["before"] for each in record.memories if each["anew"]] == [71]
    assert {"memory.json", "memory-71.json"} <= set(record.files)
    assert len(record.ticks) >= 150
    assert set(record.phases) >= {"run"}
    assert replay(record) == []


def test_a_recording_that_a_fault_cuts_off_has_its_tick(tmp_path: Path) -> None:
    count = 0

    def faulty(program: Program) -> HookBlocks:
        def trip() -> None:
            nonlocal count
            count += 1
            if count > 40:
                raise Fault("tripped by the test")

        return {Stage.SAFETY: [Block("trip", trip)]}

    workflow, folder = written(tmp_path), tmp_path / "faults"
    record, _ = recorded(workflow, tmp_path / "run.mcap", (noise, faulty), str(folder))
    (path,) = folder.iterdir()
    fault = open_record(path)
    assert record.ended.tolist() == [True] * 40 + [False] == fault.ended.tolist()
    for name in record.layout.slots:
        assert record.states(name).tobytes() == fault.states(name).tobytes()
    assert replay(record) == []


def test_a_batch_and_a_part(tmp_path: Path) -> None:
    workflow = written(tmp_path, num_robots=3)
    record, _ = recorded(workflow, tmp_path / "batch.mcap", (noise,))
    assert record.states("joint_pos").shape == (100, 3, 12)
    assert replay(record) == []
    parts = {"robot": {"publishes": ["joint_pos"]}, "desk": {"publishes": ["velocity_command"]}}
    commands = [{"on": "desk", "velocity_command": {"constant": [0.1, 0.0, 0.0]}}]
    workflow = written(tmp_path, parts=parts, commands=commands, store="shm", name=f"r-{id(parts)}")
    record, _ = recorded(workflow, tmp_path / "part.mcap", part="robot")
    assert record.facts["part"] == "robot"
    assert replay(record) == []


def test_a_disk_that_drops_ticks_leaves_what_is_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("unicon_lab.recording.background.BLOCKS", 1)
    monkeypatch.setattr("unicon_lab.recording.background.BLOCK_BYTES", 40_000)
    warnings: list[str] = []
    recording = Recording(tmp_path / "run.mcap", warn=warnings.append)
    record = FaultRecord("off", recording=recording)
    document = load_document(written(tmp_path, duration=20.0))
    program = Program(document, hooks=[recording.hook, record.hook])
    runner = Runner(program, RunOptions(speed="max", warn=str))
    record.attach(runner)
    report = runner.run()
    found = open_record(tmp_path / "run.mcap")
    assert report.ticks == 1000
    assert 0 < len(found.ticks) < 1000
    assert recording.counts()["dropped"] >= 1000 - len(found.ticks)
    assert len(warnings) == 1
    assert found.states("tick").reshape(-1).tolist() == found.ticks.tolist()


def test_states_of_any_size_are_recorded(tmp_path: Path) -> None:
    states = {"huge": {"shape": [1 << 20]}}
    record, counts = recorded(written(tmp_path, states=states, duration=0.2), tmp_path / "r.mcap")
    assert len(record.ticks) == 10
    assert record.states("huge").shape == (10, 1 << 20)
    assert counts["dropped"] == 0


def test_other_layouts_are_fed_by_name(tmp_path: Path) -> None:
    record, _ = recorded(written(tmp_path, duration=0.2), tmp_path / "run.mcap")
    workflow = written(tmp_path, states={"mine": {"shape": [2]}, "joint_posture": {"shape": [3]}})
    program = Program(load_document(workflow))
    try:
        for row in (0, 7):
            program.states["joint_pos"][:] = 9.0
            record.feed("received", row, program.states)
            expected = record.states("joint_pos", "received")[row]
            assert program.states["joint_pos"].tobytes() == expected.tobytes()
        with pytest.raises(StateError, match="has no moment 'never'; known: "):
            record.feed("never", 0, program.states)
    finally:
        program.close()


def test_the_overlay_of_a_robot_is_in_it(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    overlay = tmp_path / "weak.yaml"
    text = "schema: unicon.robot/1\nextends: go2\nsimulated: {'*': {friction: 1.0}}\n"
    overlay.write_text(text, "utf-8")
    workflow = written(tmp_path, robot="./weak.yaml", scene={"initial_pose": "rest"}, duration=0.1)
    record, _ = recorded(workflow, tmp_path / "weak.mcap", platform="mujoco")
    assert record.facts["robot_overlay"] == text
    assert yaml.safe_load(record.facts["robot_file"])["name"] == "go2"
    assert replay(record) == []
    plain = {"robot": "go2"}
    (told,) = replay(record, overrides=plain)
    assert told == "robot go2: the recorded one was extended by an overlay, and this one is not"
    overlay.write_text(text.replace("1.0", "2.0"), "utf-8")
    (told,) = replay(record)
    assert told == f"robot go2: {overlay} is not the recorded overlay"
    record.facts["robot_overlay"] = ""  # type: ignore[index]
    assert replay(record) == [
        f"robot go2: {overlay} extends it, and the recorded one was not extended"
    ]
    del record.facts["robot_overlay"]  # type: ignore[attr-defined]
    assert replay(record) == []  # of an older record nobody knows


BRIEF = {"safety": ["finite"], "duration": 2.0, "flow.chain.0.pose.duration": 0.4}


def scaled_from_outside(file: Path, declared: bool) -> Record:
    """Record go2_walk while somebody makes its joints stiffer, as by the node's parameter."""
    from unicon_ros.parameters import Tuning

    tuning, tick = Tuning(), 0

    def scaled(program: Program) -> HookBlocks:
        def turn() -> None:
            nonlocal tick
            tick += 1
            scales = (1.3, 0.9) if tick > 60 else (1.0, 1.0)
            tuning.scales[0], tuning.scales[1] = scales

        stages = {stage: list(blocks) for stage, blocks in tuning.hook(program).items()}
        stages[Stage.INPUT].append(Block("turn", turn))
        return stages

    declare = tuning.declare if declared else bool
    record, _ = recorded("go2_walk", file, (noise, scaled), declare=declare, **BRIEF)
    assert "tuned" in record.moments
    stiffness = record.states("joint_stiffness")
    assert stiffness[70, 0] == np.float32(1.3) * stiffness[50, 0]
    return record


def stiffer(monkeypatch: pytest.MonkeyPatch, joints: slice) -> None:
    """Let the policy's joints be a tenth stiffer."""
    contract = load_policy("go2_velocity")
    stiffness = contract.stiffness.copy()
    stiffness[joints] *= 1.1
    other = replace(contract, stiffness=stiffness)
    monkeypatch.setattr("unicon_core.workflow.policies.load_policy", lambda *_, **__: other)


def test_gains_that_a_parameter_scales_are_scaled_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("onnxruntime")
    record = scaled_from_outside(tmp_path / "run.mcap", declared=True)
    scale = record.states("gain_scale")
    assert scale[50].tolist() == [1.0, 1.0]
    assert scale[70].tolist() == [1.3, 0.9]
    assert replay(record) == []
    assert replay(record, "go2_walk", {"platform": "fake", **BRIEF}) == []
    stiffer(monkeypatch, slice(None))  # all of them by one factor
    found = replay(record)
    assert found[0] == "first differs: tick 45 (45 s, phase run)"
    assert "state: joint_stiffness, FR_hip_joint" in found


def test_gains_that_were_scaled_untold_came_from_outside(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("onnxruntime")
    record = scaled_from_outside(tmp_path / "run.mcap", declared=False)
    (told,) = replay(record)
    assert told.startswith("the recorded gains are those of the workflow times 0.9, 1.3: scaled")
    stiffer(monkeypatch, slice(3, 4))
    found = replay(record)
    assert found[0] == "first differs: tick 45 (45 s, phase run)"
    assert "state: joint_stiffness, FL_hip_joint" in found
