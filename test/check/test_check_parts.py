"""The parts of the check that need no simulator: sides, orders, broken contracts, scores, texts."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import MappingProxyType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from unicon_core.check.joints import mirror_pairs, other_order
from unicon_core.check.result import CheckResult, Finding, Section
from unicon_core.check.twin.perturb import permuted, perturbations, renamed
from unicon_core.check.twin.repair import filter_repairs, repairs
from unicon_core.check.twin.session import Recorder
from unicon_core.policies import ActionSpec, ObservationSpec, ObservationTerm, PolicyContract
from unicon_core.policies.contract import CommandSpec, FilterSpec, PhaseSpec
from unicon_core.policies.observation import Observation
from unicon_core.policies.phase import GaitPhase
from unicon_core.policies.policy_states import policy_states
from unicon_core.robots import load_robot
from unicon_core.states import States, standard_states

LEGS = tuple(
    f"{leg}_{p}_joint" for leg in ("FL", "FR", "RL", "RR") for p in ("hip", "thigh", "calf")
)
DEPTHS = [1, 2, 3] * 4


def contract(scale: float = 1.0) -> PolicyContract:
    n = len(LEGS)
    ramp = np.arange(n, dtype=np.float32)
    return PolicyContract(
        name="toy",
        path=Path("policy.yaml"),
        model=Path("policy.onnx"),
        period=0.02,
        joints=LEGS,
        default_joint_pos=0.1 * ramp,
        action=ActionSpec(LEGS, 0.2 + 0.01 * ramp, 0.1 * ramp),
        stiffness=20.0 + ramp,
        damping=1.0 + 0.1 * ramp,
        observation=ObservationSpec(
            (
                ObservationTerm("gyro", "base_ang_vel", scale=np.full(1, scale, np.float32)),
                ObservationTerm("gravity", "projected_gravity"),
                ObservationTerm("pos", "joint_pos", subtract="default_joint_pos"),
            )
        ),
        inputs=MappingProxyType({"observation": "obs"}),
        outputs=MappingProxyType({"action": "actions"}),
    )


@pytest.mark.parametrize(
    ("names", "pairs"),
    [
        (("left_hip", "right_hip", "waist"), [("left_hip", "right_hip")]),
        (("FL_calf_joint", "FR_calf_joint"), [("FL_calf_joint", "FR_calf_joint")]),
        (("Left_Knee_Pitch", "Right_Knee_Pitch"), [("Left_Knee_Pitch", "Right_Knee_Pitch")]),
        (("hip_pitch_l_joint", "hip_pitch_r_joint"), [("hip_pitch_l_joint", "hip_pitch_r_joint")]),
        (("LF_HAA", "RF_HAA"), [("LF_HAA", "RF_HAA")]),
        (("left_hip", "waist_yaw"), []),
        (("joint1", "joint2"), []),
    ],
)
def test_sides_are_told_from_names(names: tuple[str, ...], pairs: list[tuple[str, str]]) -> None:
    assert mirror_pairs(names) == pairs


def test_pairs_are_the_same_for_every_robot_from_both_sides() -> None:
    joints = load_robot("g1_29dof").joint_names
    assert len(mirror_pairs(joints)) == 13
    assert sorted(mirror_pairs(joints[::-1])) == sorted(mirror_pairs(joints))


def test_the_other_order_is_breadth_first_and_back() -> None:
    breadth = other_order(DEPTHS)
    assert [LEGS[i] for i in breadth[:4]] == [
        f"{leg}_hip_joint" for leg in ("FL", "FR", "RL", "RR")
    ]
    again = other_order([DEPTHS[i] for i in breadth])
    assert [breadth[i] for i in again] == list(range(12))


def by_joint(of: PolicyContract) -> dict[str, tuple[float, ...]]:
    """Every figure of every joint, looked up by name; those of the action are in its order."""
    figures = of.default_joint_pos, of.stiffness, of.damping, of.action.scale, of.action.offset
    return dict(zip(of.joints, zip(*figures)))


@settings(max_examples=50)
@given(st.permutations(LEGS))
def test_a_permuted_contract_keeps_every_figure_with_its_joint(order: list[str]) -> None:
    after = permuted(contract(), order)
    assert after.joints == tuple(order) == after.action.joints
    assert by_joint(after) == by_joint(contract())


@settings(max_examples=50)
@given(st.permutations(LEGS))
def test_a_renamed_contract_keeps_every_figure_on_its_place(order: list[str]) -> None:
    changed = renamed(contract(), order)
    assert changed.joints == tuple(order) == changed.action.joints
    np.testing.assert_array_equal(changed.stiffness, contract().stiffness)
    np.testing.assert_array_equal(changed.action.scale, contract().action.scale)


def test_broken_contracts_differ_from_the_given_one_in_one_thing() -> None:
    by_culprit = {p.name: p.contract for p in perturbations(contract(0.25), DEPTHS)}
    scales = by_culprit["observation scales left out"]
    assert scales is not None
    assert [term.scale[0] for term in scales.terms] == [1.0, 1.0, 1.0]
    gravity = by_culprit["gravity upside down"]
    assert gravity is not None
    assert [term.scale[0] for term in gravity.terms] == [0.25, -1.0, 1.0]
    sides = by_culprit["left and right joints exchanged"]
    assert sides is not None
    assert sides.joints[:3] == ("FR_hip_joint", "FR_thigh_joint", "FR_calf_joint")
    gains = by_culprit["gains in another order"]
    assert gains is not None
    assert sorted(gains.stiffness) == sorted(contract().stiffness)
    assert (gains.stiffness != contract().stiffness).any()


def test_scales_of_one_are_doubled() -> None:
    broken = perturbations(contract(), DEPTHS)[0]
    assert broken.name == "observation scales doubled (all are 1)"
    assert broken.contract is not None
    assert [term.scale[0] for term in broken.contract.terms] == [2.0, 2.0, 2.0]


def test_a_flipped_sign_is_not_taken_for_a_scale() -> None:
    flipped = perturbations(contract(), DEPTHS)[2].contract
    assert flipped is not None
    assert perturbations(flipped, DEPTHS)[0].name == "observation scales doubled (all are 1)"


def test_equal_gains_cannot_be_in_the_wrong_order() -> None:
    same = replace(
        contract(), stiffness=np.full(12, 30, np.float32), damping=np.ones(12, np.float32)
    )
    gains = perturbations(same, DEPTHS)[-1]
    assert gains.contract is None
    assert gains.reason == "all joints have the same gains"


@pytest.mark.parametrize("number", range(5))
def test_among_the_repairs_is_the_one_that_undoes_each_mistake(
    number: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    known = dict(zip(LEGS, DEPTHS))
    monkeypatch.setattr(
        "unicon_core.check.twin.repair.joint_depths", lambda *of: [known[n] for n in of[-1]]
    )
    model: Any = SimpleNamespace(key_poses=dict)
    given_contract = contract(0.25)
    broken = perturbations(given_contract, DEPTHS)[number].contract
    assert broken is not None
    if number == 0:  # which scales were left out cannot be known: the usual ones are tried
        usual = [r.contract for r in repairs(broken, load_robot("go2"), None)]
        assert any([t.scale[0] for t in c.terms] == [0.25, 1.0, 1.0] for c in usual)
        return
    same = [
        repair.culprit
        for repair in repairs(broken, load_robot("go2"), model)
        if _equal(repair.contract, given_contract) and not repair.without
    ]
    assert same


def _clocked(terms: dict[str, tuple[int, ...] | None]) -> PolicyContract:
    read = (
        ObservationTerm(f"t{i}", state, index) for i, (state, index) in enumerate(terms.items())
    )
    spec = ObservationSpec(tuple(read))
    return replace(contract(), observation=spec, phase=PhaseSpec(0.8, (0.0, 2.0)))


def _seen(clocked: PolicyContract) -> list[float]:
    """The observation after one tick of the clock."""
    states = States({**standard_states(LEGS), **policy_states(clocked, LEGS)})
    assert clocked.phase is not None
    GaitPhase(clocked.phase, states, 0.02)()
    observation = Observation(clocked, states, LEGS)
    out = np.zeros(observation.shape, np.float32)
    observation.bind(out)()
    return [float(value) for value in out[0]]


@pytest.mark.parametrize(
    "terms",
    [
        {"gait_phase": None},
        {"gait_phase_cos": None, "gait_phase_sin": None},
        {"gait_phase": (1, 2), "gait_phase_sin": (1,)},
    ],
)
def test_an_exchanged_clock_shows_cosines_where_sines_were(
    terms: dict[str, tuple[int, ...] | None],
) -> None:
    right = _clocked(terms)
    broken = next(c for c in perturbations(right, DEPTHS) if "sines and cosines" in c.name).contract
    assert broken is not None
    angles = np.array((0.0, 2.0)) + 2.0 * np.pi * 0.02 / 0.8
    both = [*np.sin(angles), *np.cos(angles)]
    other = dict(zip(np.round(both, 5), [*both[2:], *both[:2]]))
    assert _seen(broken) == pytest.approx([other[round(x, 5)] for x in _seen(right)], abs=1e-5)
    names = {repair.name for repair in repairs(broken, load_robot("go2"), None)}
    assert "sines and cosines of the gait clock exchanged" in names
    assert "the gait clock, its period times 2" in names


def test_filters_feedback_and_slew_have_their_repairs() -> None:
    plain = contract()
    low = FilterSpec(low_pass=4.0, start="zeros")
    action = replace(plain.action, filter=FilterSpec(alpha=0.3, start="zeros"), feedback="filtered")
    term = replace(plain.terms[0], filter=low)
    observation = replace(plain.observation, terms=(term, *plain.terms[1:]))
    said = replace(plain, action=action, observation=observation, command=CommandSpec((1.0,) * 3))
    found = {change.name: change.contract for change in filter_repairs(said)}
    name = term.name
    turned = found["action.filter of 1 − alpha"]
    assert turned is not None
    assert turned.action.filter == FilterSpec(alpha=0.7, start="zeros")
    plainer = found["action.filter left out"]
    assert plainer is not None
    assert (plainer.action.filter, plainer.action.feedback) == (None, "clipped")
    quarter = found[f"the filter of term {name!r} of a quarter the cut-off"]
    assert quarter is not None
    assert quarter.terms[0].filter == replace(low, low_pass=1.0)
    assert {"action.feedback raw", "action.feedback clipped", "a command without slew"} <= {*found}
    bare = {change.name for change in filter_repairs(plain)}
    assert "an action.filter of alpha 0.2, feedback filtered" in bare
    assert not [name for name in bare if "term" in name or "slew" in name]


def test_clocks_are_exchanged_only_for_terms_as_wide() -> None:
    read = _clocked({"gait_phase": None, "gait_phase_sin": None, "base_ang_vel": None})
    found = [repair.name for repair in repairs(read, load_robot("go2"), None)]
    assert not [name for name in found if name.startswith("terms 't0' and")]
    assert not [name for name in found if name.startswith("terms 't1' and")]


def _equal(a: PolicyContract, b: PolicyContract) -> bool:
    return (
        a.joints == b.joints
        and np.array_equal(a.stiffness, b.stiffness)
        and np.array_equal(a.damping, b.damping)
        and np.array_equal(a.default_joint_pos, b.default_joint_pos)
        and np.array_equal(a.action.scale, b.action.scale)
        and [t.name for t in a.terms] == [t.name for t in b.terms]
        and all(np.array_equal(s.scale, t.scale) for s, t in zip(a.terms, b.terms))
    )


@pytest.fixture
def states() -> States:
    return States(standard_states(load_robot("go2").joint_names))


def record(
    states: States,
    ticks: int = 250,
    walking: bool = True,
    motion_error: NDArray[np.float32] | None = None,
) -> Recorder:
    robot = load_robot("go2")
    effort = robot.effort_limit.astype(np.float64)
    recorder = Recorder(states, robot, effort, 0.02, motion_error)
    states["projected_gravity"][...] = (0.0, 0.0, -1.0)
    states["base_pos_w"][...] = (0.0, 0.0, 0.3)
    states["joint_pos"][...] = robot.default_joint_pos
    for _ in range(ticks):
        recorder(walking)
    return recorder


def test_a_perfect_run_scores_one(states: States) -> None:
    states["velocity_command"][...] = (0.6, 0.0, 0.2)
    states["base_lin_vel"][...] = (0.6, 0.0, 0.0)
    states["base_ang_vel"][...] = (0.0, 0.0, 0.2)
    measures = record(states).measures(5.0, "", True)
    assert measures.score == pytest.approx(1.0)
    assert measures.stands
    assert measures.outcome() == "stays up for 5.0 s"


def test_the_score_is_its_formula(states: States) -> None:
    states["velocity_command"][...] = (0.5, 0.0, 0.0)
    measures = record(states).measures(5.0, "", True)
    assert measures.tracking == pytest.approx(np.exp(-(0.5**2) / 0.25))
    assert measures.score == pytest.approx(0.7 * measures.tracking + 0.3)


def test_a_policy_that_follows_a_motion_is_scored_by_its_joints(states: States) -> None:
    error = np.array((0.25, 3.0), np.float32)  # of joints and anchor
    measures = record(states, motion_error=error).measures(5.0, "", False)
    assert measures.follows
    assert measures.motion_error == pytest.approx(0.25)
    assert measures.tracking == pytest.approx(np.exp(-1.0))
    assert measures.score == pytest.approx(0.7 * measures.tracking + 0.3)
    assert not record(states).measures(5.0, "", False).follows


def test_a_fault_scores_the_share_of_its_time(states: States) -> None:
    measures = record(states, 100).measures(5.0, "the base leans", True)
    assert measures.survival == pytest.approx(0.4)
    assert measures.score == pytest.approx(0.4)
    assert measures.outcome() == "stops after 2.00 s"


def test_what_the_flow_does_before_the_policy_counts_for_nothing(states: States) -> None:
    """A Go2 that stands up for 2.5 s and then falls at once has not survived a third of the run."""
    states["velocity_command"][...] = (0.6, 0.0, 0.0)
    recorder = record(states, 125, walking=False)
    states["base_lin_vel"][...] = (0.6, 0.0, 0.0)
    for _ in range(100):
        recorder(True)
    measures = recorder.measures(5.0, "the base leans", True)
    assert measures.survived_s == pytest.approx(2.0)
    assert measures.tracking == pytest.approx(1.0)
    assert measures.survival == pytest.approx(0.4)


def test_a_run_that_the_flow_ends_itself_survived(states: States) -> None:
    assert record(states, 100).measures(5.0, "", True).survival == 1.0


def test_a_tilt_of_more_than_60_degrees_is_a_fall(states: States) -> None:
    recorder = record(states, 10)
    assert not recorder.fell
    states["projected_gravity"][...] = (0.87, 0.0, -0.49)
    assert recorder(True)
    assert recorder.measures(5.0, "", True).outcome() == "falls after 0.22 s"


def test_sinking_is_a_fall_only_under_a_policy(states: States) -> None:
    for walking in (True, False):
        recorder = record(states, 10, walking)
        states["base_pos_w"][2] = 0.1
        assert recorder(walking) is walking


def test_changes_of_targets_and_torques_are_measured(states: States) -> None:
    robot = load_robot("go2")
    recorder = record(states, 2)
    states["joint_effort"][3] = robot.effort_limit[3]
    for k in range(200):
        states["joint_pos_target"][...] += 0.02 * (-1) ** k  # 1 rad/s
        recorder(True)
    measures = recorder.measures(5.0, "", False)
    assert measures.target_rate == pytest.approx(1.0, rel=0.01)
    assert measures.torque_joint == robot.joint_names[3]
    assert measures.torque_use == pytest.approx(1.0, rel=0.02)
    assert measures.saturated == pytest.approx(1 / 12, rel=0.02)
    assert measures.score == pytest.approx(np.exp(-((measures.target_rate / 15.0) ** 2)))


def test_joints_at_their_limits_are_named(states: States) -> None:
    robot = load_robot("go2")
    recorder = record(states, 10)
    states["joint_pos"][5] = robot.upper[5]
    for _ in range(10):
        recorder(True)
    assert recorder.measures(0.4, "", True).limit_hits == {robot.joint_names[5]: 0.5}


def test_a_run_without_ticks_scores_nothing(states: States) -> None:
    assert record(states, 0).measures(5.0, "no link", True).score == 0.0


def test_a_finding_is_one_line() -> None:
    finding = Finding("pose.feet", "policy 'walk'", "it kneels", "stand up", "policy.yaml")
    assert str(finding) == "policy 'walk': it kneels; stand up  [pose.feet, policy.yaml]"


def test_a_table_is_aligned() -> None:
    section = Section("Joints", ("joint", "kp"), (("hip", "40"), ("shoulder", "8")), ("two",))
    assert section.text().splitlines() == [
        "Joints",
        "  joint     kp",
        "  ────────  ──",
        "  hip       40",
        "  shoulder  8",
        "  two",
    ]


def test_the_text_ends_with_the_number_of_findings() -> None:
    result = CheckResult("toy")
    assert result.text().endswith("clean")
    for count, told in ((1, "1 finding"), (2, "2 findings")):
        result.find("graph", "block 'a'", "wrong", "mend it")
        assert len(result.findings) == count
        assert result.text().endswith(told)


def test_what_explains_other_findings_comes_first() -> None:
    result = CheckResult("toy")
    for code in ("gains.stiff", "safety.partial", "pose.start", "pose.feet", "limits.effort"):
        result.find(code, code, "seen", "mend it")
    result.sort()
    order = [finding.code for finding in result.findings]
    assert order == ["limits.effort", "gains.stiff", "pose.feet", "pose.start", "safety.partial"]
