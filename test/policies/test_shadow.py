"""A policy beside another one: it changes nothing until it drives, and begins warm."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from shadow_helpers import WORKFLOW, ask, older, ran, same

from unicon_base import UniconError
from unicon_core.policies.shadow import ShadowedPolicy
from unicon_core.runtime import Runner
from unicon_core.workflow import Program, load_document

pytest.importorskip("mujoco", reason="mujoco is not installed: pip install 'unicon_ros[sim]'")
pytest.importorskip("onnxruntime", reason="pip install onnxruntime")

FIT = 55
"""Tick behind which B has been fit for 1 s."""


def broken(how: str) -> Any:
    """Return what breaks B's network: it gives NaN, raises, or lets a target jump."""

    def act(shadowed: ShadowedPolicy, _: Runner) -> None:
        lane = shadowed.b.lane
        infer, times = lane.infer, [0]

        def bad() -> None:
            infer()
            times[0] += 1
            if how == "raises":
                raise RuntimeError("no such kernel")
            if how == "nan":
                lane.action[0, 3] = np.nan
            if how == "jumps" and times[0] == 1:
                lane.action[0, 3] += 6.0

        lane.infer = bad

    return act


def test_it_changes_no_command_and_is_compared_by_joint(tmp_path: Path) -> None:
    path = tmp_path / "w.yaml"
    alone = ran(path, None, 1.0)
    beside = ran(path, older(tmp_path / "b"), 1.0)
    assert beside.report.sha256_commands == alone.report.sha256_commands
    rows = beside.rows
    apart = rows["shadow_walk_joint_pos_target"] - rows["joint_pos_target"]
    np.testing.assert_allclose(rows["shadow_walk_target_difference"], apart, atol=1e-6)
    assert 0.05 < np.abs(apart).max() < 0.4
    said = beside.report.to_dict()["shadow"]
    assert said["ticks"] == 50
    assert said["largest_rad"] == pytest.approx(np.abs(apart).max(), abs=1e-4)
    assert said["rms_rad"][said["joint"]] > 0.01
    assert f"of {said['joint']}, in 50 ticks" in beside.report.summary()
    assert rows["shadow_walk_time"][1:].min() > 0.0  # of the tick before


def test_what_both_see_is_compared_by_term(tmp_path: Path) -> None:
    """Whatever their order of joints and history: by term, element and age."""
    said = yaml.safe_load((older(tmp_path / "b") / "policy.yaml").read_text())
    names, terms = said["joints"], said["observation"]["terms"]
    order = [3, 4, 5, 0, 1, 2, *range(6, 12)]
    changed = [dict(term) for term in terms]
    changed[0]["scale"] = 2.0 * terms[0]["scale"]
    changed[1]["name"] = "down"
    b = older(
        tmp_path / "c",
        joints=[names[i] for i in order],
        default_joint_pos=[said["default_joint_pos"][i] for i in order],
        observation=said["observation"] | {"terms": changed},
    )
    run = ran(tmp_path / "w.yaml", b, 0.4)
    found, rows = run.report.to_dict()["shadow"], run.rows["observation"][:, :3]
    common = [term["name"] for term in terms if term["name"] != "projected_gravity"]
    assert list(found["rms_seen"]) == list(found["largest_seen"]) == common
    # Twice the scale: the difference is what the first policy sees.
    turned = terms[0]["name"]
    assert found["rms_seen"][turned] == pytest.approx(np.sqrt((rows**2).mean()), rel=1e-4)
    assert found["largest_seen"][turned] == pytest.approx(np.abs(rows).max(), rel=1e-4)
    others = [value for term, value in found["largest_seen"].items() if term != turned]
    assert max(others) < 1e-5  # last_action by way of the target


ROBOT = """\
robot: go2
platform: fake_robot
policies: {walk: go2_velocity}
rate: 50
start: {operator: false, fade_in: 0.2, approach: 10.0}
flow: {chain: [{loop: {do: {policy: walk}, until: {elapsed: 0.5}}}, {hold: {duration: 0.3}}]}
wind_down: {hold: {duration: 0.2}}
safety: [finite]
"""


