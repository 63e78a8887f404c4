"""States of one shape as one view, where they stand at equal distances."""

from __future__ import annotations

import numpy as np
import pytest

from unicon_core.states import States, StateSpec
from unicon_core.states.states import flat, stacked


def make(num_robots: int | None, *dtypes: str) -> list[np.ndarray]:
    states = States({f"s{i}": StateSpec((3,), dtype) for i, dtype in enumerate(dtypes)}, num_robots)
    for i, name in enumerate(states):
        states[name][...] = i
    return [states[name] for name in states]


@pytest.mark.parametrize("num_robots", [None, 2])
def test_neighbours_are_one_view(num_robots: int | None) -> None:
    views = make(num_robots, "float32", "float32", "float32")
    whole = stacked(views)
    assert whole is not None
    assert np.shares_memory(whole, views[2])
    assert (whole == np.stack(views)).all()
    assert whole.flags.c_contiguous
    assert not whole.flags.writeable
    views[1][...] = 7.0
    assert (whole == np.stack(views)).all()


def test_one_row_of_each_of_a_batch_is_one_view() -> None:
    views = [view[1] for view in make(2, "float32", "float32")]
    whole = stacked(views)
    assert whole is not None
    assert not whole.flags.c_contiguous
    assert whole.tolist() == [[0, 0, 0], [1, 1, 1]]


@pytest.mark.parametrize(
    "views",
    [
        make(None, "float32", "float32", "int64"),
        make(None, "float32", "float32", "float32", "float32")[:4:3][::-1],
        [make(None, "float32")[0], make(None, "float32", "float32")[1][:2]],
        [make(None, *["float32"] * 4)[i] for i in (0, 1, 3)],
    ],
    ids=["another type", "backwards", "another shape", "a gap"],
)
def test_others_are_none(views: list[np.ndarray]) -> None:
    assert stacked(views) is None


def test_one_alone_is_itself() -> None:
    (view,) = make(None, "float32")
    whole = stacked([view])
    assert whole is not None
    assert whole.shape == (1, 3)


def test_flat_views_are_one_after_the_other() -> None:
    views = make(2, "float32", "float32")
    assert [part.tolist() for part in flat(views)] == [[0.0] * 6 + [1.0] * 6]
    views = make(2, "float32", "int64")
    assert [part.tolist() for part in flat(views)] == [[0.0] * 6, [1] * 6]


def test_flat_neighbours_may_have_other_shapes() -> None:
    states = States({"a": StateSpec((3,)), "b": StateSpec((2, 2)), "c": StateSpec(())}, 2)
    states["b"][...] = 1.0
    (whole,) = flat([states["a"], states["b"], states["c"]])
    assert whole.tolist() == [0.0] * 6 + [1.0] * 8 + [0.0] * 2
    assert not whole.flags.writeable
    assert len(flat([states["a"], states["c"]])) == 2  # a gap
