"""Sweep files: what they say, which rows follow, and every mistake told with its place."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from unicon_base.errors import UniconError
from unicon_core.workflow.document import split_setting
from unicon_lab.sweep.draws import parameter, setting_of
from unicon_lab.sweep.plan import Plan
from unicon_lab.sweep.sweep_file import SweepFile, read_gate, read_sweep

HEAD = "workflow: go2_stand\n"
SEEDS = "vary: {scene.seed: {range: [0, 9]}}\n"


def sweep_of(folder: Path, text: str, *overrides: str) -> SweepFile:
    path = folder / "sweep.yaml"
    path.write_text(text, "utf-8")
    return read_sweep(path, overrides)


# -- what a parameter may be -----------------------------------------------------------------------


NUMBERS = st.floats(allow_nan=False, allow_infinity=False) | st.integers(-(2**63), 2**63)
WORDS = st.text(max_size=20)


@given(NUMBERS | WORDS | st.lists(NUMBERS, max_size=3) | st.booleans() | st.none())
def test_a_value_comes_back_from_set_to_the_bit(value: Any) -> None:
    try:
        setting = setting_of("scene.x", value)
    except UniconError:  # a control character, which no YAML file can hold either
        assert isinstance(value, str)
        assert not value.isprintable()
        return
    path, back = split_setting(setting)
    assert path == "scene.x"
    assert type(back) is type(value)
    assert back == value


@given(st.floats(0.0, 1.0, exclude_max=True))
def test_every_point_has_a_value_within(u: float) -> None:
    assert 2.0 <= parameter("x", {"uniform": [2, 3]}).at(u) <= 3.0
    assert 0.1 <= parameter("x", {"log_uniform": [0.1, 10]}).at(u) <= 10.0
    assert parameter("x", {"range": [3, 5]}).at(u) in (3, 4, 5)
    assert parameter("x", ["a", "b"]).at(u) in ("a", "b")
    assert abs(parameter("x", {"normal": [1, 0.5]}).at(u) - 1.0) <= 2.0 + 1e-5
    drawn = parameter("x", {"uniform": [0, 1]}).at(u)
    assert drawn == float(f"{drawn:.6g}")


def test_draws_are_spread_as_they_say() -> None:
    places = (np.arange(1000) + 0.5) / 1000
    at = {
        kind: np.array([parameter("x", {kind: of}).at(u) for u in places])
        for kind, of in (("uniform", [2, 4]), ("log_uniform", [0.01, 1]), ("normal", [1, 0.5]))
    }
    assert at["uniform"].mean() == pytest.approx(3.0, abs=1e-3)
    assert np.median(at["log_uniform"]) == pytest.approx(0.1, rel=1e-2)
    assert at["normal"].mean() == pytest.approx(1.0, abs=1e-3)
    assert at["normal"].std() == pytest.approx(0.5, rel=2e-2)
    assert parameter("x", {"linspace": [0, 1, 3]}).values == (0.0, 0.5, 1.0)


# -- rows ------------------------------------------------------------------------------------------


def test_a_grid_has_every_combination_the_last_one_first(tmp_path: Path) -> None:
    plan = Plan(sweep_of(tmp_path, HEAD + "vary: {scene.seed: [1, 2], scene.delay: [0, 1, 2]}"))
    assert len(plan) == 6
    assert [row.values for row in plan] == [(s, d) for s in (1, 2) for d in (0, 1, 2)]
    assert plan.row(5).settings == ("scene.seed=2", "scene.delay=2")


@pytest.mark.parametrize("sample", ["random", "sobol"])
def test_a_row_follows_from_the_file_and_its_number_alone(tmp_path: Path, sample: str) -> None:
    if sample == "sobol":
        pytest.importorskip("scipy")
    text = f"{HEAD}vary: {{scene.noise.joint_vel: {{uniform: [0, 1]}}}}\nsample: {sample}\n"
    few, many = (Plan(sweep_of(tmp_path, f"{text}rollouts: {n}")) for n in (5, 60))
    assert [few.row(i).values for i in (4, 0, 2)] == [many.row(i).values for i in (4, 0, 2)]
    assert len({row.values for row in many}) == 60
    other = Plan(sweep_of(tmp_path, f"{text}rollouts: 5\nseed: 1"))
    assert other.row(0).values != few.row(0).values
    assert other.sha256 != few.sha256


def test_repeat_counts_the_seed_on(tmp_path: Path) -> None:
    text = HEAD + "set: {scene.seed: 40}\nrepeat: 3\nvary: {scene.delay: [0, 1]}"
    plan = Plan(sweep_of(tmp_path, text))
    assert [row.settings[-1] for row in plan] == [f"scene.seed={40 + k}" for k in (0, 1, 2)] * 2
    assert [row.repetition for row in plan] == [0, 1, 2] * 2


def test_what_changes_no_row_is_not_in_the_hash(tmp_path: Path) -> None:
    plain = Plan(sweep_of(tmp_path, HEAD + SEEDS))
    same = Plan(sweep_of(tmp_path, HEAD + SEEDS + "timeout: 5\ngate: fall<0.5\ndescription: x"))
    other = Plan(sweep_of(tmp_path, HEAD + SEEDS, "platform=fake"))
    assert plain.sha256 == same.sha256 != other.sha256


def test_a_workflow_beside_the_sweep_is_found(tmp_path: Path) -> None:
    (tmp_path / "w.yaml").write_text(
        "robot: go2\nplatform: fake\nrate: 50\nduration: 1\nflow: hold"
    )
    sweep = sweep_of(tmp_path, f"workflow: ./w.yaml\n{SEEDS}")
    assert Plan(sweep).document.path == tmp_path / "w.yaml"


# -- mistakes --------------------------------------------------------------------------------------

BAD = {
    "workflow: [": "1: not valid YAML",
    "[]": "1: a sweep is a mapping; begin with `schema: unicon.sweep/1`",
    SEEDS: "missing key 'workflow'; add workflow: a text",
    HEAD: "missing key 'vary'; add vary: {scene.seed: {range: [0, 99]}}",
    HEAD + "vary: []": "vary is []; write {scene.seed",
    HEAD + SEEDS + "varry: 1": "3: unknown key 'varry'; did you mean 'vary'?",
    HEAD + SEEDS + "schema: 2": "schema is 2; write unicon.sweep/1",
    HEAD + SEEDS + "sample: grit": "sample 'grit' is not known; did you mean 'grid'?",
    HEAD + SEEDS + "rollouts: 3": "rollouts is 3, which is of a drawn sample",
    HEAD + SEEDS + "sample: random": "missing key 'rollouts'; add rollouts: 1 to",
    HEAD + SEEDS + "sample: random\nrollouts: 0": "rollouts is 0; write a whole number from 1",
    HEAD + SEEDS + "sample: random\nrollouts: true": "rollouts is true; write a whole number",
    HEAD + SEEDS + "repeat: 2": "repeat counts scene.seed on, which vary says",
    HEAD + SEEDS + "set: {scene.seed: 1}": "vary.scene.seed is set and varied; take one out",
    HEAD + SEEDS + "set: [1]": "set is [1]; write {platform: mujoco}",
    HEAD + SEEDS + "early_stop: full": "early_stop 'full' is not known; did you mean 'fall'?",
    HEAD + SEEDS + "duration: -1": "duration is -1; write a number above 0 to",
    HEAD + SEEDS + "timeout: .nan": "timeout is nan; write a number above 0",
    HEAD + SEEDS + "seed: x": "seed is 'x'; write a whole number from 0",
    HEAD + SEEDS + "gate: fell<1": "gate 'fell<1': no figure 'fell'; did you mean 'fall'?",
    HEAD + SEEDS + "gate: fall<1 for each scene.sead": (
        "gate 'fall<1 for each scene.sead': 'scene.sead' is not varied; did you mean 'scene.seed'?"
    ),
    HEAD + SEEDS + "reference: r.npz": "reference is 'r.npz'; give a run that is there",
    HEAD + SEEDS + "keep: joint_pos": "keep is 'joint_pos'; write [joint_pos, base_pos_w]",
    HEAD + "vary: {a: 3}": "2: vary.a is 3; write a list of values, or one of {range:",
    HEAD + "vary: {a: {unifrom: [0, 1]}}": "vary.a has no 'unifrom'; did you mean 'uniform'?",
    HEAD + "vary: {a: {uniform: [0]}}": "vary.a uniform is [0]; write {uniform: [A, B]}",
    HEAD + "vary: {a: {uniform: [.nan, 1]}}": "vary.a uniform is [nan, 1]",
    HEAD + "vary: {a: {range: [2, 1]}}": "the first number must not be above the second",
    HEAD + "vary: {a: {range: [0.5, 1]}}": "range is [0.5, 1]; write two whole numbers",
    HEAD + "vary: {a: {range: [0, 1000000000]}}": "write two whole numbers, 100000 at most",
    HEAD + "vary: {a: {linspace: [0, 1, 1]}}": "write {linspace: [A, B, N]}, N from 2",
    HEAD + "vary: {a: {log_uniform: [0, 1]}}": "both numbers must be above 0",
    HEAD + "vary: {a: {normal: [0, 0]}}": "its standard deviation must be above 0",
    HEAD + "vary: {a: []}": "vary.a has 0 values; give 1 to 100000",
    HEAD + "vary: {a: [9223372036854775808]}": "value 9223372036854775808 is more than 63 bits",
    HEAD + "vary: {a: [.nan]}": "value nan cannot be given to --set",
    HEAD + "vary: {a: {uniform: [0, 1]}}": "vary.a is uniform, of which a grid has no end",
    HEAD
    + "vary: {a: {range: [0, 9999]}, b: {range: [0, 9999]}}": "that makes 100000000 rollouts; at "
    "most 1000000 are run",
    HEAD + f"vary: {{{', '.join(f'a{i}: [1]' for i in range(33))}}}": "33 are varied; at most 32",
}


@pytest.mark.parametrize("text", BAD)
def test_a_mistake_is_told_with_its_place(tmp_path: Path, text: str) -> None:
    with pytest.raises(UniconError) as error:
        sweep_of(tmp_path, text)
    told = str(error.value)
    assert BAD[text] in told
    assert "sweep.yaml:" in told
    assert "\n" not in told


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("workflow: nothing_such\n" + SEEDS, "nothing_such"),
        (HEAD + "vary: {nothing.such: [1]}", "unknown key 'nothing'"),
        (HEAD + SEEDS + "set: {num_robots: 4}", "a rollout has one robot"),
        (HEAD + "set: {scene.seed: -1}\nvary: {scene.delay: [1]}", "scene.seed is -1"),
        ("workflow: go2_teleop\n" + SEEDS, "says no duration, so it may never end; give duration"),
    ],
)
def test_a_plan_that_cannot_be_is_refused(tmp_path: Path, text: str, told: str) -> None:
    with pytest.raises(UniconError, match=told):
        Plan(sweep_of(tmp_path, text))


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("fall", "is not a condition; write fall<0.01"),
        ("fall<<1", "is not a condition"),
        ("fall<1.2.3", "is not a condition"),
        ("fall<1 for each", "is not a condition"),
        ("fall.mean<1", "fall has no 'mean'; .*known: lower, rate, upper"),
        ("distance_m.p50x<1", "distance_m has no 'p50x'"),
        ("outcome<1", "no figure 'outcome'"),
    ],
)
def test_a_gate_that_is_none_is_told(text: str, told: str) -> None:
    with pytest.raises(UniconError, match=told):
        read_gate(text)


def test_sobol_names_scipy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import sys

    monkeypatch.setitem(sys.modules, "scipy", None)
    monkeypatch.setitem(sys.modules, "scipy.stats", None)
    text = HEAD + "vary: {scene.delay: [0, 1]}\nsample: sobol\nrollouts: 2"
    with pytest.raises(UniconError, match=r"sample: sobol needs scipy: pip install 'unicon_ros\["):
        Plan(sweep_of(tmp_path, text))


@pytest.mark.parametrize(
    ("said", "kind"),
    [
        ([1, 2], int),
        ([1, 2.5], float),
        ({"uniform": [0, 1]}, float),
        ({"range": [0, 3]}, int),
        ([True, False], str),
        ([1, "two"], str),
        ([None, [1]], str),
    ],
)
def test_a_column_is_of_whole_numbers_numbers_or_words(said: Any, kind: type) -> None:
    assert parameter("scene.x", said).type is kind
