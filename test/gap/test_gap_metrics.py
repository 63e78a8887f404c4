"""The other metrics of the gap: equal to their slow definitions, clear about what is degenerate."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from aligned_twins import admissible
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from unicon_base.errors import UniconError
from unicon_core.metrics import (
    affine,
    aligned_mse,
    chamfer,
    compare,
    fall_time,
    load,
    match_elements,
    mse,
    rmse,
    spectral_distance,
    warming,
    wasserstein,
)
from unicon_core.metrics.elements import assign

Floats = NDArray[np.float64]


def smooth(seed: int, samples: int, elements: int) -> Floats:
    """Return movements that repeat nowhere."""
    noise = np.random.default_rng(seed).normal(size=(samples + 20, elements))
    return np.stack([np.convolve(x, np.hanning(21), "valid") for x in noise.T], axis=1)


@given(st.integers(1, 6), st.integers(1, 3), st.integers(0, 2**32 - 1))
@settings(max_examples=25)
def test_mse_is_the_mean_of_squares(n: int, d: int, seed: int) -> None:
    random = np.random.default_rng(seed)
    real, sim = random.normal(size=(2, n, d)), random.normal(size=(2, n, d))
    squares = [[[(real[b, i, k] - sim[b, i, k]) ** 2 for k in range(d)] for i in range(n)]
               for b in range(2)]  # fmt: skip
    np.testing.assert_allclose(mse(real, sim), [np.mean(s) for s in squares])
    np.testing.assert_allclose(mse(real, sim, "element"), [np.mean(s, 0) for s in squares])
    np.testing.assert_allclose(mse(real, sim, "frame"), [np.mean(s, 1) for s in squares])
    np.testing.assert_allclose(rmse(real, sim, "frame") ** 2, mse(real, sim, "frame"))
    unshifted = aligned_mse(real, sim, max_shift=0).loss
    np.testing.assert_allclose(unshifted, 2 * d * mse(real, sim))


@given(
    st.integers(2, 30), st.integers(2, 30), st.integers(0, 2**32 - 1), st.sampled_from([None, 0, 5])
)
@settings(max_examples=40)
def test_affine_is_pearson_and_least_squares(n: int, m: int, seed: int, max_lag: Any) -> None:
    random = np.random.default_rng(seed)
    real = 3.0 + random.normal(size=(n, 2))
    sim = -1.0 + random.normal(size=(m, 2))
    found = affine(real, sim, max_lag)
    for k in range(2):
        pearson = {}
        for j in admissible(n, m, max_lag, 0.5):
            pairs = [(real[i + j, k], sim[i, k]) for i in range(m) if 0 <= i + j < n]
            x, y = (np.array(side) for side in zip(*pairs))
            pearson[j] = np.corrcoef(x, y)[0, 1] if len(pairs) > 1 else 0.0
        lag = int(found.lag[k])
        assert abs(pearson[lag]) == pytest.approx(max(map(abs, pearson.values())), abs=1e-8)
        pairs = [(real[i + lag, k], sim[i, k]) for i in range(m) if 0 <= i + lag < n]
        if len(pairs) > 1:
            x, y = (np.array(side) for side in zip(*pairs))
            gain, offset = np.polyfit(y, x, 1)
            assert found.gain[k] == pytest.approx(gain, rel=1e-6, abs=1e-6)
            assert found.offset[k] == pytest.approx(offset, rel=1e-6, abs=1e-6)
            assert found.correlation[k] == pytest.approx(pearson[lag], abs=1e-8)
            assert found.sign[k] == np.sign(pearson[lag])


def test_affine_finds_a_delay_a_gain_a_sign_and_an_offset() -> None:
    sim = smooth(1, 600, 4)
    real = sim.copy()
    real[3:, 0] = sim[:-3, 0]
    real[:, 1] *= 0.6
    real[:, 2] *= -1.0
    real[:, 3] += 0.2
    found = affine(real[5:], sim[5:], max_lag=20)
    assert found.lag.tolist() == [3, 0, 0, 0]
    np.testing.assert_allclose(found.gain, [1.0, 0.6, -1.0, 1.0], atol=1e-9)
    np.testing.assert_allclose(found.offset, [0.0, 0.0, 0.0, 0.2], atol=1e-9)
    assert found.sign.tolist() == [1, 1, -1, 1]
    many = affine(np.stack([real, sim]), sim, max_lag=20)
    assert many.lag.shape == many.gain.shape == (2, 4)
    np.testing.assert_allclose(many.gain[1], 1.0)


def test_affine_of_what_stands_still_says_so() -> None:
    moving, still = np.arange(10.0)[:, None] % 3, np.full((10, 1), 0.7)
    for real, sim, gain, offset in (
        (still, still + 0.1, np.nan, -0.1),
        (moving, still, np.nan, moving.mean() - 0.7),
        (still, moving, 0.0, 0.7 - moving.mean()),
        (still[:1], moving[:1], np.nan, 0.7),
    ):
        found = affine(real, sim)
        assert (found.lag[0], found.sign[0]) == (0, 0)
        assert np.isnan(found.correlation[0])
        np.testing.assert_allclose(found.gain, gain, atol=1e-12)
        np.testing.assert_allclose(found.offset, offset)


@given(st.integers(1, 6), st.integers(0, 2**32 - 1), st.booleans())
@settings(max_examples=60)
def test_assignment_is_the_cheapest_permutation(size: int, seed: int, ties: bool) -> None:
    costs = np.random.default_rng(seed).normal(size=(size, size))
    costs = np.round(costs) if ties else costs
    found = assign(costs)
    assert sorted(found) == list(range(size))
    cheapest = min(sum(costs[r, p[r]] for r in range(size))
                   for p in itertools.permutations(range(size)))  # fmt: skip
    assert costs[np.arange(size), found].sum() == pytest.approx(cheapest, abs=1e-12)


def test_swapped_legs_are_found_and_nothing_else() -> None:
    sim = smooth(2, 400, 12)
    noise = 0.1 * np.random.default_rng(3).normal(size=sim.shape)
    swapped = [3, 4, 5, 0, 1, 2, *range(6, 12)]
    found = match_elements(sim[:, swapped] + noise, sim)
    assert found.sim_from_real.tolist() == swapped
    assert found.cycles() == [(0, 3), (1, 4), (2, 5)]
    assert found.cost < 0.1 * found.cost_as_named
    assert found.costs[2, 7] == pytest.approx(np.mean((sim[:, 5] + noise[:, 2] - sim[:, 7]) ** 2))
    assert match_elements(sim + noise, sim).cycles() == []
    turned = match_elements(sim[:, [1, 2, 0, *range(3, 12)]], sim)
    assert turned.cycles() == [(0, 1, 2)]
    same = np.repeat(sim[:, :1], 3, axis=1)  # joints that move alike cannot be told apart
    assert match_elements(same + noise[:, :3], same).cycles() == []
    assert match_elements(np.stack([sim, sim]), sim).sim_from_real.shape == (2, 12)


@given(st.integers(1, 20), st.integers(1, 20), st.integers(1, 3), st.integers(0, 2**32 - 1))
@settings(max_examples=30)
def test_chamfer_is_the_distance_to_the_nearest(n: int, m: int, d: int, seed: int) -> None:
    random = np.random.default_rng(seed)
    real, sim = random.normal(size=(n, d)), 2 + random.normal(size=(m, d))
    slow = np.mean([min(np.linalg.norm(a - b) for b in sim) for a in real])
    slow += np.mean([min(np.linalg.norm(a - b) for a in real) for b in sim])
    assert float(chamfer(real, sim)) == pytest.approx(slow, rel=1e-9)
    assert float(chamfer(sim, real)) == pytest.approx(slow, rel=1e-9)


def test_chamfer_knows_no_order(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("unicon_core.metrics.distances.ROWS", 7)
    real = smooth(4, 50, 3)
    assert float(chamfer(real, real[::-1])) == 0.0
    assert chamfer(np.stack([real, real]), real[:20]).shape == (2,)


def test_spectral_distance_knows_no_phase() -> None:
    time = np.arange(1024)
    slow, fast = np.sin(2 * np.pi * time / 64), np.sin(2 * np.pi * time / 8)
    later = np.sin(2 * np.pi * (time + 17) / 64)
    columns = [
        (slow, slow),
        (slow, later),
        (slow, fast),
        (slow, 0 * slow),
        (0 * slow, 0 * slow + 3),
    ]
    found = spectral_distance(
        np.stack([a for a, _ in columns], 1), np.stack([b for _, b in columns], 1)
    )
    np.testing.assert_allclose(found, [0.0, 0.0, 1.0, 1.0, 0.0], atol=1e-3)
    weaker = spectral_distance(slow[:, None], 0.5 * slow[:, None])
    np.testing.assert_allclose(weaker, [0.2], atol=1e-9)  # (1 − ½)² / (1 + ¼)
    swapped = spectral_distance(0.5 * slow[:900, None], slow[:, None])
    np.testing.assert_allclose(swapped, [0.2], atol=1e-2)
    assert spectral_distance([[1.0]], [[2.0]]).tolist() == [0.0]


@given(st.integers(1, 8), st.integers(1, 8), st.integers(0, 2**32 - 1))
@settings(max_examples=40)
def test_wasserstein_is_the_difference_of_what_is_sorted(n: int, m: int, seed: int) -> None:
    random = np.random.default_rng(seed)
    real, sim = random.normal(size=(2, n, 2)), random.normal(size=(m, 2))
    found = wasserstein(real, sim)
    assert found.shape == (2, 2)
    for b, k in np.ndindex(2, 2):
        # As many copies as make both equally long.
        x, y = np.sort(np.repeat(real[b, :, k], m)), np.sort(np.repeat(sim[:, k], n))
        assert found[b, k] == pytest.approx(np.mean(np.abs(x - y)))
    np.testing.assert_allclose(wasserstein(sim, real), found)


def test_loads_and_temperatures_are_compared() -> None:
    torque = np.array([[1.0, -2.0], [-3.0, -2.0]])
    found = load(torque)
    np.testing.assert_allclose(found.rms, [5**0.5, 2.0])
    np.testing.assert_allclose(found.mean, [-1.0, -2.0])
    np.testing.assert_allclose(found.peak, [3.0, 2.0])
    assert compare([2.0, 0.0, 1.0, 0.0], [4.0, 0.0, 0.0, 1.0]).tolist() == [0.5, 1.0, np.inf, 0.0]
    warm = warming(30.0 + 0.5 * np.arange(21.0)[:, None] * [0.1, 0.0], period=0.1)
    np.testing.assert_allclose(warm.start, [30.0, 30.0])
    np.testing.assert_allclose(warm.rise, [1.0, 0.0])
    np.testing.assert_allclose(warm.peak, [31.0, 30.0])
    np.testing.assert_allclose(warm.rate, [0.5, 0.0], atol=1e-12)
    assert warming([[20.0]], 0.1).rate.tolist() == [0.0]


def test_fall_time_is_when_the_base_stays_down() -> None:
    def gravity(*leans: float) -> Floats:
        return np.stack([np.sin(leans), np.zeros(len(leans)), -np.cos(leans)], axis=1)

    up, down = 0.1, 1.2
    cases = [
        ((up,) * 8, np.nan),
        ((up, up, down, up, up, down, down, down), 0.5),  # the first one was a stumble
        ((up,) * 7 + (down,), 0.7),  # the run ends with the fall
        ((down,) * 8, 0.0),
    ]
    for leans, time in cases:
        np.testing.assert_allclose(fall_time(gravity(*leans), 0.1, for_s=0.3), time)
    ended = [fall_time(gravity(*leans), 0.1, 0.3, whole=True) for leans, _ in cases]
    np.testing.assert_allclose(ended, [np.nan, 0.5, np.nan, 0.0])  # the third one only leans
    both = fall_time(np.stack([gravity(*leans) for leans, _ in cases]), 0.1, for_s=0.3)
    np.testing.assert_allclose(both, [time for _, time in cases])


@pytest.mark.parametrize(
    "metric", [mse, rmse, affine, match_elements, chamfer, spectral_distance, wasserstein]
)
def test_every_metric_refuses_what_is_not_a_trajectory(metric: Callable[..., Any]) -> None:
    good = np.zeros((5, 2))
    for bad in (np.zeros((0, 2)), np.full((5, 2), np.nan), np.zeros((5, 3)), np.zeros(5)):
        with pytest.raises(UniconError, match="gap: "):
            metric(good, bad)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda x: mse(x, x[:4]), "gap: real has 5 samples, sim 4; cut them to one length"),
        (lambda x: match_elements(x, x[:4]), "gap: real has 5 samples, sim 4"),
        (lambda x: mse(x, x, "joint"), "gap: per is 'joint'; give one of all, element, frame"),
        (lambda x: spectral_distance(x, x, 1), "gap: samples is 1; a segment has at least 2"),
        (lambda x: warming(x, 0.0), "gap: period is 0.0; give a time > 0"),
        (lambda x: warming(x * np.nan, 1.0), "gap: temperature is nan in sample 0, element 0"),
        (lambda x: fall_time(x, 0.1), "gap: projected_gravity has 2 elements; give x, y, z"),
        (lambda x: fall_time(np.zeros((5, 3)), np.nan), "gap: period is nan; give a time > 0"),
        (lambda x: load(x[:0]), "gap: torque is empty, shape (0, 2)"),
    ],
)
def test_wrong_arguments_are_named(call: Callable[[Floats], Any], message: str) -> None:
    with pytest.raises(UniconError, match=re.escape(message)):
        call(np.zeros((5, 2)))
