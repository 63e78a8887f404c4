"""Which finding the twin tells: what the model shows before what fits, and only what is clear."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="the twin runs in MuJoCo")

from unicon_core.check import CheckResult
from unicon_core.check.result import PolicyResult
from unicon_core.check.twin.check import _Twin
from unicon_core.check.twin.measures import (
    MENDED,
    Compared,
    Measures,
    Tried,
    chosen,
    find_pressing,
)
from unicon_core.check.twin.perturb import Change, evident_changes, perturbations, rivals
from unicon_core.policies import PolicyContract
from unicon_core.policies.contract import ActionSpec, ObservationSpec, ObservationTerm, PhaseSpec
from unicon_core.robots import load_robot

GO2 = load_robot("go2")
LEGS = GO2.joint_names


def contract(joints: tuple[str, ...] = LEGS) -> PolicyContract:
    n = len(joints)
    return PolicyContract(
        name="walk",
        path=Path("walk.yaml"),
        model=Path("walk.onnx"),
        period=0.02,
        joints=joints,
        default_joint_pos=GO2.default_joint_pos[:n],
        stiffness=np.full(n, 40.0, np.float32),
        damping=np.full(n, 2.0, np.float32),
        observation=ObservationSpec((ObservationTerm("gyro", "base_ang_vel"),)),
        action=ActionSpec(joints, np.full(n, 0.25, np.float32), np.zeros(n, np.float32)),
        phase=PhaseSpec(0.8, (0.0, np.pi)),
    )


def run(score: float, rate: float = 2.0, **more: Any) -> Measures:
    """A walk that stays up and has this score and this rate of targets in [rad/s]."""
    smoothness = float(np.exp(-((rate / 15.0) ** 2)))
    tracking = (score - 0.3 * smoothness) / 0.7
    figures = {"survived_s": 5.0, "survival": 1.0, "smoothness": smoothness, **more}
    walk = (0.6, 0.0, 0.0)
    return Measures(5.0, "", command=walk, target_rate=rate, tracking=tracking, **figures)


FALL = Measures(5.0, "", survived_s=2.0, fell=True, survival=0.4, tracking=0.3, smoothness=0.9)


def tried(score: float, number: int, culprit: str, evidence: str = "") -> Tried:
    change = Change(culprit, culprit, contract(), evidence=evidence)
    return Tried(PolicyResult(CheckResult("w"), "walk", contract()), change, run(score), number)


PASSIVE = tried(0.75, 0, "passive damping of the model", "29 of 29 joints damp themselves")
COSINES = tried(0.83, 90, "observation.terms, scale of 'cos'")


def test_what_the_model_shows_comes_before_what_fits_a_little_better() -> None:
    told = chosen([PASSIVE, COSINES], FALL, MENDED)
    assert [each.change.culprit for each in told] == ["passive damping of the model"]


def test_what_the_model_shows_gives_way_to_what_fits_far_better() -> None:
    right = tried(0.94, 50, "default_joint_pos")
    assert chosen([PASSIVE, right], FALL, MENDED)[0] is right


def test_what_the_model_shows_is_not_told_where_it_does_not_suffice() -> None:
    little = tried(0.5, 0, "passive damping of the model", "29 of 29 joints damp themselves")
    assert chosen([little, COSINES], FALL, MENDED)[0] is COSINES


def test_of_what_does_as_well_the_likeliest_is_told_and_nothing_where_all_is_little() -> None:
    order, sign = tried(0.82, 3, "order"), tried(0.83, 80, "sign")
    assert chosen([sign, order], FALL, MENDED) == [order, sign]
    assert chosen([order, sign], run(0.7), MENDED) == []


@pytest.mark.parametrize(
    ("before", "after", "clear", "slight"),
    [
        ([0.80, 0.81, 0.79, 0.80], [0.86, 0.87, 0.85, 0.87], True, True),
        ([0.83, 0.82, 0.83, 0.84], [0.80, 0.80, 0.81, 0.82], False, False),
        ([0.92, 0.92, 0.91, 0.92], [0.93, 0.93, 0.92, 0.94], False, True),  # all of them a little
        ([0.69, 0.70, 0.69, 0.68], [0.75, 0.76, 0.75, 0.74], False, True),  # of much that it lacks
        ([0.90, 0.91, 0.89, 0.90], [0.94, 0.95, 0.94, 0.95], True, True),  # nearly half of it
        ([0.80, 0.80, 0.80, 0.80], [0.81, 0.79, 0.80, 0.80], False, False),  # noise
        ([0.80, 0.80, 0.80, 0.80], [1.00, 0.82, 0.78, 0.80], False, False),  # one of them much
    ],
)
def test_a_gain_is_clear_where_it_is_large_and_the_same_in_all_walks(
    before: list[float], after: list[float], clear: bool, slight: bool
) -> None:
    compared = Compared(tuple(map(run, before)), tuple(map(run, after)))
    assert (compared.clear, compared.slight) == (clear, slight)
    assert f"± {compared.error:.2f}, mean of 4 commands" in str(compared)


def test_calmer_steps_count_only_where_the_command_is_followed_as_well() -> None:
    given = (run(0.80, rate=2.25),)
    assert Compared(given, (run(0.80, rate=1.36),)).calmer
    assert not Compared(given, (run(0.80, rate=1.9),)).calmer
    assert not Compared(given, (run(0.70, rate=1.36),)).calmer
    assert not Compared(given, (replace(run(0.80, rate=1.36), fell=True),)).calmer


def _twin(monkeypatch: pytest.MonkeyPatch, after: list[float]) -> _Twin:
    """A twin whose walks under any change have these scores, and 0.83 under the given contract."""
    result = CheckResult("w")
    nothing: Any = None
    twin = _Twin(nothing, 5.0, result, Path("w.yaml"))
    twin.policies.append(PolicyResult(result, "walk", contract()))
    walks = Compared(tuple(run(0.83) for _ in after), tuple(map(run, after)))
    monkeypatch.setattr(twin, "compared", lambda tried: walks)
    monkeypatch.setattr(twin, "mend", lambda *_: [])
    return twin


def _suspect(twin: _Twin, name: str) -> CheckResult:
    broken = next(c for c in perturbations(_uneven(), [0, 1, 2] * 4) if c.name == name)
    assert broken.contract is not None
    twin.suspect(run(0.83), [Tried(twin.policies[0], broken, run(0.80), 0)])
    return twin.result


def _uneven() -> PolicyContract:
    return replace(contract(), stiffness=np.array([40, 60, 80] * 4, np.float32))


def test_a_policy_that_bears_other_gains_is_not_accused(monkeypatch: pytest.MonkeyPatch) -> None:
    result = _suspect(_twin(monkeypatch, [0.80, 0.79, 0.81]), "gains in another order")
    assert result.clean
    assert "the twin does not tell which is right" in str(result.notes[0])


def test_other_gains_that_walk_clearly_better_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    result = _suspect(_twin(monkeypatch, [0.93, 0.92, 0.93]), "gains in another order")
    (finding,) = result.findings
    assert "gains in another order it does better than with the given contract" in finding.evidence
    assert "score 0.93 against 0.83 ± 0.00, mean of 3 commands" in finding.evidence


def test_a_policy_that_bears_another_joint_order_is_suspect(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    order = "joint order of the other kind of simulator"
    (finding,) = _suspect(_twin(monkeypatch, [0.80, 0.81, 0.82]), order).findings
    assert finding.evidence.endswith("yours is suspect")
    assert _suspect(_twin(monkeypatch, [0.6, 0.5, 0.6]), order).clean


def _rival(
    monkeypatch: pytest.MonkeyPatch,
    scores: dict[str, Measures],
    given: Measures,
    period: float = 0.02,
    mended: list[Tried] | None = None,
) -> Any:
    result = CheckResult("w")
    nothing: Any = None
    twin = _Twin(nothing, 5.0, result, Path("w.yaml"))
    twin.policies.append(PolicyResult(result, "walk", replace(contract(), period=period)))

    def walks(tried: Tried) -> Compared:
        return Compared((given,) * 3, (scores.get(tried.change.name, run(0.3)),) * 3)

    monkeypatch.setattr(twin, "run", lambda _, change: scores.get(change.name, run(0.3)))
    monkeypatch.setattr(twin, "compared", walks)
    told = [replace(each, policy=twin.policies[0]) for each in mended or []]
    monkeypatch.setattr(twin, "mend", lambda _: told)
    twin.rival(given)
    return result


def test_a_clock_that_is_too_fast_shows_in_the_rate_of_targets(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    given, slow = run(0.80, rate=2.25), run(0.81, rate=1.36)
    (finding,) = _rival(monkeypatch, {"a gait clock of 1.6 s": slow}, given).findings
    assert finding.culprit == "policy 'walk', phase.period"
    assert "does as well, in calmer steps" in finding.evidence
    assert "targets change at 1.36 against 2.25 rad/s" in finding.evidence


def test_calmer_steps_of_another_damping_are_none_of_a_clock(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    given, other = run(0.80, rate=2.25), run(0.80, rate=1.36)
    assert _rival(monkeypatch, {"damping times 0.5": other}, given).clean


def test_damping_that_takes_much_less_torque_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    given, lighter = run(0.81, torque_use=0.37), run(0.80, torque_use=0.20)
    (finding,) = _rival(monkeypatch, {"damping times 0.5": lighter}, given).findings
    assert finding.culprit == "policy 'walk', damping"
    assert "it does as well, with less torque, as with the given contract" in finding.evidence
    assert finding.evidence.endswith("torque 20% against 37% of the limit")


def test_a_quicker_clock_takes_less_torque_by_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    given, quick = run(0.92, torque_use=0.37), run(0.91, torque_use=0.24)
    assert _rival(monkeypatch, {"a gait clock of 0.4 s": quick}, given).clean


@pytest.mark.parametrize(("score", "clean"), [(0.94, True), (0.945, False)])
def test_an_unusual_period_has_to_walk_better(
    score: float, clean: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    scores = {"a period of 0.02 s": run(score), "a period of 0.005 s": run(0.945)}
    result = _rival(monkeypatch, scores, run(0.942), period=0.01)
    assert result.clean == clean
    if not clean:
        assert "does as well as with the given contract" in result.findings[0].evidence
        assert result.findings[0].evidence.endswith("(most policies have 0.02 s)")


def test_a_walk_that_scores_little_is_searched_for_other_mistakes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scores = {COSINES.change.name: run(0.95), "a period of 0.01 s": run(0.72)}
    (finding,) = _rival(monkeypatch, scores, run(0.66), mended=[COSINES]).findings
    assert finding.culprit.endswith(COSINES.change.culprit)
    assert not _rival(monkeypatch, {}, run(0.85), mended=[COSINES]).findings


def test_only_the_best_of_the_rivals_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    scores = {"damping times 0.5": run(0.86), "a period of 0.01 s": run(0.95)}
    result = _rival(monkeypatch, scores, run(0.78))
    assert [each.culprit for each in result.findings] == ["policy 'walk', period"]
    assert not result.notes
    slight = _rival(monkeypatch, {"damping times 0.5": run(0.94)}, run(0.91))
    assert slight.clean
    assert "damping times 0.5 it does slightly better" in str(slight.notes[0])


def test_half_and_twice_are_tried_of_damping_period_and_clock() -> None:
    names = [change.name for change in rivals(contract())]
    assert names == [
        "damping times 0.5", "a period of 0.01 s", "a gait clock of 0.4 s",
        "damping times 2", "a period of 0.04 s", "a gait clock of 1.6 s",
    ]  # fmt: skip
    assert len([*rivals(replace(contract(), phase=None))]) == 4


def test_the_model_speaks_for_damping_that_is_counted_twice_and_for_joints_unknown() -> None:
    passive = np.full(12, 0.1)
    assert not [*evident_changes(contract(), GO2, passive, "mujoco")]
    passive[4] = 2.0
    (change,) = evident_changes(contract(), GO2, passive, "mujoco")
    assert change.without == "undamped"
    assert f"1 of 12 joints damp themselves beside the policy's damping, {LEGS[4]} by 2 and 2" in (
        change.evidence
    )
    assert "platforms: {mujoco: {passive: replace}}" in change.remedy
    (change,) = evident_changes(contract(LEGS[:9]), GO2, np.zeros(12), "mujoco")
    assert change.locked == LEGS[9:]
    assert "neither moves nor sees" in change.evidence


def _pressed(**figures: Any) -> CheckResult:
    result = CheckResult("w")
    find_pressing(PolicyResult(result, "walk", contract()), GO2, run(0.8, **figures))
    return result


def test_a_joint_that_presses_against_its_limit_is_found() -> None:
    (finding,) = _pressed(saturated_joint=LEGS[0], saturated_share=0.28).findings
    assert finding.code == "twin.saturated"
    assert f"effort of {LEGS[0]}" in finding.culprit
    assert "at its effort limit for 28% of the time" in finding.evidence
    assert _pressed(saturated_joint=LEGS[0], saturated_share=0.15).clean
    (finding,) = _pressed(limit_hits={LEGS[2]: 0.3, LEGS[5]: 0.1}).findings
    assert f"position of {LEGS[2]}" in finding.culprit


def test_a_joint_whose_place_is_at_its_limit_may_be_there() -> None:
    result = CheckResult("w")
    pose = np.array(GO2.default_joint_pos)
    pose[2] = GO2.upper[2] - 0.02
    policy = PolicyResult(result, "walk", replace(contract(), default_joint_pos=pose))
    find_pressing(policy, GO2, run(0.8, limit_hits={LEGS[2]: 1.0}))
    assert result.clean


def test_scales_of_one_and_zero_cannot_be_left_out() -> None:
    scale = np.array([0.0, 1.0, 1.0], np.float32)
    terms = (ObservationTerm("gyro", "base_ang_vel", scale=scale),)
    masked = replace(contract(), observation=ObservationSpec(terms))
    assert perturbations(masked, [0, 1, 2] * 4)[0].name.startswith("observation scales doubled")
