"""Lockstep: a rollout does bit-exactly what it does alone, no matter what runs beside it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from unicon_core.runtime.rollouts import Lockstep, Look, Rollout, Rollouts
from unicon_core.states import States
from unicon_core.workflow import Program, load_document
from unicon_core.workflow.document import WorkflowDocument

pytest.importorskip("mujoco")

TICKS = 25
BESIDE = 3
WALK: dict[str, Any] = {
    "flow": {"policy": "walk"},
    "scene.initial_pose": "policy:walk",
    "scene.push.every": 0.2,
    "scene.push.velocity": 0.3,
}
KINDS: dict[str, dict[str, Any]] = {
    "as it was": {},
    "seed": {"scene.seed": 7},
    "noise": {"scene.noise": {"joint_vel": 0.1}},
    "delay": {"scene.delay": 2},
    "joint delay": {'scene.joints."*".delay': 0.006},
    "strength": {'scene.joints."*".strength': 0.7},
    "payload": {"scene.payload.mass": 4.0},
    "contact friction": {"scene.contact_friction": 0.3},
    "pose": {"scene.initial_pose": {"FL_calf_joint": -1.4}},
    "stopped": {"scene.noise": {"projected_gravity": 1.0}},
    "blows up": {"scene.push.velocity": 1e12},
    "blows up late": {"scene.push.velocity": 1e12, "scene.delay": 2},
    "looked": {"scene.seed": 4, "scene.push.velocity": 0.7},
}


def document(kind: str) -> WorkflowDocument:
    return load_document("go2_walk", WALK | KINDS[kind])


def fast(states: States) -> Look:
    velocity = states["base_lin_vel"]
    return lambda: bool(abs(velocity[1]) > 0.25)


def told(rollout: Rollout) -> tuple[Any, ...]:
    """All of a rollout, its states as they are now."""
    values = vars(rollout) | {"states": rollout.states.tobytes()}
    return tuple(values.values())


@pytest.fixture(scope="module")
def alone() -> Iterator[dict[str, tuple[Any, ...]]]:
    rollouts = Rollouts(Program(document("as it was")), fast)
    found = {}
    for kind in KINDS:
        rollouts.begin(document(kind))
        found[kind] = told(rollouts.run(TICKS))
    yield found
    rollouts.program.close()


@pytest.fixture(scope="module")
def places() -> Iterator[list[Rollouts]]:
    made = [Rollouts(Program(document("delay")), fast, beside=True) for _ in range(BESIDE)]
    yield made
    for each in made:
        each.program.close()


def test_the_kinds_end_in_every_way(alone: dict[str, tuple[Any, ...]]) -> None:
    ends = {kind: (ended, block) for kind, (ended, _, _, block, *_) in alone.items()}
    assert ends["as it was"] == ("duration", "")
    assert ends["looked"] == ("looked", "")
    assert ends["stopped"] == ("fault", "tilt_stop")
    assert ends["blows up"] == ends["blows up late"] == ("fault", "send")


@settings(
    max_examples=12, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(todo=st.lists(st.tuples(st.sampled_from(list(KINDS)), st.integers(0, 9)), max_size=7))
def test_a_rollout_is_what_it_is_alone(
    alone: dict[str, tuple[Any, ...]],
    places: list[Rollouts],
    todo: list[tuple[str, int]],
) -> None:
    lockstep: Lockstep[tuple[str, Rollouts]] = Lockstep()
    free, left, found = list(places), list(todo), []
    while left or len(lockstep):
        wait = 1
        if left and free:
            kind, wait = left.pop(0)  # they do not begin together
            place = free.pop()
            place.begin(document(kind))
            lockstep.add((kind, place), place, TICKS)
        for _ in range(wait):
            for (kind, place), rollout in lockstep.tick():
                found.append((kind, told(rollout)))
                free.append(place)
    assert sorted(kind for kind, _ in found) == sorted(kind for kind, _ in todo)
    for kind, rollout in found:
        assert rollout == alone[kind], kind


def test_one_that_waits_runs_by_itself_too(
    alone: dict[str, tuple[Any, ...]], places: list[Rollouts]
) -> None:
    places[0].begin(document("joint delay"))
    assert told(places[0].run(TICKS)) == alone["joint delay"]


def test_what_cannot_wait_runs_at_once() -> None:
    program = Program(load_document("go2_stand", {"platform": "fake"}))
    rollouts = Rollouts(program, beside=True)
    lockstep: Lockstep[str] = Lockstep()
    lockstep.add("it", rollouts, 5)
    assert len(lockstep) == 1
    ((mark, rollout),) = lockstep.tick()
    assert (mark, rollout.ticks, len(lockstep)) == ("it", 5, 0)
    program.close()


def test_robots_of_a_batch_do_not_wait() -> None:
    from unicon_core.platforms.platform import DefersPhysics

    program = Program(load_document("go2_stand", {"platform": "mujoco", "num_robots": 2}))
    assert isinstance(program.platform, DefersPhysics)
    assert program.platform.postpone() is None
    program.close()