def test_in_the_approach_and_behind_the_policy_a_swap_is_refused_at_once(tmp_path: Path) -> None:
    answers: dict[str, set[str]] = {}

    def always(shadowed: ShadowedPolicy, runner: Runner) -> None:
        done, said = shadowed.ask()
        answers.setdefault(runner.phase.value, set()).add(said)
        assert not done

    acts = dict.fromkeys(range(1, 500), always)
    run = ran(tmp_path / "w.yaml", older(tmp_path / "b"), 3.0, acts, text=ROBOT, speed="real")
    assert (run.report.ended, run.report.faults) == ("done", [])
    idle = "refused: policy walk does not run"
    assert answers["approach"] == answers["soft"] == answers["damp"] == {idle}
    young = "refused: shadow_walk has been fit for 0.02 s of 1 s: it did not run before"
    assert {idle, young} < answers["run"]
    assert not run.rows["shadow_walk_share"].any()
    assert not run.rows["shadow_walk_request"].any()


def test_it_sees_what_was_executed_in_its_own_action_space(tmp_path: Path) -> None:
    names = yaml.safe_load((older(tmp_path / "b") / "policy.yaml").read_text())["joints"]
    order = [3, 4, 5, 0, 1, 2, *range(6, 12)]
    default = [-0.1, 0.8, -1.6, 0.1, 0.8, -1.6] * 2
    changed = {
        "joints": [names[i] for i in order],
        "default_joint_pos": [default[i] for i in order],
        "action": {"scale": 0.5, "clip": [-8.0, 8.0]},
    }
    rows = ran(tmp_path / "w.yaml", older(tmp_path / "c", **changed), 0.4).rows
    shadow = rows["shadow_walk_action"]
    expected = (rows["joint_pos_target"][:, order] - [default[i] for i in order]) / 0.5
    np.testing.assert_allclose(shadow, expected, atol=1e-6)
    np.testing.assert_allclose(rows["action"][:, order], 2.0 * shadow, atol=1e-5)
    # A policy that drives sees its own output, bit-exact.
    alone = ran(tmp_path / "v.yaml", None, 0.4).rows
    assert (alone["action"] == rows["action"]).all()


def test_the_same_policy_beside_itself_is_warm_in_the_tick_it_takes_over(tmp_path: Path) -> None:
    """History, memory and last action are as if it had driven all along."""
    path = tmp_path / "w.yaml"
    alone = ran(path, None, 2.0)
    swapped = ran(path, same(tmp_path / "b"), 2.0, {FIT: ask})
    assert swapped.answers == [(True, "shadow_walk takes over from walk")]
    share = swapped.rows["shadow_walk_share"]
    assert share[FIT - 1] == 0.0
    np.testing.assert_allclose(share[FIT : FIT + 16], np.arange(1, 17) / 16, atol=1e-6)
    assert share[-1] == 1.0
    apart = swapped.rows["joint_pos_target"] - alone.rows["joint_pos_target"]
    assert np.abs(apart).max() < 0.02
    assert swapped.report.extra["shadow"]["drives"] == "shadow_walk"


def test_a_swap_is_a_blend_of_both_and_one_press_leads_back(tmp_path: Path) -> None:
    path, b = tmp_path / "w.yaml", older(tmp_path / "b")
    plain = ran(path, b, 4.0)
    back = ran(path, b, 4.0, {FIT: ask, FIT + 40: ask, FIT + 45: ask, 170: ask})
    assert [done for done, _ in back.answers] == [True, True, False, True]
    assert back.events == ["shadow_walk takes over", "back to walk", "shadow_walk takes over"]
    assert back.answers[2][1] == "refused: the blend back to walk goes on"
    share = back.rows["shadow_walk_share"]
    assert share[FIT + 30] == 1.0
    assert share[FIT + 60] == 0.0
    assert share[-1] == 1.0
    mixed, theirs = back.rows["joint_pos_target"], back.rows["shadow_walk_joint_pos_target"]
    ours = theirs - back.rows["shadow_walk_target_difference"]
    expected = ours + share[:, None] * (theirs - ours)
    np.testing.assert_allclose(mixed, expected, atol=1e-5)
    assert back.steps[FIT:].max() < 1.5 * plain.steps[FIT:].max()
    assert back.report.fell is False


def test_it_runs_once_in_each_tick_wherever_it_stands(tmp_path: Path) -> None:
    runs: list[int] = []

    def count(shadowed: ShadowedPolicy, _: Runner) -> None:
        infer = shadowed.b.lane.infer
        shadowed.b.lane.infer = lambda: (runs.append(1), infer())[1]

    acts = {1: count, FIT: ask, FIT + 30: ask}
    run = ran(tmp_path / "w.yaml", older(tmp_path / "b"), 2.4, acts)
    assert run.rows["shadow_walk_share"][[FIT + 20, -1]].tolist() == [1.0, 0.0]
    assert len(runs) == 119
    # What both see stays the same throughout, the last action too.
    assert max(run.report.extra["shadow"]["largest_seen"].values()) < 1e-5


