"""Gauss-Newton within bounds against a slow twin that tries every set of held variables."""

from __future__ import annotations

from itertools import product

import numpy as np
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from unicon_manipulation.retargeting_block import Bounded


def slow(a: np.ndarray, b: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> float:
    """Return the least |a q - b|² within bounds: the best of all ways to hold variables at one."""
    best = np.inf
    for held in product((0, 1, 2), repeat=len(lower)):
        q = np.where(np.array(held) == 1, lower, upper).astype(float)
        free = [i for i, way in enumerate(held) if way == 0]
        if free:
            q[free] = 0.0
            q[free] = np.linalg.lstsq(a[:, free], b - a @ q, rcond=None)[0]
        if (q >= lower - 1e-9).all() and (q <= upper + 1e-9).all():
            best = min(best, float(np.sum((a @ q - b) ** 2)))
    return best


@settings(max_examples=60)
@given(st.integers(0, 2**32 - 1), st.integers(1, 4))
def test_linear_problems_are_solved_as_by_the_slow_twin(seed: int, count: int) -> None:
    random = np.random.default_rng(seed)
    a, b = random.normal(size=(count + 2, count)) * 0.1, random.normal(size=count + 2) * 0.1
    assume(np.linalg.cond(a) < 50)
    lower = -random.uniform(0.1, 1.0, count)
    upper = random.uniform(0.1, 1.0, count)
    solver = Bounded(lambda q: (a @ q - b, a), lower, upper)
    q = random.uniform(lower, upper)
    for _ in range(3):
        solver.solve(q)
    assert (q >= lower).all()
    assert (q <= upper).all()
    found = float(np.sum((a @ q - b) ** 2))
    assert found <= slow(a, b, lower, upper) + 1e-7


def test_a_straight_arm_bends_again() -> None:
    """Two links, straight at the bound of the second: what is wanted lies behind its end."""

    def residual(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        one, both = q[0], q[0] + q[1]
        tip = 0.05 * np.array((np.cos(one) + np.cos(both), np.sin(one) + np.sin(both)))
        second = 0.05 * np.array((-np.sin(both), np.cos(both)))
        first = second + 0.05 * np.array((-np.sin(one), np.cos(one)))
        return tip - np.array((0.08, 0.0)), np.stack((first, second), axis=1)

    solver = Bounded(residual, np.array((-1.5, 0.0)), np.array((1.5, 2.0)))
    q = np.zeros(2)
    assert solver.solve(q) < 1e-8
    assert abs(q[1] - 2.0 * np.arccos(0.8)) < 1e-3


def test_a_problem_without_a_slope_ends() -> None:
    solver = Bounded(lambda q: (np.ones(3), np.zeros((3, 2))), -np.ones(2), np.ones(2))
    q = np.array((0.3, -0.4))
    assert solver.solve(q) == 3.0
    assert q.tolist() == [0.3, -0.4]
