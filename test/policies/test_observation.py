"""The fused observation equals the plain concatenation, bit for bit."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from policy_helpers import JOINTS, robot, toy_values
from reference_observation import ConcatenateObservation

from unicon_base.errors import PolicyError
from unicon_core.policies import Observation, PolicyContract, policy_states
from unicon_core.policies.facts import Facts
from unicon_core.policies.file import build_contract
from unicon_core.states import States, StateSpec, standard_states

SIZES = {
    "joint_pos": 4, "joint_vel": 4, "base_ang_vel": 3, "projected_gravity": 3,
    "velocity_command": 3, "action": 4, "terrain": 7,
}  # fmt: skip
EXTRA = {"terrain": StateSpec((7,))}


def contract_of(**changes: Any) -> PolicyContract:
    return build_contract(Facts(Path("policy.yaml"), "policy.yaml", toy_values(**changes)))


def states_of(
    contract: PolicyContract, joints: tuple[str, ...], num_robots: int | None = None
) -> States:
    specs = {**standard_states(joints), **EXTRA}
    specs |= policy_states(contract, robot(joints).joint_names, EXTRA)
    return States(specs, num_robots)


numbers = st.floats(-3.0, 3.0, width=32)


@st.composite
def term_values(draw: Any, name: str, history: int) -> dict[str, Any]:
    state = draw(st.sampled_from(sorted(SIZES)))
    size = SIZES[state]
    term: dict[str, Any] = {"name": name, "state": state, "history": history}
    if draw(st.booleans()):
        index = draw(st.lists(st.integers(0, size - 1), min_size=1, max_size=size + 1))
        term["index"], size = index, len(index)
    if draw(st.booleans()):
        term["scale"] = draw(st.one_of(numbers, st.lists(numbers, min_size=size, max_size=size)))
    if draw(st.booleans()):
        low = draw(st.floats(-2.0, 0.0, width=32))
        term["clip"] = [low, draw(st.floats(0.0, 2.0, width=32))]
    if state in ("joint_pos", "joint_vel") and draw(st.booleans()):
        term["subtract"] = "default_joint_pos"
    elif draw(st.booleans()):
        term["subtract"] = draw(st.lists(numbers, min_size=size, max_size=size))
    return term


@st.composite
def contracts(draw: Any) -> PolicyContract:
    layout = draw(st.sampled_from(["term_major", "frame_major"]))
    shared = draw(st.integers(1, 4))
    terms = []
    for i in range(draw(st.integers(1, 5))):
        history = draw(st.sampled_from([shared, shared, 1, 3]))
        terms.append(draw(term_values(f"t{i}", history)))
    return contract_of(
        observation={
            "terms": terms,
            "layout": layout,
            "newest": draw(st.sampled_from(["first", "last"])),
            "start": draw(st.sampled_from(["first", "zeros"])),
        }
    )


@given(
    contract=contracts(),
    joints=st.permutations([*JOINTS, "tail"]),
    num_robots=st.sampled_from([None, 1, 3]),
    seed=st.integers(0, 2**16),
)
@settings(max_examples=150)
def test_fused_observation_equals_concatenation(
    contract: PolicyContract, joints: list[str], num_robots: int | None, seed: int
) -> None:
    order = tuple(joints)
    states = states_of(contract, order, num_robots)
    fused = Observation(contract, states, order)
    rows = num_robots or 1
    twins = [ConcatenateObservation(contract, order) for _ in range(rows)]
    rng = np.random.default_rng(seed)
    out = np.zeros(fused.shape, np.float32)
    for tick in range(9):
        if tick == 6:
            fused.reset()
            for twin in twins:
                twin.reset()
        for name in SIZES:
            states[name] = rng.normal(size=states[name].shape) * 2
        fused.bind(out)()
        for k, twin in enumerate(twins):
            row = {n: states[n] if num_robots is None else states[n][k] for n in SIZES}
            np.testing.assert_array_equal(out[k], twin(row))


def test_joint_states_are_taken_in_policy_order() -> None:
    contract = contract_of(
        observation={"terms": [{"name": "q", "state": "joint_pos"}]}, joints=list(JOINTS)
    )
    order = ("b_knee", "extra", "a_hip", "b_hip", "a_knee")
    states = states_of(contract, order)
    states.joint_pos = [0.0, 9.0, 1.0, 2.0, 3.0]
    out = np.zeros((1, 4), np.float32)
    Observation(contract, states, order).bind(out)()
    assert out[0].tolist() == [1.0, 3.0, 2.0, 0.0]  # a_hip, a_knee, b_hip, b_knee


def test_last_action_stays_in_policy_order() -> None:
    contract = contract_of(observation={"terms": [{"name": "a", "state": "action"}]})
    order = tuple(reversed(JOINTS))
    states = states_of(contract, order)
    states.action = [1.0, 2.0, 3.0, 4.0]
    out = np.zeros((1, 4), np.float32)
    Observation(contract, states, order).bind(out)()
    assert out[0].tolist() == [1.0, 2.0, 3.0, 4.0]


@pytest.mark.parametrize(
    ("layout", "newest", "expected"),
    [
        # two terms of one element, a and b, three frames 1, 2, 3
        ("term_major", "last", [1, 2, 3, 10, 20, 30]),
        ("term_major", "first", [3, 2, 1, 30, 20, 10]),
        ("frame_major", "last", [1, 10, 2, 20, 3, 30]),
        ("frame_major", "first", [3, 30, 2, 20, 1, 10]),
    ],
)
def test_histories_stand_as_declared(layout: str, newest: str, expected: list[float]) -> None:
    terms = [
        {"name": "a", "state": "velocity_command", "index": [0], "history": 3},
        {"name": "b", "state": "velocity_command", "index": [1], "history": 3},
    ]
    contract = contract_of(observation={"terms": terms, "layout": layout, "newest": newest})
    states = states_of(contract, JOINTS)
    observation = Observation(contract, states, JOINTS)
    out = np.zeros((1, 6), np.float32)
    for k in (1.0, 2.0, 3.0):
        states.velocity_command = [k, 10 * k, 0.0]
        observation.bind(out)()
    assert out[0].tolist() == expected


def test_the_first_observation_fills_the_history() -> None:
    terms = [{"name": "a", "state": "velocity_command", "index": [0], "history": 4}]
    contract = contract_of(observation={"terms": terms})
    states = states_of(contract, JOINTS)
    observation = Observation(contract, states, JOINTS)
    out = np.zeros((1, 4), np.float32)
    for value in (5.0, 6.0):
        states.velocity_command = [value, 0.0, 0.0]
        observation.bind(out)()
    assert out[0].tolist() == [5.0, 5.0, 5.0, 6.0]
    observation.reset()
    observation.bind(out)()
    assert out[0].tolist() == [6.0, 6.0, 6.0, 6.0]


def test_clipping_comes_before_scaling_and_passes_nan_on() -> None:
    terms = [{"name": "a", "state": "velocity_command", "scale": 2.0, "clip": [-1, 1]}]
    contract = contract_of(observation={"terms": terms})
    states = states_of(contract, JOINTS)
    states.velocity_command = [5.0, -5.0, np.nan]
    out = np.zeros((1, 3), np.float32)
    Observation(contract, states, JOINTS).bind(out)()
    assert out[0, :2].tolist() == [2.0, -2.0]
    assert np.isnan(out[0, 2])


def test_an_observation_written_into_the_packed_buffer_allocates_nothing() -> None:
    import tracemalloc

    contract = contract_of()
    states = states_of(contract, JOINTS)
    observation = Observation(contract, states, JOINTS)
    out = states.observation.reshape(1, -1)
    observation.bind(out)()
    tracemalloc.start()
    before = tracemalloc.get_traced_memory()[0]
    for _ in range(2000):
        observation.bind(out)()
    after = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    assert after - before < 2000


@pytest.mark.parametrize(
    ("term", "message"),
    [
        (
            {"name": "x", "state": "base_ang_val"},
            "policy toy: term 'x': no state 'base_ang_val'; did you mean 'base_ang_vel'? known: ",
        ),
        (
            {"name": "x", "state": "base_ang_vel", "index": [3]},
            "policy toy: term 'x': index 3 of state 'base_ang_vel', which has 3 elements; "
            "the last is 2",
        ),
        (
            {"name": "x", "state": "base_ang_vel", "scale": [1.0, 2.0]},
            "policy toy: term 'x': scale has 2 values for 3 elements; give 1 or 3",
        ),
        (
            {"name": "x", "state": "base_ang_vel", "subtract": "default_joint_pos"},
            "policy toy: term 'x': subtract default_joint_pos needs a joint state, and "
            "'base_ang_vel' has no joint names; give numbers, or take joint_pos",
        ),
        (
            {"name": "x", "state": "stamp_ns"},
            "policy toy: term 'x': state 'stamp_ns' is int64; a network takes float32 states",
        ),
    ],
)
def test_terms_that_do_not_fit_the_states_are_refused(term: dict[str, Any], message: str) -> None:
    contract = contract_of(observation={"terms": [term]})
    states = States(standard_states(JOINTS))
    with pytest.raises(PolicyError) as caught:
        Observation(contract, states, JOINTS)
    assert str(caught.value).startswith(message)


def test_a_joint_that_the_robot_has_not_is_named() -> None:
    contract = contract_of()
    joints = ("a_hip", "a_knee", "b_hip", "c_knee")
    specs = {**standard_states(joints), "action": StateSpec((4,))}
    with pytest.raises(PolicyError) as caught:
        Observation(contract, States(specs), joints)
    assert str(caught.value) == (
        "policy toy: term 'joint_pos': the robot has no joint 'b_knee'; did you mean 'c_knee'? "
        "known: a_hip, a_knee, b_hip, c_knee"
    )
