"""The damping command: finite and within limits whatever was measured or commanded before."""

from __future__ import annotations

import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from unicon_core.platforms.kit.damping import damping_command, repeated
from unicon_core.robots import load_robot, robot_names
from unicon_core.states import Layout, States, standard_states
from unicon_core.states.standard import COMMAND_STATES

ANY = st.floats(width=32, allow_nan=True, allow_infinity=True)


@settings(deadline=None, max_examples=60)
@given(data=st.data(), name=st.sampled_from(robot_names()), hold=st.booleans(), said=st.booleans())
def test_it_is_finite_and_within_the_limits_whatever_was_before(
    data: st.DataObject, name: str, hold: bool, said: bool
) -> None:
    robot = load_robot(name)
    states = States(
        Layout(standard_states(robot.joint_names), data.draw(st.sampled_from([None, 2])))
    )
    for state in ("joint_pos", *COMMAND_STATES):
        view = states[state]
        view[...] = data.draw(
            st.lists(ANY, min_size=view.size, max_size=view.size).map(np.array)
        ).reshape(view.shape)
    sent = states.joint_pos_target.copy() if said else None
    damping_command(states, robot, sent, hold=hold)
    for state in COMMAND_STATES:
        assert np.isfinite(states[state]).all(), state
    assert not (states.joint_pos_target < robot.lower).any()  # an unknown limit is NaN
    assert not (states.joint_pos_target > robot.upper).any()
    for state in ("joint_vel_target", "joint_effort_ff", "joint_stiffness"):
        assert not states[state].any()
    known = np.nan_to_num(robot.joint_damping)
    assert (states.joint_damping == known).all()


def test_targets_are_the_measured_ones_unless_they_are_to_be_held() -> None:
    robot = load_robot("go2")
    states = States(Layout(standard_states(robot.joint_names)))
    states.joint_pos[...] = robot.rest_joint_pos
    damping_command(states, robot, robot.default_joint_pos)
    assert states.joint_pos_target.tolist() == robot.rest_joint_pos.tolist()
    damping_command(states, robot, robot.default_joint_pos, hold=True)
    assert states.joint_pos_target.tolist() == robot.default_joint_pos.tolist()


def test_errors_stop_no_repetition_and_are_told_at_the_end() -> None:
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
