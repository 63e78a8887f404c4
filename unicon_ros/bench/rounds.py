"""Rounds of a benchmark whose variants take turns: ratios within a round, intervals over rounds."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from unicon_ros.bench.loops import Loop

SEED = 0

Rows = dict[str, NDArray[np.float64]]
"""What one variant gave in one round: row to samples."""


def rounds_of(whole: int, loops: Mapping[str, Loop]) -> list[dict[str, Rows]]:
    """Return what loops gave, variant to rows, of each whole round; after `take_turns`."""
    samples = {name: loop.samples() for name, loop in loops.items()}
    return [{name: each[i] for name, each in samples.items()} for i in range(whole)]


def ratios(
    results: list[dict[str, Rows]], row: str, ours: str, base_row: str, base: str
) -> NDArray[np.float64]:
    """Return the ratio of the means of each round that has both.

    Means: latencies of an executor have several humps, between which a median jumps.
    """
    pairs = [
        (r[ours][row], r[base][base_row])
        for r in results
        if row in r.get(ours, {}) and base_row in r.get(base, {})
    ]
    return np.array([np.mean(a) / np.mean(b) for a, b in pairs])


def interval(ratios: NDArray[np.float64]) -> str:
    """Return the 95 % bootstrap interval of the median over rounds."""
    draws = np.random.default_rng(SEED).choice(ratios, (1000, len(ratios)))
    low, high = np.percentile(np.median(draws, axis=1), [2.5, 97.5])
    return f"{low:.3g} to {high:.3g}"
