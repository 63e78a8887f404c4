"""Joint orders are matched by name."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from unicon_base.errors import RobotError
from unicon_core.robots import joint_index

NAMES = st.lists(st.text("abc", min_size=1, max_size=3), min_size=1, max_size=30, unique=True)


@given(NAMES, st.randoms(use_true_random=False))
def test_index_brings_an_array_into_the_order_wanted(given_names: list[str], rng: object) -> None:
    wanted = list(given_names)
    rng.shuffle(wanted)  # type: ignore[attr-defined]
    wanted = wanted[: 1 + len(wanted) // 2]
    values = {name: float(i) for i, name in enumerate(given_names)}
    x = np.array([values[name] for name in given_names])
    index = joint_index(wanted, given_names)
    assert index.dtype == np.intp
    assert x[index].tolist() == [values[name] for name in wanted]


@given(NAMES)
def test_index_and_its_reverse_cancel(names: list[str]) -> None:
    other = sorted(names)
    there, back = joint_index(other, names), joint_index(names, other)
    assert np.array_equal(there[back], np.arange(len(names)))


def test_unknown_joint_names_the_close_match() -> None:
    with pytest.raises(RobotError) as caught:
        joint_index(["hip", "kneee"], ["hip", "knee"])
    assert str(caught.value) == "no joint 'kneee'; did you mean 'knee'? known: hip, knee"


@pytest.mark.parametrize(
    ("to", "from_", "which"), [(["a", "a"], ["a"], "wanted"), (["a"], ["a", "a"], "given")]
)
def test_joint_named_twice_is_refused(to: list[str], from_: list[str], which: str) -> None:
    with pytest.raises(RobotError) as caught:
        joint_index(to, from_)
    assert str(caught.value) == (
        f"joint 'a' stands twice in the {which} joint order; name each joint once"
    )


def test_names_of_other_peoples_models_may_differ_in_namespace_and_ending() -> None:
    theirs = ["g1/knee", "hip_joint", "hip", "a/wrist", "b/wrist"]
    assert joint_index(["hip", "knee_joint"], theirs, loose=True).tolist() == [2, 0]
    with pytest.raises(RobotError, match="no joint 'knee_joint'"):
        joint_index(["hip", "knee_joint"], theirs)
    with pytest.raises(RobotError, match="joint 'wrist' could be any of a/wrist, b/wrist"):
        joint_index(["wrist"], theirs, loose=True)
    with pytest.raises(RobotError, match="joint 'knee_joint' and another one are both 'g1/knee'"):
        joint_index(["knee", "knee_joint"], theirs, loose=True)
