"""Aligned MSE: equal to its definition, symmetric, exact for shifts; clear errors."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest
from aligned_twins import admissible, aligned, mean_at
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from unicon_base.errors import UniconError
from unicon_core.metrics import aligned_mse, shift_losses

Floats = NDArray[np.float64]


def energy(*trajectories: Floats) -> float:
    """Return the sum of all squares: what rounding errors are measured against."""
    return sum(float(np.sum(x**2)) for x in trajectories)


@st.composite
def pairs(draw: st.DrawFn) -> tuple[Floats, Floats]:
    """Draw two trajectories: noise, steps, constants, copies, small ripples far from zero."""
    n, m, d = draw(st.integers(1, 40)), draw(st.integers(1, 40)), draw(st.integers(1, 4))
    random = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    kind = draw(st.sampled_from(["noise", "steps", "constant", "copy", "far"]))
    scale = 10.0 ** draw(st.integers(-6, 6))
    if kind == "constant":
        return np.full((n, d), scale), np.full((m, d), draw(st.sampled_from([scale, 2 * scale])))
    a, b = random.normal(size=(n, d)), random.normal(size=(m, d))
    if kind == "steps":
        a, b = np.round(a), np.round(b)
    if kind == "copy":
        b = a[draw(st.integers(0, n - 1)) :].copy()
    if kind == "far":
        a, b = 1e6 + a, 1e6 + b
    return scale * a, scale * b


@given(pairs(), st.one_of(st.none(), st.integers(0, 50)), st.floats(0.05, 1.0))
@settings(max_examples=60)
def test_it_equals_its_definition(
    pair: tuple[Floats, Floats], max_shift: int | None, min_overlap: float
) -> None:
    real, sim = pair
    found = aligned_mse(real, sim, max_shift, min_overlap)
    slow = aligned(real, sim, max_shift, min_overlap)
    assert abs(float(found.loss) - slow) <= 1e-9 * energy(real, sim)
    shifts, losses = shift_losses(real, sim, max_shift, min_overlap)
    assert abs(float(losses.min()) - slow) <= 1e-9 * energy(real, sim)
    assert shifts.tolist() == admissible(len(real), len(sim), max_shift, min_overlap)
    at, count = mean_at(real, sim, int(found.shift))
    assert 2.0 * at == pytest.approx(float(found.loss), rel=1e-12)
    assert int(found.overlap) == count


@given(pairs())
@settings(max_examples=40)
def test_swapped_trajectories_have_the_same_loss(pair: tuple[Floats, Floats]) -> None:
    real, sim = pair
    there, back = aligned_mse(real, sim), aligned_mse(sim, real)
    assert abs(float(there.loss - back.loss)) <= 1e-9 * energy(real, sim)


@pytest.mark.parametrize("shift", [37, -37])
def test_a_shift_of_37_samples_is_found_at_loss_0(shift: int) -> None:
    whole = np.cumsum(np.random.default_rng(5).normal(size=(2037, 12)), axis=0)
    late, early = whole[:2000], whole[37:]
    real, sim = (late, early) if shift > 0 else (early, late)
    found = aligned_mse(real, sim)
    assert (int(found.shift), int(found.overlap)) == (shift, 2000 - 37)
    assert float(found.loss) == 0.0


def test_a_walk_that_repeats_is_shifted_by_the_least_that_suits_it() -> None:
    time = np.arange(500)
    real = np.stack([np.sin(2 * np.pi * (time + phase) / 50) for phase in (0, 25)], axis=1)
    found = aligned_mse(real, np.roll(real, 10, axis=0))
    assert int(found.shift) == -10
    assert float(found.loss) < 1e-25


def test_leading_axes_give_the_results_of_one_after_the_other(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    random = np.random.default_rng(0)
    real, sims = random.normal(size=(200, 3)), random.normal(size=(2, 5, 180, 3))
    sims[1, 4] = real[7:187]
    for at_once in (1, 1 << 22):
        monkeypatch.setattr("unicon_core.metrics.alignment.AT_ONCE", at_once)
        found = aligned_mse(real, sims)
        assert found.loss.shape == found.shift.shape == found.overlap.shape == (2, 5)
        assert int(found.shift[1, 4]) == 7
        assert found.loss[1, 4] == 0.0
        for index in np.ndindex(2, 5):
            assert found.loss[index] == aligned_mse(real, sims[index]).loss
    each = aligned_mse(real.T[..., None], sims[0, 0].T[..., None])
    assert each.loss.shape == (3,)


def test_constants_and_a_single_sample_have_shift_0() -> None:
    found = aligned_mse(np.ones((50, 2)), np.full((60, 2), 3.0))
    assert (float(found.loss), int(found.shift)) == (16.0, 0)
    found = aligned_mse([[1.0, 2.0]], [[1.0, 4.0]])
    assert (float(found.loss), int(found.shift), int(found.overlap)) == (8.0, 0, 1)


def test_the_overlap_is_half_of_the_shorter_unless_told() -> None:
    assert admissible(10, 4, None, 0.5) == list(range(-2, 9))
    ramp = np.arange(100.0)[:, None]
    assert int(aligned_mse(ramp, ramp + 80).shift) == 50
    assert int(aligned_mse(ramp, ramp + 80, min_overlap=0.1).shift) == 80
    assert int(aligned_mse(ramp, ramp + 80, max_shift=20).shift) == 20


def test_large_numbers_do_not_overflow() -> None:
    real = 1e90 * np.random.default_rng(1).normal(size=(300, 2))
    found = aligned_mse(real[:250], real[50:])
    assert (float(found.loss), int(found.shift)) == (0.0, 50)


@pytest.mark.parametrize(
    ("real", "sim", "message"),
    [
        ([1.0, 2.0], [1.0, 2.0], "gap: real has shape (2,), not (…, samples, elements)"),
        (np.zeros((0, 3)), np.zeros((5, 3)), "gap: real is empty, shape (0, 3)"),
        (np.zeros((5, 3)), np.zeros((5, 0)), "gap: sim is empty, shape (5, 0)"),
        (np.zeros((5, 3)), np.zeros((5, 2)), "gap: real has 3 elements, sim 2; choose those"),
        (np.zeros((2, 5, 3)), np.zeros((3, 5, 3)), "the axes before (samples, elements) must"),
        ([[0.0], [np.nan]], [[0.0]], "gap: real is nan in sample 1, element 0; leave such"),
        ([[0.0]], [[[0.0]], [[np.inf]]], "gap: sim is inf in sample 0, element 0 of trajectory 1"),
        ([[0.0]], [[1e200]], "gap: sim is 1e+200 in sample 0, element 0"),
        ([["left"]], [[0.0]], "gap: real has something else than numbers in it"),
        ([[0.0], [1.0, 2.0]], [[0.0]], "gap: real has something else than numbers in it"),
    ],
)
def test_what_cannot_be_compared_is_refused(real: Any, sim: Any, message: str) -> None:
    with pytest.raises(UniconError, match=re.escape(message)):
        aligned_mse(real, sim)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"min_overlap": 0.0}, "gap: min_overlap is 0.0; give a share in (0, 1]"),
        ({"min_overlap": float("nan")}, "gap: min_overlap is nan"),
        ({"max_shift": -1}, "gap: max_shift is -1; give a number of samples >= 0"),
    ],
)
def test_what_makes_no_range_is_refused(options: Any, message: str) -> None:
    with pytest.raises(UniconError, match=re.escape(message)):
        aligned_mse([[0.0]], [[0.0]], **options)
