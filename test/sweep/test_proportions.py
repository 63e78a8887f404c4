"""Intervals of shares, against tables."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from unicon_lab.sweep.results import wilson

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
