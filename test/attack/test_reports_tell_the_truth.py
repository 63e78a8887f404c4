"""What a run says at its end: falls, simulated and wall time, and what ended it."""

from __future__ import annotations

from pathlib import Path

import pytest

from unicon_core.flow import Block, Stage
from unicon_core.runtime import Runner, RunOptions
from unicon_core.workflow import HookBlocks, Program, load_workflow

WORKFLOW = """\
robot: go2
platform: fake
rate: 50
duration: 4.0
flow: {hold: {}}
safety: [finite, joint_limits, {tilt_stop: {angle: 0.6}}]
"""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "told.yaml"
    path.write_text(WORKFLOW)
    return path


def test_a_run_that_leans_too_far_does_not_say_that_it_did_not_fall(path: Path) -> None:
    def lean(workflow: Program) -> HookBlocks:
        gravity, tick = workflow.states.projected_gravity, workflow.states.tick

        def tilted() -> None:
            if tick > 10:
                gravity[...] = (0.7, 0.0, -0.714)  # 44°: a fault, and not yet a fall

        return {Stage.INPUT: [Block("lean", tilted, amends=("projected_gravity",))]}

    report = Runner(load_workflow(path, hooks=[lean]), RunOptions(speed="max")).run()
    assert report.faults
    assert report.ended == "fault"
    assert "did not fall" not in report.summary()
    assert "FELL" not in report.summary()
    assert not report.fell


def test_simulated_and_wall_time_stand_apart(path: Path) -> None:
    report = Runner(load_workflow(path), RunOptions(speed="max")).run()
    assert report.duration_s == 4.0
    assert report.wall_s < 4.0
    lines = report.summary().splitlines()
    assert "ticks         200, 4.00 s of ticks" in lines
    (wall,) = [line for line in lines if line.startswith("wall time")]
    assert wall.startswith(f"wall time     {report.wall_s:.2f} s, ")
    assert "ended         duration" in lines
    assert "did not fall" in report.summary()


def test_the_largest_tilt_is_told(path: Path) -> None:
    def lean(workflow: Program) -> HookBlocks:
        gravity, tick = workflow.states.projected_gravity, workflow.states.tick

        def tilted() -> None:
            if 10 < tick < 20:
                gravity[...] = (0.5, 0.0, -0.8660254)

        return {Stage.INPUT: [Block("lean", tilted, amends=("projected_gravity",))]}

    report = Runner(load_workflow(path, hooks=[lean]), RunOptions(speed="max")).run()
    assert report.faults == []
    assert report.tilt_deg == pytest.approx(30.0, abs=0.2)
    assert "tilted up to 30°, did not fall" in report.summary()


def test_a_base_that_sinks_upright_is_told(path: Path) -> None:
    def sink(workflow: Program) -> HookBlocks:
        base, tick = workflow.states.base_pos_w, workflow.states.tick

        def lowered() -> None:
            base[2] = 0.3 if tick < 10 else 0.02

        return {Stage.INPUT: [Block("sink", lowered, amends=("base_pos_w",))]}

    report = Runner(load_workflow(path, hooks=[sink]), RunOptions(speed="max")).run()
    assert (report.fell, report.sank) == (False, True)
    assert "did not fall, sank by 0.28 m" in report.summary()


def test_a_fixed_base_neither_falls_nor_moves(path: Path) -> None:
    """An arm whose platform says any gravity: nothing of it can fall."""

    def lean(workflow: Program) -> HookBlocks:
        gravity = workflow.states.projected_gravity

        def tilted() -> None:
            gravity[...] = (1.0, 0.0, 0.0)  # mounted on a wall

        return {Stage.INPUT: [Block("lean", tilted, amends=("projected_gravity",))]}

    path.write_text("robot: arx_x5\nplatform: fake\nrate: 50\nduration: 0.2\nflow: {hold: {}}\n")
    report = Runner(load_workflow(path, hooks=[lean]), RunOptions(speed="max")).run()
    assert report.ended == "duration"
    assert (report.fell, report.base_displacement_m, report.tilt_deg) == (None, None, None)
    (base,) = [line for line in report.summary().splitlines() if line.startswith("base")]
    assert base == "base          fixed"
