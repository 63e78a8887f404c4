"""The damping command: finite and within limits whatever was measured or commanded before."""

from __future__ import annotations

import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from unicon_core.platforms.kit.command import BLEND, Damping, LastSent, repeated
from unicon_core.robots import load_robot, robot_names
from unicon_core.states import Layout, States, standard_states
from unicon_core.states.standard import COMMAND_STATES

ANY = st.floats(width=32, allow_nan=True, allow_infinity=True)


PERIOD = 0.02
TICKS = 25


def filled(data, states):
    for state in ("joint_pos", *COMMAND_STATES):
        view = states[state]
        view[...] = np.resize(data.draw(st.lists(ANY, min_size=1, max_size=7)), view.shape)


@settings(max_examples=25)
@given(data=st.data(), name=st.sampled_from(robot_names()), said=st.booleans())
def test_it_is_finite_and_within_the_limits_whatever_was_before(data, name, said):
    robot = load_robot(name)
    num_robots = data.draw(st.sampled_from([None, 2]))
    states = States(Layout(standard_states(robot.joint_names), num_robots))
    last = LastSent(states)
    filled(data, states)
    if said:
        last.note()
        filled(data, states)
    damping = Damping(states, robot, last, PERIOD)
    before = np.nan_to_num(last.states.joint_stiffness, posinf=0.0, neginf=0.0).clip(0.0)
    for tick in range(TICKS):
        filled(data, states) if tick < 2 else None
        damping()
        for state in COMMAND_STATES:
            assert np.isfinite(states[state]).all(), state
        assert not (states.joint_pos_target < robot.lower).any()  # an unknown limit is NaN
        assert not (states.joint_pos_target > robot.upper).any()
        assert not states.joint_vel_target.any()
        assert not states.joint_effort_ff.any()
        known = np.isfinite(robot.joint_damping)
        assert (states.joint_damping[..., known] == robot.joint_damping[known]).all()
        assert (states.joint_damping >= 0.0).all()
        assert (states.joint_damping <= 200.0).all()
        stiffness = states.joint_stiffness.copy()
        assert (stiffness <= before).all()
        before = stiffness
        assert not stiffness.any() or tick < round(BLEND / PERIOD)
    assert not before.any()


def test_targets_are_those_that_were_sent_last_and_not_what_was_written_since():
    robot = load_robot("go2")
    states = States(Layout(standard_states(robot.joint_names)))
    states.joint_pos[...] = robot.rest_joint_pos
    states.joint_pos_target[...] = robot.default_joint_pos
    states.joint_stiffness[...] = 40.0
    last = LastSent(states)
    Damping(states, robot, last, PERIOD)()
    assert states.joint_pos_target.tolist() == robot.rest_joint_pos.tolist()
    assert not states.joint_stiffness.any()  # nothing of ours was ever there
    states.joint_pos_target[...] = robot.default_joint_pos
    states.joint_stiffness[...] = 40.0
    last.note()
    states.joint_pos_target[...] = np.nan
    states.joint_stiffness[...] = 1e9
    Damping(states, robot, last, PERIOD)()
    assert states.joint_pos_target.tolist() == robot.default_joint_pos.tolist()
    assert states.joint_stiffness == pytest.approx(40.0 * (1.0 - PERIOD / BLEND))


def test_errors_stop_no_repetition_and_are_told_at_the_end():
    calls: list[float] = []

    def send() -> None:
        calls.append(time.monotonic())
        if len(calls) < 3:
            raise ValueError(f"number {len(calls)}")

    with pytest.raises(ValueError, match="number 2"):
        repeated(send, 0.005, 0.1)
    assert 3 < len(calls) <= 21
    calls[:] = [0.0] * 5
    repeated(send, 0.005, 0.0)  # once at least
    assert len(calls) == 6
