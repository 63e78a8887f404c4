"""The dance of the assets: from an import of twelve lines, and in a workflow between two walks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from unicon_core.check.twin.perturb import Change
from unicon_core.check.twin.session import TwinSession
from unicon_core.runtime import Report, Runner, RunOptions
from unicon_core.workflow import Program, load_workflow
from unicon_core.workflow.document import load_document

pytest.importorskip("mujoco", reason="the dance needs mujoco")
pytest.importorskip("onnxruntime", reason="the policies need onnxruntime")

NOISE = (
    "scene.noise={joint_pos: 0.005, joint_vel: 0.1, base_ang_vel: 0.05, projected_gravity: 0.02}"
)
ALONE = ["flow={policy: dance}", "scene.initial_pose=policy:dance", "duration=34.0"]


def run(overrides: Sequence[str] = ()) -> tuple[Report, Program]:
    program = load_workflow("g1_dance", overrides)
    return Runner(program, RunOptions(speed="max")).run(), program


def test_the_import_has_at_most_twelve_lines() -> None:
    lines = load_document("g1_dance").path.read_text(encoding="utf-8").splitlines()
    begin = next(i for i, line in enumerate(lines) if line.strip() == "dance:")
    end = next(i for i, line in enumerate(lines) if i > begin and not line.strip())
    given = [line for line in lines[begin:end] if line.startswith("      ")]
    assert 3 < len(given) <= 12


@pytest.mark.parametrize("noise", [(), (NOISE,)], ids=["ideal", "noise"])
def test_the_dance_stays_upright_for_thirty_seconds(noise: tuple[str, ...], assets: Path) -> None:
    """The joints follow within 0.2 rad, the torso within 0.15; beyond the leap at 29 s."""
    program = load_workflow("g1_dance", [*ALONE, *noise, "policies.dance.given.motion.end=40.0"])
    errors = []
    runner = Runner(program, RunOptions(speed="max"))
    runner.reset()
    while len(errors) < 1700 and not runner.tick(0):
        errors.append(program.states["dance_motion_error"].copy())
        assert program.states["projected_gravity"][2] < -0.5
    program.close()
    assert len(errors) == 1700
    joints, anchor = np.mean(errors, axis=0)
    assert 0.02 < joints < 0.2
    assert 0.01 < anchor < 0.15


def test_the_twin_scores_the_dance_by_its_motion(assets: Path) -> None:
    """As given it follows; looking at the wrong joints it is off, though it may stay up."""
    session = TwinSession(load_document("g1_dance", [*ALONE, "commands=[]"]))
    try:
        (contract,) = session.contracts.values()
        given = session.run(2.0)
        left = tuple(name.replace("left", "LEFT") for name in contract.joints)
        other = [n.replace("right", "left").replace("LEFT", "right") for n in left]
        broken = session.run(2.0, "dance", Change("", "", replace(contract, joints=tuple(other))))
    finally:
        session.close()
    assert given.follows
    assert given.stands
    assert given.motion_error is not None
    assert given.motion_error < 0.2
    assert given.tracking > 0.5
    assert broken.motion_error is not None
    assert broken.motion_error > 2.0 * given.motion_error
    assert broken.score < given.score - 0.2


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_stand_walk_dance_walk_does_not_fall_in_twenty_seeds(assets: Path) -> None:
    for seed in range(20):
        report, program = run(
            [NOISE, "scene.push={every: 3.0, velocity: 0.2}", f"scene.seed={seed}"]
        )
        assert not report.faults, (seed, report.faults)
        assert not report.fell, seed
        assert report.ended == "done", seed
        assert report.duration_s == pytest.approx(41.5, abs=0.1)
        assert float(program.states["dance_motion_time"]) == pytest.approx(27.0, abs=0.021)
        assert report.base_displacement_m[0] > 2.0  # both walks


def test_dance_and_return_come_in_without_a_jump(assets: Path) -> None:
    """At each change of policy the targets go on as before, and by far more without the block."""

    def jumps(overrides: Sequence[str]) -> list[float]:
        motion = [f"policies.dance.given.motion.{said}" for said in ("hold=0", "end=0.6")]
        program = load_workflow("g1_dance", [*overrides, *motion])
        states = program.states
        runner = Runner(program, RunOptions(speed="max"))
        runner.reset()
        found, target, time, ends = [], states["joint_pos_target"].copy(), 0.0, False
        done = False
        while not done:
            done = bool(runner.tick(0))
            now = float(states["dance_motion_time"])
            change = float(np.abs(states["joint_pos_target"] - target).max())
            dances = now != time
            if dances is not ends:
                found.append(change)
            ends, time, target = dances, now, states["joint_pos_target"].copy()
        program.close()
        return found

    parts = [
        "{zip: [{velocity_command: {constant: [0, 0, 0], duration: 1.0}}, {policy: walk}]}",
        "{zip: [{policy: dance}%s]}",
        "{zip: [{velocity_command: {constant: [0, 0, 0], duration: 1.0}}, {policy: walk}%s]}",
    ]
    flow = "flow={chain: [" + ", ".join(parts) + "]}"
    blend = ", {blend_in: 0.5}"
    smooth, hard = jumps([flow % (blend, blend)]), jumps([flow % ("", "")])
    assert len(smooth) >= 2
    assert max(smooth[-2:]) < 0.1
    assert max(hard[-2:]) > 3 * max(smooth[-2:])


@pytest.mark.slow
def test_the_dance_is_the_same_at_real_rate(assets: Path) -> None:
    shas = []
    for speed in ("max", "real"):
        program = load_workflow("g1_dance", [*ALONE[:-1], "duration=4.0"])
        shas.append(Runner(program, RunOptions(speed=speed)).run().sha256_commands)
    assert shas[0] == shas[1]
