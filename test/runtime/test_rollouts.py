"""Rollouts: a program that began anew does bit-exactly what one does that was newly built."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from unicon_base.errors import UniconError
from unicon_core.flow import Block, Stage
from unicon_core.runtime import Runner, RunOptions
from unicon_core.runtime.rollouts import Rollout, Rollouts
from unicon_core.workflow import HookBlocks, Program, load_document
from unicon_core.workflow.document import WorkflowDocument

pytest.importorskip("mujoco")

TICKS = 50
WALK: dict[str, Any] = {
    "flow": {"policy": "walk"},
    "scene.initial_pose": "policy:walk",
    "commands": [{"velocity_command": {"constant": [0.8, 0.0, 0.0]}}],
    "scene.push.every": 0.3,
    "scene.push.velocity": 0.3,
    "scene.noise.joint_vel": 0.1,
}
ROUGH = {"height": 0.1, "extent": 10.0, "flat": 1.0}
KINDS: dict[str, dict[str, Any]] = {
    "as it was": {},
    "seed": {"scene.seed": 7},
    "push": {"scene.push.velocity": 1.0},
    "noise": {"scene.noise": {"base_quat": 0.01}},
    "delay": {"scene.delay": 2},
    "joint delay": {'scene.joints."*".delay': 0.006},
    "strength": {'scene.joints."*".strength': 0.7},
    "joint friction": {'scene.joints."*".friction': 0.5},
    "armature": {'scene.joints."*".armature': 0.05},
    "payload": {"scene.payload.mass": 4.0},
    "payload aside": {"scene.payload": {"mass": 4.0, "position": [0.1, 0.05, 0.1]}},
    "contact friction": {"scene.contact_friction": 0.3},
    "rough": {"scene.terrain.rough": ROUGH},
    "rough, another seed": {"scene.terrain.rough": ROUGH, "scene.seed": 7},
    "patches": {
        "scene.terrain.patches": {"friction": 0.05, "extent": 6.0, "flat": 1.0, "size": 0.5}
    },
    "pose": {"scene.initial_pose": {"FL_calf_joint": -1.4}},
    "height": {"scene.initial_height": 0.6},
}


def document(**changed: Any) -> WorkflowDocument:
    return load_document("go2_walk", WALK | changed)


@pytest.fixture(scope="module")
def warm() -> Iterator[Rollouts]:
    rollouts = Rollouts(Program(document()))
    yield rollouts
    rollouts.program.close()


def cold(changed: dict[str, Any]) -> tuple[str, np.ndarray[Any, Any]]:
    program = Program(document(**changed))
    report = Runner(program, RunOptions(speed="max", duration=TICKS * program.period)).run()
    assert report.ticks == TICKS
    return report.sha256_commands, program.states.buffer.copy()


def again(rollouts: Rollouts, changed: dict[str, Any]) -> Rollout:
    rollouts.begin(document(**changed))
    return rollouts.run(TICKS)


@pytest.mark.parametrize("kind", KINDS)
def test_begun_anew_equals_built_anew(warm: Rollouts, kind: str) -> None:
    again(warm, KINDS["strength"] | KINDS["payload aside"] | KINDS["delay"])  # what was before
    rollout = again(warm, KINDS[kind])
    digest, states = cold(KINDS[kind])
    assert rollout.sha256_commands == digest
    assert rollout.ended == "duration"
    assert (warm.program.states.buffer == states).all()


def test_two_kinds_differ(warm: Rollouts) -> None:
    hashes = {again(warm, changed).sha256_commands for changed in KINDS.values()}
    assert len(hashes) == len(KINDS)


def test_the_rows_are_the_states_behind_each_tick(warm: Rollouts) -> None:
    rollout = again(warm, {})
    place = warm.program.states.offset("joint_pos")
    last = rollout.states[-1, place : place + 12]
    assert (last == warm.program.states["joint_pos"]).all()
    assert rollout.states.shape[0] == rollout.ticks == TICKS


def test_a_fault_names_its_block(warm: Rollouts) -> None:
    warm.begin(document(**{"scene.push.velocity": 30.0}))
    rollout = warm.run(500)
    assert (rollout.ended, rollout.block) == ("fault", "tilt_stop")
    assert "the base leans" in rollout.fault
    assert again(warm, {}).sha256_commands == cold({})[0]  # nothing of it stays


def test_a_look_ends_it() -> None:
    looked: list[int] = []

    def make(states: object) -> Any:
        looked.append(0)

        def look() -> bool:
            looked[-1] += 1
            return looked[-1] == 5

        return look

    rollouts = Rollouts(Program(document()), make)
    assert [rollouts.run(TICKS).ticks, again(rollouts, {}).ticks] == [5, 5]
    assert again(rollouts, {}).ended == "looked"
    rollouts.program.close()


def test_a_flow_that_ends_and_begins() -> None:
    flow = {"chain": [{"pose": {"to": "stand", "duration": 0.2}}, {"hold": {"duration": 0.1}}]}
    changed = {"flow": flow, "commands": [], "policies": {}}
    rollouts = Rollouts(Program(document(**changed, **{"scene.initial_pose": "rest"})))
    first = rollouts.run(TICKS)
    rollouts.begin(document(**changed, **{"scene.initial_pose": "rest"}))
    assert rollouts.run(TICKS).sha256_commands == first.sha256_commands
    assert first.ended == "done"
    rollouts.program.close()


def test_what_cannot_begin_anew_says_so() -> None:
    rollouts = Rollouts(Program(load_document("go2_stand", {"platform": "fake"})))
    assert rollouts.why_not == "platform 'fake' cannot begin in another scene"
    with pytest.raises(UniconError, match="cannot begin in another scene"):
        rollouts.begin(document())
    rollouts.program.close()


def test_a_block_that_holds_an_iterator_is_built_anew() -> None:
    numbers = iter(range(1000))

    def hook(program: Program) -> HookBlocks:
        return {Stage.TUNE: [Block("counted", lambda: bool(next(numbers) < 0))]}

    program = Program(document(), hooks=[hook])
    program.outside.clear()  # as if the workflow had named it
    rollouts = Rollouts(program)
    assert rollouts.why_not == "block 'counted': declares no memory"
    program.close()


def test_a_wrong_scene_is_refused_and_nothing_goes_on_half_changed(warm: Rollouts) -> None:
    rollouts = Rollouts(Program(document()))
    with pytest.raises(UniconError, match="has no joint like 'nose'"):
        rollouts.begin(document(**{"scene.joints": {"nose": {"friction": 1.0}}}))
    assert rollouts.why_not == "a beginning failed"
    rollouts.program.close()


def test_a_robot_has_no_rollouts(monkeypatch: pytest.MonkeyPatch) -> None:
    from dataclasses import replace

    program = Program(load_document("go2_stand", {"platform": "fake"}))
    program.platform.facts = replace(program.platform.facts, simulated=False)
    with pytest.raises(UniconError, match="'fake' is a robot; rollouts are simulated"):
        Rollouts(program)
    program.close()