def test_a_press_in_the_blend_turns_it_round_where_it_is(tmp_path: Path) -> None:
    acts = {FIT: ask, FIT + 1: ask, FIT + 8: ask}
    run = ran(tmp_path / "w.yaml", older(tmp_path / "b"), 1.6, acts)
    assert run.answers == [
        (True, "shadow_walk takes over from walk"),
        (True, "back to walk"),
        (False, "refused: shadow_walk has been fit for 0.12 s of 1 s: it has just driven"),
    ]
    share = run.rows["shadow_walk_share"]
    assert share[FIT : FIT + 3] == pytest.approx([1 / 16, 0.0, 0.0])


def test_two_doors_at_once_are_one_request(tmp_path: Path) -> None:
    def twice(shadowed: ShadowedPolicy, _: Runner) -> Any:
        return shadowed.ask(), shadowed.ask()

    run = ran(tmp_path / "w.yaml", older(tmp_path / "b"), 1.6, {FIT: twice})
    assert [done for done, _ in run.answers[0]] == [True, False]
    assert run.answers[0][1][1] == "refused: it was asked for just now"
    assert run.events == ["shadow_walk takes over"]


@pytest.mark.parametrize(
    ("how", "reason"),
    [
        ("nan", "Fault: policy go2_velocity: the action is not finite: joint 'FL_hip_joint'"),
        ("raises", "RuntimeError: no such kernel"),
    ],
)
def test_its_mistakes_disturb_nothing_and_put_it_out(tmp_path: Path, how: str, reason: str) -> None:
    path, b = tmp_path / "w.yaml", older(tmp_path / "b")
    alone = ran(path, None, 1.4)
    run = ran(path, b, 1.4, {20: broken(how), FIT: ask})
    assert run.report.sha256_commands == alone.report.sha256_commands
    done, why = run.answers[1]
    assert not done
    assert why.startswith(f"refused: shadow_walk is out: {reason}")
    assert len(run.events) == 1
    assert "shadow_walk is out" in run.report.summary()
    # While it drives, the first policy takes over in the same tick.
    run = ran(path, b, 2.4, {FIT: ask, FIT + 25: broken(how), FIT + 60: ask})
    assert run.report.faults == []
    assert run.report.fell is False
    assert "back to walk by itself" in run.events[2]
    assert run.answers[2][1].startswith("refused: shadow_walk is out")
    assert run.rows["shadow_walk_share"][-1] == 0.0


