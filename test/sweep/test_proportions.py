"""Intervals and tests of shares, against tables and scipy."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from unicon_ros.sweep.proportions import fisher, mcnemar, wilson

COUNTS = st.integers(0, 60)


def test_wilson_is_that_of_the_table() -> None:
    assert wilson(0, 2000) == pytest.approx((0.0, 0.0019171), abs=1e-6)  # z²/(n + z²)
    assert wilson(10, 100) == pytest.approx((0.05523, 0.17437), abs=1e-5)
    assert wilson(5, 5) == pytest.approx((0.56551, 1.0), abs=1e-5)
    assert wilson(0, 0) == (0.0, 1.0)


@given(COUNTS, COUNTS)
def test_wilson_holds_the_share(hits: int, more: int) -> None:
    count = hits + more
    low, high = wilson(hits, count)
    assert 0.0 <= low <= (hits / count if count else 0.5) <= high <= 1.0


@settings(max_examples=40)
@given(COUNTS, COUNTS, COUNTS, COUNTS)
def test_fisher_equals_scipy(a: int, b: int, c: int, d: int) -> None:
    stats = pytest.importorskip("scipy.stats")
    expected = float(stats.fisher_exact([[a, b], [c, d]]).pvalue)
    assert fisher(a, a + b, c, c + d) == pytest.approx(expected, rel=1e-6, abs=1e-12)


@given(COUNTS, COUNTS)
def test_mcnemar_is_a_binomial_test(a: int, b: int) -> None:
    stats = pytest.importorskip("scipy.stats")
    expected = float(stats.binomtest(a, a + b).pvalue) if a + b else 1.0
    assert mcnemar(a, b) == pytest.approx(expected, rel=1e-8)
    assert mcnemar(a, b) == mcnemar(b, a)


def test_large_counts_do_not_overflow() -> None:
    assert math.isfinite(fisher(4_000, 10_000, 4_050, 10_000))
    assert 0.0 < mcnemar(5000, 5100) <= 1.0
