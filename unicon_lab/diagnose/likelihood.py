"""Likelihood of what is left of a motion once a change explains its part.

What is left r of a window and channel is Gaussian with a covariance over the window's ticks that is
not known: it holds sensor noise, which a window begins with, and what the simulator cannot say. So
the covariance is estimated with the change, and the likelihood is the concentrated one (Cox and
Hinkley 1974, section 9.3),

    log L = -W/2 · Σ_c log det C_c,    C_c = Σ_w r_wc r_wcᵀ / W,

of W windows and channels c. A window's ticks are described by at most four polynomials of time, so
that W windows are enough to estimate C: with ten ticks and 13 windows, any change gains. Channels
are not independent, nor are windows that follow each other: it is a composite likelihood, whose
ratios are κ times too large with κ = tr(H⁻¹J)/p of curvature H and scatter J of the windows'
slopes, and whose intervals come from H⁻¹JH⁻¹ (Varin, Reid and Firth 2011). J counts the correlation
of windows up to two apart (Newey and West 1987).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from unicon_base.arrays import Float64

SHAPES = 4
"""Polynomials that describe a window, at most; fewer where there are less than six windows each."""
SHRUNK = 0.05
"""Part of a covariance that is drawn to its diagonal: few windows tell it."""
ROUNDS = 8


@dataclass(frozen=True, eq=False)
class Fitted:
    """A linear fit of changes.

    Attributes:
        size: of each change, shape (p,).
        spread: covariance of `size`, shape (p, p).
        gain: log-likelihood above that without these changes, as if windows and channels were
            independent.
        kappa: by which `gain` is too large.
    """

    size: Float64
    spread: Float64
    gain: float
    kappa: float


class Likelihood:
    """Of what is left, with one weight for each window, so that pushes and slips count less.

    Args:
        left: without any change, shape (w, l, m).
    """

    def __init__(self, left: Float64) -> None:
        windows, ticks = left.shape[:2]
        shapes = max(min(SHAPES, ticks, windows // 6), 1)
        powers = np.vander(np.linspace(0.0, 1.0, ticks), shapes, increasing=True)
        self._shapes = np.linalg.qr(powers)[0]
        self.scale = np.median(np.abs(left), axis=(0, 1)) + 1e-9
        self._by: Float64 | None = None
        size = np.sqrt((left**2).mean(axis=1))
        size = np.minimum(size / (np.median(size, axis=0) + 1e-12), 10.0)
        size = np.sqrt((size**2).mean(axis=1))
        self._weights: Float64 = np.minimum(1.0, 2.0 * np.median(size) / np.maximum(size, 1e-12))
        self.count = float(self._weights.sum())
        """Windows, each by its weight."""

    def log(self, left: Float64) -> float:
        """Return the concentrated log-likelihood of what is left, shape (w, l, m)."""
        covariance = self._covariance(self._described(left))
        return float(-0.5 * self.count * np.linalg.slogdet(covariance)[1].sum())

    def error(self, left: Float64, scale: Float64) -> float:
        """Return the mean square of what is left, each channel by its scale, shape (m,)."""
        return float(((self._described(left) / scale) ** 2).mean())

    def leave_out(self, unknown: Float64, likely: Float64, left: Float64) -> None:
        """Weigh answers by what unknowns of a window, Gaussian as well, make uncertain.

        Answers are multiplied by the root of (I + U P Uᵀ)⁻¹.

        Args:
            unknown: derivatives U by them, shape (w, l, m, q).
            likely: standard deviation of each, the root of P, shape (q,).
            left: what an error of each channel is compared with, shape (w, l, m).
        """
        self._by = np.median(np.abs(left), axis=(0, 1)) + 1e-6
        flat = self._flat(np.einsum("lk,wlmq->wkmq", self._shapes, unknown)) * likely
        self._basis, size, turned = np.linalg.svd(flat, full_matrices=False)
        self._part = 1.0 - 1.0 / np.sqrt(1.0 + size**2)
        gain = likely[:, None] * turned.transpose(0, 2, 1) * (size / (1.0 + size**2))[:, None]
        self._gain = gain @ self._basis.transpose(0, 2, 1)

    def unknowns(self, left: Float64) -> Float64:
        """Return the unknowns that explain best what is left without them, shape (w, q)."""
        flat = self._flat(np.einsum("lk,wlm->wkm", self._shapes, left)[..., None])
        return np.asarray((self._gain @ flat)[..., 0])

    def _flat(self, parts: Float64) -> Float64:
        """Return parts of windows, shape (w, k, m, q), each channel by its error: (w, k·m, q)."""
        assert self._by is not None
        return np.asarray((parts / self._by[:, None]).reshape(len(parts), -1, parts.shape[-1]))

    def _described(self, values: Float64) -> Float64:
        """Return values of windows, shape (w, l, m, …), by polynomials of time, (w, k, m, …)."""
        found = np.asarray(np.einsum("lk,wl...->wk...", self._shapes, values))
        if self._by is None:
            return found
        flat = self._flat(found.reshape(*found.shape[:3], -1))
        across = self._basis.transpose(0, 2, 1) @ flat
        flat = flat - self._basis @ (self._part[..., None] * across)
        by = self._by.reshape(-1, *[1] * (found.ndim - 3))
        return np.asarray(flat.reshape(found.shape) * by)

    def _covariance(self, left: Float64) -> Float64:
        """Return the covariance over ticks of each channel, shape (m, l, l)."""
        rows = left * np.sqrt(self._weights)[:, None, None]
        found = np.einsum("wlc,wkc->clk", rows, rows) / self.count
        diagonal = np.einsum("cll->cl", found)
        shrunk = (1.0 - SHRUNK) * found
        floor = 1e-6 * diagonal.mean(axis=1, keepdims=True) + 1e-18
        np.einsum("cll->cl", shrunk)[...] += SHRUNK * diagonal + floor
        return np.asarray(shrunk)

    def information(self, left: Float64, slopes: Float64) -> Float64:
        """Return Fisher's information on changes, shape (p, p); arguments as of `fit`."""
        inverse = np.linalg.inv(self._covariance(self._described(left)))
        slopes = self._described(slopes)
        return np.asarray(
            np.einsum("clk,wkcp,wlcq,w->pq", inverse, slopes, slopes, self._weights, optimize=True)
        )

    def fit(
        self, left: Float64, slopes: Float64, usual: Float64, before: Float64 | float = 0.0
    ) -> Fitted:
        """Fit changes to what is left.

        Args:
            left: without them, shape (w, l, m).
            slopes: derivatives of the answers by each change, shape (w, l, m, p).
            usual: standard deviation of each change beforehand, shape (p,).
            before: sizes of these changes that the answers have already.
        """
        gain, size = -self.log(left), np.zeros(slopes.shape[-1])
        left, slopes = self._described(left), self._described(slopes)
        for _ in range(ROUNDS):
            inverse = np.linalg.inv(self._covariance(left - slopes @ size))
            weighted = np.einsum("clk,wkcp,w->wlcp", inverse, slopes, self._weights, optimize=True)
            curvature = np.einsum("wlcp,wlcq->pq", weighted, slopes) + np.diag(usual**-2.0)
            asked = np.einsum("wlcp,wlc->p", weighted, left) - before / usual**2
            before, size = size, np.linalg.solve(curvature, asked)
            if np.allclose(size, before, rtol=1e-3, atol=1e-9):
                break
        after = left - slopes @ size
        last = self._covariance(after)
        each = np.einsum("wlcp,wlc->wp", weighted, after)
        inverse = np.linalg.inv(curvature)
        scatter = _scatter(each)
        return Fitted(
            size=size,
            spread=inverse @ (scatter + np.diag(usual**-2.0)) @ inverse,
            gain=gain - 0.5 * self.count * float(np.linalg.slogdet(last)[1].sum()),
            kappa=float(np.trace(inverse @ scatter) / len(size)),
        )


def _scatter(each: Float64) -> Float64:
    """Return the scatter of windows' slopes, shape (w, p), neighbours counted; shape (p, p)."""
    found = each.T @ each
    for apart, weight in ((1, 2.0 / 3.0), (2, 1.0 / 3.0)):
        beside = each[apart:].T @ each[:-apart]
        found = found + weight * (beside + beside.T)
    return np.asarray(found)
