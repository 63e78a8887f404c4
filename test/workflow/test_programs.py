"""Programs in Python: ten lines walk, files say the same, and mistakes name their line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import unicon_core
from unicon_base.errors import CheckError
from unicon_core import (
    Amends,
    Block,
    Chain,
    Loop,
    Program,
    Reads,
    Report,
    Stage,
    StateSpec,
    Switch,
    UniconError,
    Zip,
    block,
    elapsed,
    policy,
    pose,
    run,
)
from unicon_core.flow import Tick, blocks_of
from unicon_core.runtime import Runner, RunOptions
from unicon_core.runtime.phases import Phase
from unicon_core.workflow import HookBlocks, load_workflow

FAKE = {"robot": "go2", "platform": "fake", "rate": 100}


def fast(program: Program) -> Report:
    return run(program, speed="max", warn=lambda line: None)


def test_ten_lines_walk() -> None:
    program = Program(
        robot="go2",
        platform="mujoco",
        rate=50,
        policies={"walk": "go2_velocity"},
        commands=[block("velocity_command", constant=[0.5, 0.0, 0.0])],
        flow=Chain(pose("stand"), Loop(policy("walk"), until=elapsed(10))),
        safety=["finite", "joint_limits", "tilt_stop"],
    )
    report = fast(program)
    assert (report.faults, report.ended, report.ticks) == ([], "done", 600)
    assert report.base_displacement_m[0] > 3.5
    assert program.name == "test_programs"


def test_a_program_and_a_file_send_the_same_commands(tmp_path: Path) -> None:
    path = tmp_path / "same.yaml"
    path.write_text(
        "{robot: go2, platform: fake, rate: 100,\n"
        " commands: [{velocity_command: {constant: [1, 0, 0]}}],\n"
        " flow: {chain: [{pose: {to: rest, duration: 0.5}},\n"
        "  {loop: {do: {sway: {gains: {'*_hip_joint': [1, 0, 0]}}}, until: 'tick > 80'}},\n"
        "  {switch: {on: 'tick > 90', blend: 0.1, cases: {a: hold, b: {hold: {duration: 0.3}}}}}]}}"
    )
    flow = Chain(
        pose("rest", duration=0.5),
        Loop(
            block("sway", gains={"*_hip_joint": [1, 0, 0]}),
            until=block("expression", "tick > 80"),
        ),
        Switch(
            block("expression", "tick > 90"),
            {"a": block("hold"), "b": block("hold", duration=0.3)},
            blend=0.1,
        ),
    )
    commands = [block("velocity_command", constant=[1, 0, 0])]
    mine, theirs = fast(Program(flow=flow, commands=commands, **FAKE)), fast(load_workflow(path))
    assert mine.sha256_commands == theirs.sha256_commands
    assert mine.ticks == theirs.ticks > 90


def test_functions_and_factories_of_ones_own_are_blocks() -> None:
    calls: list[str] = []

    def third_time() -> bool:
        calls.append("plain")
        return len(calls) == 3

    def nod(joint_pos: Reads, joint_pos_target: Amends, *, by: float) -> Tick:
        def tick() -> None:
            np.add(joint_pos, by, out=joint_pos_target)

        return tick

    program = Program(flow=Zip(block("hold"), block(nod, 0.01), third_time), **FAKE)
    nodding = next(b for b in program.blocks if b.name == "nod")
    assert (nodding.reads, nodding.amends) == (("joint_pos",), ("joint_pos_target",))
    assert fast(program).ticks == 3


@pytest.mark.parametrize(
    ("described", "message"),
    [
        ({"flow": pose("stand", speed=2)}, r"test_programs\.py:\d+: block 'pose' has no option"),
        ({"flow": block("pos")}, r"test_programs\.py:\d+: unknown block 'pos'"),
        ({"flow": policy("walk")}, r"test_programs\.py:\d+: no policy 'walk'"),
        ({"flow": block("hold"), "rats": 5}, r"test_programs\.py:\d+: unknown key 'rats'"),
        ({"flow": pose("stand"), "platform": "fak"}, r"unknown platform 'fak'"),
        ({}, r"test_programs\.py:\d+: missing key 'flow'"),
        ({"flow": Chain(block("hold"), pose("stand"))}, r"'pose' can never be reached"),
        ({"flow": 5}, r"a block is a word or a mapping with one key"),
    ],
)
def test_mistakes_name_their_line(described: dict[str, object], message: str) -> None:
    with pytest.raises(UniconError, match=message):
        Program(**{**FAKE, **described})


def test_what_check_calls_an_error_does_not_run_in_python_either() -> None:
    safety = [block("joint_limits", states={"joint_pos_target": "joint_vel_target"})]
    program = Program(flow=pose("stand"), safety=safety, **FAKE)
    with pytest.raises(CheckError, match="is not run"):
        run(program)
    assert program.gate.closed


def test_a_use_that_nobody_built_says_so() -> None:
    with pytest.raises(UniconError, match=r"'pose' is not built yet; give the flow to a Program"):
        pose("stand")()


def test_stages_are_in_order_and_every_block_knows_its_own() -> None:
    def hook(program: Program) -> HookBlocks:
        return {stage: [Block(stage.value, bool, endless=True)] for stage in Stage}

    flow = Loop(block("hold"), until=elapsed(1.0))
    safety = ["finite", {"when": {"if": "tick > 1", "do": "joint_limits"}}]
    program = Program(
        flow=flow, safety=safety, commands=["velocity_command: {}"][:0], hooks=[hook], **FAKE
    )
    stages = list(Stage)
    ordered = [block.stage for block in blocks_of(program.root)]
    assert None not in ordered
    places = [stages.index(stage) for stage in ordered if stage is not None]
    assert places == sorted(places)
    assert {b.stage for n in program.stages[Stage.SAFETY] for b in blocks_of(n)} == {Stage.SAFETY}
    program.close()


def test_a_command_that_an_observer_writes_is_refused() -> None:
    late = Block("late", bool, amends=("joint_pos_target",))
    with pytest.raises(UniconError, match="'late' writes 'joint_pos_target' behind 'send'"):
        Program(flow=block("hold"), hooks=[lambda _: {Stage.OBSERVE: [late]}], **FAKE)


# -- phases -------------------------------------------------------------------------------------


def test_the_report_counts_the_run_alone_and_the_wind_down_goes_through_safety() -> None:
    flow = Loop(pose("stand"), until=elapsed(0.5))
    plain = fast(Program(flow=flow, **FAKE))
    seen: list[tuple[Phase, float]] = []

    def hook(program: Program) -> HookBlocks:
        target = program.states["joint_pos_target"]
        look = Block("look", lambda: seen.append((runner.phase, float(target[1]))))
        return {Stage.SAFETY: [look]}

    program = Program(flow=flow, wind_down=pose("rest", duration=0.4), hooks=[hook], **FAKE)
    runner = Runner(program, RunOptions(speed="max"))
    report = runner.run()
    assert (report.sha256_commands, report.ticks) == (plain.sha256_commands, plain.ticks)
    assert report.ended == "done"
    assert runner.phase is Phase.OFF
    down = [value for phase, value in seen if phase is Phase.SOFT]
    assert len(down) == 40
    assert down[-1] == pytest.approx(float(program.robot.rest_joint_pos[1]), abs=1e-3)


def test_a_wind_down_that_never_ends_is_bounded() -> None:
    ticks: list[Phase] = []

    def hook(program: Program) -> HookBlocks:
        return {Stage.OBSERVE: [Block("look", lambda: ticks.append(runner.phase))]}

    flow = Loop(pose("stand"), until=elapsed(0.1))
    program = Program(flow=flow, wind_down=block("hold"), hooks=[hook], **FAKE)
    runner = Runner(program, RunOptions(speed="max"))
    runner.run()
    assert ticks.count(Phase.SOFT) == 500  # 5 s


def test_nothing_is_compiled_between_run_and_wind_down(monkeypatch: pytest.MonkeyPatch) -> None:
    flow = Loop(pose("stand"), until=elapsed(0.1))
    program = Program(flow=flow, wind_down=pose("rest", duration=0.4), **FAKE)
    runner = Runner(program, RunOptions(speed="max"))
    monkeypatch.setattr("unicon_core.runtime.ticker.compile_graph", None)  # a robot would wait
    report = runner.run()
    assert (report.faults, report.ticks) == ([], 10)
    rest = float(program.robot.rest_joint_pos[1])
    assert float(program.states.joint_pos_target[1]) == pytest.approx(rest, abs=1e-3)


def test_after_a_fault_nothing_winds_down() -> None:
    def hook(program: Program) -> HookBlocks:
        return {Stage.SAFETY: [Block("trip", trip, reads=("tick",))]}

    def trip() -> None:
        if runner.statistics.count == 5:
            raise UniconError("tripped")
        assert runner.phase is Phase.RUN

    program = Program(flow=block("hold"), wind_down=pose("rest"), hooks=[hook], **FAKE)
    runner = Runner(program, RunOptions(speed="max"))
    report = runner.run()
    assert "tripped" in report.faults[0]
    assert report.ended == "fault"


# -- the package --------------------------------------------------------------------------------


def test_the_package_exports_its_names_lazily() -> None:
    import subprocess
    import sys

    assert len(unicon_core.__all__) == 26
    for name in unicon_core.__all__:
        assert getattr(unicon_core, name) is not None
    code = "import sys, unicon_core; print([m for m in ('numpy', 'yaml') if m in sys.modules])"
    assert subprocess.check_output([sys.executable, "-c", code], text=True).strip() == "[]"
    with pytest.raises(AttributeError, match="no attribute 'nope'"):
        unicon_core.nope  # noqa: B018


def test_a_state_of_ones_own_may_be_a_specification() -> None:
    spec = StateSpec((2,), "float32", "rad", names=("a", "b"), initial=0.5)
    program = Program(flow=block("hold"), states={"phase": spec}, **FAKE)
    assert program.states.layout.specs["phase"] == spec
    program.close()
