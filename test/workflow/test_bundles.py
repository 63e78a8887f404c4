"""Bundles: several states as one parameter of a block, beside parameters of their own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from unicon_base.errors import WorkflowError
from unicon_core.blocks.postures import JointCommand
from unicon_core.flow import Amends, Block, Bundle, Reads
from unicon_core.robots import load_robot
from unicon_core.states import States, StateSpec, standard_states
from unicon_core.workflow.autowire import BuildContext, autowire, option_names, state_names

ROBOT = load_robot("go2")
SPECS = {**standard_states(ROBOT.joint_names), "posture": StateSpec((ROBOT.num_joints,))}
STATES = States(SPECS)


@dataclass(frozen=True)
class Attitude(Bundle):
    """How the base stands."""

    base_quat: Reads
    base_ang_vel: Reads


@dataclass(frozen=True)
class Body(Bundle):
    """A bundle of a bundle."""

    attitude: Attitude
    joint_pos_target: Amends


@dataclass(frozen=True)
class Tuned(Bundle):
    """No bundle: a gain is not a state."""

    joint_pos: Reads
    gain: float


def bow(
    command: JointCommand,
    joint_vel: Reads,
    *,
    period: float,
    depths: list[float] = [0.25],  # noqa: B006
    mirror: bool = False,
) -> Callable[[], bool]:
    """A posture of a user's own."""
    assert period == 0.02

    def tick() -> bool:
        command.joint_pos_target[...] = command.joint_pos + depths[0]
        return mirror

    tick.parts = (command, joint_vel)  # type: ignore[attr-defined]
    return tick


def lean(body: Body) -> Callable[[], bool]:
    """A block of nested bundles alone."""

    def tick() -> bool:
        return False

    tick.parts = body  # type: ignore[attr-defined]
    return tick


def build(factory: Callable[..., Any], rename: dict[str, str] | None = None, **options: Any) -> Any:
    """Build a block as a workflow does."""
    return autowire(factory, "mine", BuildContext(STATES, ROBOT, 0.02), options, rename, "f.yaml:3")


def test_a_bundle_gets_the_views_and_the_block_declares_them() -> None:
    block = build(bow, depths=[0.5])
    command, joint_vel = block.tick.parts
    STATES.joint_pos = 1.0
    block.tick()

    assert STATES.joint_pos_target.tolist() == [1.5] * 12
    assert np.shares_memory(joint_vel, STATES.joint_vel)
    assert not command.joint_pos.flags.writeable
    assert command.joint_stiffness.flags.writeable
    assert set(block.reads) == {"joint_vel", "joint_pos"}
    assert set(block.writes) == {
        "joint_pos_target",
        "joint_vel_target",
        "joint_effort_ff",
        "joint_stiffness",
        "joint_damping",
    }
    assert block.amends == ()


def test_what_a_bundle_holds_is_told_as_states_and_not_as_options() -> None:
    assert option_names(bow) == ["depths", "mirror"]
    assert state_names(bow)["joint_damping"] == "writes"
    assert next(iter(state_names(bow))) == "joint_vel"
    assert len(state_names(bow)) == 7


def test_the_states_of_a_bundle_are_renamed_like_parameters() -> None:
    block = build(bow, {"joint_pos_target": "posture"})
    STATES.joint_pos, STATES.posture = 1.0, 0.0
    block.tick()

    assert STATES.posture.tolist() == [1.25] * 12
    assert "posture" in block.writes
    assert "joint_pos_target" not in block.writes


def test_bundles_nest() -> None:
    block = build(lean)

    assert np.shares_memory(block.tick.parts.attitude.base_quat, STATES.base_quat)
    assert state_names(lean) == {
        "base_quat": "reads",
        "base_ang_vel": "reads",
        "joint_pos_target": "amends",
    }
    assert (block.reads, block.amends) == (("base_quat", "base_ang_vel"), ("joint_pos_target",))


def wrong(tuned: Tuned) -> Block:
    """A block that takes something else for a bundle."""
    raise AssertionError


@pytest.mark.parametrize(
    ("factory", "rename", "message"),
    [
        (
            wrong,
            None,
            "f.yaml:3: block 'mine': Tuned.gain is not a state; annotate it Reads, Writes or "
            "Amends, or make it a parameter of the block",
        ),
        (
            bow,
            {"joint_stifness": "posture"},
            "f.yaml:3: block 'mine' has no state parameter 'joint_stifness'; "
            "did you mean 'joint_stiffness'? known: joint_damping, joint_effort_ff, joint_pos, "
            "joint_pos_target, joint_stiffness, joint_vel, joint_vel_target",
        ),
    ],
)
def test_errors_name_the_field(
    factory: Callable[..., Any], rename: dict[str, str] | None, message: str
) -> None:
    with pytest.raises(WorkflowError) as caught:
        build(factory, rename)
    assert str(caught.value) == message


def test_a_state_that_is_not_there_is_named() -> None:
    with pytest.raises(WorkflowError, match=r"no state 'nowhere'; .* 'states: \{joint_pos: LABEL"):
        build(bow, {"joint_pos": "nowhere"})
