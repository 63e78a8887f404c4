"""Filters over the ticks of a policy: a first-order low pass and a moving average.

    y = α · x + (1 − α) · y_before            α = 1 − exp(−2π · f · T) for a cut-off f, period T
    y = (x + x_before + …) / n                summed from the oldest to the newest sample

Each has two halves: calling it filters a sample in place, as often as one likes (a warm-up does);
`advance` keeps the sample of the last call and goes on to the next tick; `reset` forgets all
samples. All is float32.
"""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np

from unicon_base.arrays import Float32
from unicon_core.policies.contract import FilterSpec


def make_filter(spec: FilterSpec, shape: tuple[int, ...], period: float) -> Filter:
    """Return a filter.

    Args:
        spec: of the contract.
        shape: of a sample.
        period: of the policy in [s].
    """
    if spec.moving_average is not None:
        return _Mean(spec.moving_average, shape, spec.start == "zeros")
    alpha = spec.alpha
    if alpha is None:
        alpha = -math.expm1(-2.0 * math.pi * (spec.low_pass or 0.0) * period)
    return _LowPass(alpha, shape, spec.start == "zeros")


class _LowPass:
    """A first-order low pass."""

    memory = ("_kept", "_fresh")

    def __init__(self, alpha: float, shape: tuple[int, ...], zeros: bool) -> None:
        self._new, self._old, self._zeros = np.float32(alpha), np.float32(1.0 - alpha), zeros
        self._kept, self._now, self._rest = (np.zeros(shape, np.float32) for _ in range(3))
        self._fresh = True

    def __call__(self, sample: Float32) -> None:
        if self._fresh and not self._zeros:
            self._now[...] = sample
            return
        np.multiply(self._kept, self._old, out=self._rest)
        np.multiply(sample, self._new, out=self._now)
        np.add(self._now, self._rest, out=self._now)
        sample[...] = self._now

    def advance(self) -> None:
        self._kept[...] = self._now
        self._fresh = False

    def reset(self) -> None:
        self._kept[...] = 0.0
        self._fresh = True


class _Mean:
    """A moving average, over a ring whose last n samples always stand in one piece."""

    memory = ("_ring", "_head", "_fresh")

    def __init__(self, n: int, shape: tuple[int, ...], zeros: bool) -> None:
        self._n, self._zeros = n, zeros
        self._ring = np.zeros((2 * n, *shape), np.float32)
        self._sum = np.zeros(shape, np.float32)
        self._head, self._fresh = 0, True

    def __call__(self, sample: Float32) -> None:
        ring, head, n = self._ring, self._head, self._n
        if self._fresh:
            ring[...] = 0.0 if self._zeros else sample
        # Sample k is written twice, at k and k + n; the window then begins at k + 1.
        ring[head] = ring[head + n] = sample
        window = ring[head + 1 : head + 1 + n]
        self._sum[...] = window[0]
        for each in window[1:]:  # one after the other: `sum` would add in an order of its own
            self._sum += each
        np.divide(self._sum, np.float32(n), out=sample)

    def advance(self) -> None:
        self._head = (self._head + 1) % self._n
        self._fresh = False

    def reset(self) -> None:
        self._fresh = True


Filter: TypeAlias = _LowPass | _Mean
"""A filter of samples of one shape."""