def test_at_real_rate_its_mistakes_are_none_of_the_run_either(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ticks are warmed up there: by what drives."""
    monkeypatch.setattr("unicon_core.policies.shadow.CALM", 0.2)
    acts = {15: ask, 38: broken("raises")}
    run = ran(tmp_path / "w.yaml", older(tmp_path / "b"), 1.2, acts, speed="real")
    assert run.report.faults == []
    assert run.events[0] == "shadow_walk takes over"
    assert run.events[1] == "shadow_walk is out: RuntimeError: no such kernel"
    assert run.rows["shadow_walk_share"][-1] == 0.0


def test_a_target_that_jumps_leads_back_and_only_a_new_request_away(tmp_path: Path) -> None:
    acts = {FIT: ask, FIT + 25: broken("jumps"), FIT + 50: ask, FIT + 110: ask}
    run = ran(tmp_path / "w.yaml", older(tmp_path / "b"), 3.8, acts)
    assert [run.answers[i][0] for i in (0, 2, 3)] == [True, False, True]
    assert "fit for 0." in run.answers[2][1]
    back = "back to walk by itself: shadow_walk: its target of FL_hip_joint steps by 1."
    assert run.events[1].startswith(back)
    assert run.events[2:] == ["shadow_walk takes over"]
    share = run.rows["shadow_walk_share"]
    assert share[FIT + 24] == 1.0
    assert (np.diff(share[FIT + 24 : FIT + 109]) <= 0.0).all()
    assert run.report.fell is False
    assert run.steps[FIT:].max() < 0.45


def test_ticks_that_take_too_long_put_it_out_or_lead_back(tmp_path: Path) -> None:
    def slow(shadowed: ShadowedPolicy, _: Runner) -> None:
        shadowed._limit = 0.0

    path, b = tmp_path / "w.yaml", older(tmp_path / "b")
    run = ran(path, b, 1.4, {20: slow, FIT: ask})
    assert run.answers[1][1] == "refused: shadow_walk is out: 3 ticks took over 0 ms"
    run = ran(path, b, 2.0, {FIT: ask, FIT + 25: slow})
    assert run.events[1].startswith("back to walk by itself: shadow_walk: 3 ticks took over")
    assert run.report.fell is False


def test_joints_in_another_order_are_refused(tmp_path: Path) -> None:
    names = yaml.safe_load((older(tmp_path / "b") / "policy.yaml").read_text())["joints"]
    names[2], names[5] = names[5], names[2]
    run = ran(tmp_path / "w.yaml", older(tmp_path / "c", joints=names), 1.4, {FIT: ask})
    assert not run.answers[0][0]
    assert "calf_joint differs from walk by 0." in run.answers[0][1]


STANDS = WORKFLOW.replace(
    "flow: {policy: walk}",
    "flow: {chain: [{hold: {duration: 0.5}}, {loop: {do: {policy: walk}, until: {elapsed: 2.0}}},"
    " {hold: {duration: 0.5}}]}\nwind_down: {hold: {duration: 0.5}}",
)


def test_it_is_refused_where_the_policy_does_not_run(tmp_path: Path) -> None:
    b = older(tmp_path / "b")
    run = ran(tmp_path / "w.yaml", b, 9.0, {10: ask, 40: ask, 135: ask, 160: ask}, text=STANDS)
    assert run.answers[0] == (False, "refused: policy walk does not run")
    assert "fit for 0.3" in run.answers[1][1]
    assert run.answers[2:] == [(False, "refused: policy walk does not run")] * 2
    assert run.events == []
    assert run.report.faults == []


def test_what_drives_stays_where_the_flow_begins_anew(tmp_path: Path) -> None:
    def reset(_: ShadowedPolicy, runner: Runner) -> None:
        runner.call_soon(runner.reset)

    run = ran(tmp_path / "w.yaml", older(tmp_path / "b"), 2.0, {FIT: ask, FIT + 5: reset})
    assert run.rows["shadow_walk_share"][FIT + 6] == 1.0
    assert run.report.fell is False


def test_a_fault_of_the_first_policy_is_one_as_ever_unless_it_is_shadow(tmp_path: Path) -> None:
    def nan(shadowed: ShadowedPolicy, _: Runner) -> None:
        broken("nan")(type("A", (), {"b": shadowed.a}), _)

    path, b = tmp_path / "w.yaml", older(tmp_path / "b")
    alone = "policy go2_velocity: the action is not finite: joint 'FL_hip_joint' is nan"
    run = ran(path, b, 1.0, {20: nan})
    assert run.report.faults[0].startswith(alone)
    run = ran(path, b, 2.4, {FIT: ask, FIT + 25: nan, FIT + 30: ask})
    assert run.report.faults == []
    assert run.answers[2][1].startswith("refused: walk is out")
    run = ran(path, b, 2.4, {FIT: ask, FIT + 25: nan, FIT + 30: broken("jumps")})
    assert "steps by 1." in run.report.faults[0]
    assert "; walk: Fault" in run.report.faults[0]


def test_a_gait_clock_is_waited_for(tmp_path: Path) -> None:
    b = older(tmp_path / "b", phase={"period": 0.5})
    run = ran(tmp_path / "w.yaml", b, 1.8, {FIT: ask, FIT + 1: ask})
    assert run.answers[1][1] == "refused: shadow_walk waits for its gait phase already"
    (first, *_) = np.flatnonzero(run.rows["shadow_walk_share"])
    phase = run.rows["shadow_walk_gait_phase_sin"][first - 1]
    assert FIT + 2 < first < FIT + 26
    assert 0.0 <= phase[0] < np.sin(2 * np.pi * 0.02 / 0.5) + 1e-6


def test_what_waits_for_its_phase_and_fails_does_not_drive(tmp_path: Path) -> None:
    b = older(tmp_path / "b", phase={"period": 0.9})
    run = ran(tmp_path / "w.yaml", b, 3.0, {FIT: ask, FIT + 1: broken("nan")})
    assert run.answers[0][0]
    assert len(run.events) == 1
    assert run.events[0].startswith("shadow_walk is out")
    assert not run.rows["shadow_walk_share"].any()


def test_another_history_begins_with_what_was_executed(tmp_path: Path) -> None:
    """The terms of B need not be those of A: here with two frames, of which it sees one twice."""
    b = older(tmp_path / "b")
    said = yaml.safe_load((b / "policy.yaml").read_text())
    terms = said["observation"]["terms"]
    terms[-1] = terms[-1] | {"history": 1, "filter": {"moving_average": 2}}
    b = older(tmp_path / "c", observation=said["observation"])
    run = ran(tmp_path / "w.yaml", {"path": str(b), "bound": 1.0}, 1.6, {FIT: ask})
    seen = run.rows["shadow_walk_observation"][2:FIT, -12:]
    given = run.rows["shadow_walk_action"]
    np.testing.assert_allclose(seen, (given[1 : FIT - 1] + given[: FIT - 2]) / 2, atol=1e-5)
    assert run.answers == [(True, "shadow_walk takes over from walk")]


def test_it_may_see_the_ground_though_the_first_policy_is_blind(tmp_path: Path) -> None:
    terms = yaml.safe_load((older(tmp_path / "b") / "policy.yaml").read_text())["observation"]
    terms["terms"].append({"name": "ground", "state": "height_scan"})
    grid = {"size": [0.2, 0.2], "resolution": 0.1}
    b = older(tmp_path / "c", unused=9, observation=terms, height_scan=grid)
    run = ran(tmp_path / "w.yaml", b, 1.4, {FIT: ask})
    assert run.events == ["shadow_walk takes over"]
    scan = run.rows["shadow_walk_height_scan"]
    assert scan.shape[1] == 9
    assert ((scan > 0.2) & (scan < 0.4)).all()
    assert (run.rows["shadow_walk_observation"][:, 45:] == scan).all()


def refused(tmp_path: Path, overrides: dict[str, Any], text: str = WORKFLOW) -> str:
    (tmp_path / "w.yaml").write_text(text)
    with pytest.raises(UniconError) as caught:
        Program(load_document(tmp_path / "w.yaml", overrides)).close()
    return str(caught.value)


def test_contracts_that_disagree_are_refused_when_the_workflow_is_built(tmp_path: Path) -> None:
    names = yaml.safe_load((older(tmp_path / "b") / "policy.yaml").read_text())["joints"]
    for number, (changes, said) in enumerate(
        (
            ({"period": 0.01}, "has period 0.01 s and go2_velocity 0.02 s"),
            ({"robot": "go1"}, "is of robot go1 and go2_velocity of go2"),
            (
                {"command_ranges": {"lin_vel_x": [-0.5, 0.5]}},
                "has lin_vel_x [-0.5, 0.5], which is less than [-0.5, 1] of go2_velocity",
            ),
            ({"action": {"joints": names[:-1], "scale": 0.25}}, "differ in RL_calf_joint"),
        )
    ):
        b = older(tmp_path / str(number), **{"name": "b", **changes})
        assert said in refused(tmp_path, {"shadow": {"walk": str(b)}})


def test_action_chunks_are_refused_without_advice_to_run_them_in_a_child(tmp_path: Path) -> None:
    b = same(tmp_path / "b", chunk={"size": 2})
    said = refused(tmp_path, {"shadow": {"walk": str(b)}})
    assert "go2_velocity is of action chunks, which cannot be swapped" in said


@pytest.mark.parametrize(
    ("overrides", "said"),
    [
        ({"shadow": {"wlak": "go2_velocity"}}, "no policy 'wlak' under 'policies:'"),
        ({"shadow": {"walk": "go2_velocity", "run": "x"}}, "leave all but one out"),
        ({"shadow": {"walk": "go2_velocity"}, "num_robots": 2}, "leave out num_robots"),
        (
            {"shadow": {"walk": "go2_velocity"}, "wind_down": {"policy": "walk"}},
            "stands 2 times in the flow",
        ),
        (
            {"shadow": {"walk": "go2_velocity"}, "policies": {"walk": {"path": "go2_velocity",
             "child": True}}},
            "is in a child, which cannot be swapped",
        ),
        ({"shadow": {"walk": {"path": "go2_velocity", "bound": -1}}}, "bound"),
        ({"shadow": {"walk": "nowhere"}}, "shadow 'walk': "),
        (
            {"shadow": {"walk": {"path": "go2_velocity", "child": True}}},
            "is in a child, which cannot be swapped",
        ),
    ],
)  # fmt: skip
def test_what_cannot_be_is_said_when_the_workflow_is_built(
    tmp_path: Path, overrides: dict[str, Any], said: str
) -> None:
    assert said in refused(tmp_path, overrides)


def test_a_state_that_nobody_writes_is_named(tmp_path: Path) -> None:
    b = older(tmp_path / "b")
    said = yaml.safe_load((b / "policy.yaml").read_text())
    said["observation"]["terms"][0]["state"] = "torso_rate"
    b = older(tmp_path / "c", observation=said["observation"])
    states = {"torso_rate": {"shape": [3], "unit": "rad/s"}}
    told = refused(tmp_path, {"shadow": {"walk": str(b)}, "states": states})
    assert "reads 'torso_rate', which no block writes" in told
