"""Quadratic programs: a slow twin that tries every set of active bounds, and what has no answer."""

from __future__ import annotations

import sys
from itertools import product
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from unicon_base.errors import MissingDependencyError
from unicon_manipulation.ik.differential import Quadratic

pytest.importorskip("daqp", reason="daqp is not installed: pip install 'unicon_ros[ik]'")

K, ROWS = 3, 2


def reference(problem: Quadratic, rows: int) -> Any:
    """Return the solution by trying each set of bounds that may be active (KKT conditions)."""
    normals = np.vstack([np.eye(K), -np.eye(K), problem.rows[:rows]])
    least = np.concatenate([problem.bounds[0], -problem.bounds[1], problem.least[:rows]])
    best, lowest = None, np.inf
    for chosen in product((False, True), repeat=len(normals)):
        active = normals[list(chosen)]
        if len(active) > K or np.linalg.matrix_rank(active, 1e-6) < len(active):
            continue
        system = np.block([[problem.square, -active.T], [active, np.zeros((len(active),) * 2)]])
        x = np.linalg.solve(system, np.concatenate([-problem.slope, least[list(chosen)]]))[:K]
        cost = 0.5 * x @ problem.square @ x + problem.slope @ x
        if (normals @ x >= least - 1e-9).all() and cost < lowest:
            best, lowest = x, cost
    return best


numbers = st.integers(-1000, 1000).map(lambda x: 1e-3 * x)


@given(
    st.lists(numbers, min_size=K * K + K, max_size=K * K + K),
    st.lists(numbers, min_size=8, max_size=8),
)
@settings(max_examples=80)
def test_solutions_are_those_of_the_slow_twin(cost: list[float], bounds: list[float]) -> None:
    problem = Quadratic(K)
    factor = np.reshape(cost[: K * K], (K, K))
    problem.square[:] = factor @ factor.T + 0.01 * np.eye(K)
    problem.slope[:] = cost[K * K :]
    problem.bounds[0], problem.bounds[1] = -0.1, 0.2
    problem.rows[:ROWS] = np.reshape(bounds[:6], (ROWS, K))
    problem.least[:ROWS] = -np.abs(bounds[6:])
    assert problem.solve(ROWS)
    assert (problem.solution >= problem.bounds[0]).all()
    assert (problem.solution <= problem.bounds[1]).all()
    np.testing.assert_allclose(problem.solution, reference(problem, ROWS), atol=1e-5)


def test_rows_that_do_not_count_are_not_looked_at() -> None:
    problem = Quadratic(K)
    problem.square[:], problem.slope[:] = np.eye(K), -1.0
    problem.bounds[0], problem.bounds[1] = -5.0, 5.0
    problem.rows[:], problem.least[:] = np.nan, np.nan
    assert problem.solve()
    np.testing.assert_allclose(problem.solution, 1.0)


@pytest.mark.parametrize("wrong", ["square", "slope", "least"])
def test_where_there_is_no_answer_nothing_moves(wrong: str) -> None:
    problem = Quadratic(K)
    problem.square[:], problem.slope[:] = np.eye(K), -1.0
    problem.bounds[0], problem.bounds[1] = -5.0, 5.0
    problem.rows[:1], problem.least[:1] = 1.0, 0.0
    getattr(problem, wrong)[...] = 1e3 if wrong == "least" else np.nan
    assert not problem.solve(1)
    assert problem.solution.tolist() == [0.0] * K


def test_the_same_problem_has_the_same_answer_whatever_came_before() -> None:
    rng, problem, fresh = np.random.default_rng(0), Quadratic(K), None
    for _ in range(20):
        factor = rng.normal(size=(K, K))
        problem.square[:], problem.slope[:] = factor @ factor.T + np.eye(K), rng.normal(size=K)
        problem.bounds[0], problem.bounds[1] = -0.1, 0.1
        problem.solve()
        fresh = Quadratic(K)
        fresh.square[:], fresh.slope[:] = problem.square, problem.slope
        fresh.bounds[:] = problem.bounds
        fresh.solve()
        assert problem.solution.tobytes() == fresh.solution.tobytes()


def test_a_missing_solver_is_named_with_its_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "daqp", None)
    with pytest.raises(MissingDependencyError) as caught:
        Quadratic(K)
    assert str(caught.value) == "block 'reach' needs daqp: pip install 'unicon_ros[ik]'"
