"""Windows of a motion: how they begin, and derivatives of their answers, and what is left.

What a window begins with was measured with noise, and the velocity and the height of the base often
not at all. It is found for each window: at first by the joints alone, then by the likelihood, for
each size from the same start, since a beginning that was fitted with one size favours that size.

Likelihood of what is left of a motion once a change explains its part: what is left, r of a window
and channel, has a t-distribution (Lange, Little and Taylor 1989) with a scatter over the window's
ticks that is not known: it holds sensor noise, which a window begins with, and what the simulator
cannot say. Its tails are heavy since contacts that come a tick late leave a lot in few windows. So
the scatter is estimated with the change, and the likelihood is the concentrated one (Cox and
Hinkley 1974, section 9.3),

    log L = -W/2 · Σ_c log det C_c - (ν+k)/2 · Σ_wc log(1 + r_wcᵀ C_c⁻¹ r_wc / ν),

of W windows and channels c, with C_c = Σ_w u_wc r_wc r_wcᵀ / W and the weights
u_wc = (ν+k) / (ν + r_wcᵀ C_c⁻¹ r_wc). A window's ticks are described by at most k = 4 polynomials
of time, so that W windows are enough to estimate C: with ten ticks and 13 windows, any change
gains. Channels are not independent, nor are windows that follow each other: it is a composite
likelihood, whose ratios are κ times too large with κ = tr(H⁻¹J)/p of curvature H and scatter J of
the windows' slopes, and whose intervals come from H⁻¹JH⁻¹ (Varin, Reid and Firth 2011). J counts
the correlation of windows up to two apart (Newey and West 1987).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from unicon_base.arrays import Bool, Float64
from unicon_lab.diagnose.motion import Motion
from unicon_lab.diagnose.plant import KINDS, Change, Place, step_of
from unicon_lab.diagnose.replays import Aside, Part, Run, RunOfAll

SHAPES = 4
"""Polynomials that describe a window, at most; fewer where there are less than six windows each."""
SHRUNK = 0.05
"""Part of a scatter that is drawn to its diagonal: few windows tell it."""
ROUNDS, TURNS = 8, 10
"""Of a fit, and of the scatter in each of them."""
TAILS = 2.0
"""Degrees of freedom ν. In a Go1's walks in PyBullet the log-likelihood jumped by 50 where that of
a Gaussian jumped by 64, and a payload that was not there gained 40 and not 230."""


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
    """Of what is left; pushes and slips count less.

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

    def log(self, left: Float64) -> float:
        """Return the concentrated log-likelihood of what is left, shape (w, l, m)."""
        return self._settled(self._described(left))[2]

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

    def _settled(self, rows: Float64) -> tuple[Float64, Float64, float]:
        """Return the inverse scatter of each channel, weights and log-likelihood.

        Args:
            rows: what is left, described, shape (w, k, m).

        Returns:
            Shapes (m, k, k) and (m, w).
        """
        by = np.ascontiguousarray(rows.transpose(2, 0, 1))
        shapes = by.shape[2]
        weights: Float64 = np.ones(by.shape[:2])
        for _ in range(TURNS):
            found = (by * weights[..., None]).swapaxes(1, 2) @ by / len(rows)
            diagonal = np.einsum("cll->cl", found)
            floor = 1e-6 * diagonal.mean(axis=1, keepdims=True) + 1e-18
            scatter = (1.0 - SHRUNK) * found
            np.einsum("cll->cl", scatter)[...] += SHRUNK * diagonal + floor
            inverse = np.linalg.inv(scatter)
            square = ((by @ inverse) * by).sum(axis=2)
            weights = (TAILS + shapes) / (TAILS + square)
        log = len(rows) * np.linalg.slogdet(scatter)[1].sum()
        log += (TAILS + shapes) * np.log1p(square / TAILS).sum()
        return np.asarray(inverse), weights, float(-0.5 * log)

    def information(self, left: Float64, slopes: Float64) -> Float64:
        """Return Fisher's information on changes, shape (p, p); arguments as of `fit`."""
        rows, slopes = self._described(left), self._described(slopes)
        inverse, weights, _ = self._settled(rows)
        part = (TAILS + rows.shape[1]) / (TAILS + rows.shape[1] + 2.0)
        return np.asarray(
            part
            * np.einsum("clk,wkcp,wlcq,cw->pq", inverse, slopes, slopes, weights, optimize=True)
        )

    def fit(self, left: Float64, slopes: Float64, usual: Float64) -> Fitted:
        """Fit changes to what is left.

        Args:
            left: without them, shape (w, l, m).
            slopes: derivatives of the answers by each change, shape (w, l, m, p).
            usual: standard deviation of each change from here, beforehand, shape (p,).
        """
        size = np.zeros(slopes.shape[-1])
        left, slopes = self._described(left), self._described(slopes)
        gain = -self._settled(left)[2]
        for _ in range(ROUNDS):
            inverse, weights, _ = self._settled(left - slopes @ size)
            weighted = np.einsum("clk,wkcp,cw->wlcp", inverse, slopes, weights, optimize=True)
            curvature = np.einsum("wlcp,wlcq->pq", weighted, slopes) + np.diag(usual**-2.0)
            asked = np.einsum("wlcp,wlc->p", weighted, left)
            last, size = size, np.linalg.solve(curvature, asked)
            if np.allclose(size, last, rtol=1e-3, atol=1e-9):
                break
        after = left - slopes @ size
        scores = np.einsum("wlcp,wlc->wcp", weighted, after)
        # The weights fall with what is left: the likelihood is less bent than their sum says.
        flatter = np.einsum("wcp,wcq->pq", scores, scores) * 2.0 / (TAILS + left.shape[1])
        flatter = np.linalg.solve(curvature, flatter).trace() / len(size)
        inverse = np.linalg.inv((1.0 - min(flatter, 0.5)) * curvature)
        scatter = _scatter(scores.sum(axis=1)) * (len(left) / max(len(left) - left.shape[1], 1))
        return Fitted(
            size=size,
            spread=inverse @ (scatter + np.diag(usual**-2.0)) @ inverse,
            gain=gain + self._settled(after)[2],
            kappa=float(np.trace(inverse @ scatter) / len(size)),
        )


def _scatter(each: Float64) -> Float64:
    """Return the scatter of windows' slopes, shape (w, p), neighbours counted; shape (p, p)."""
    found = each.T @ each
    for apart, weight in ((1, 2.0 / 3.0), (2, 1.0 / 3.0)):
        beside = each[apart:].T @ each[:-apart]
        found = found + weight * (beside + beside.T)
    return np.asarray(found)


REFINED = 3
"""Steps of all sizes together, at most: they grow while they help, since effects of inertia and
friction saturate, and shrink where they do not, since contacts make the likelihood rough."""
WIDE, MOVES = 3.0, 3
"""Standard deviations between sizes whose likelihoods a parabola is fitted to, and how often these
sizes are moved. In a Go1's walk the log-likelihood jumped by 77 (standard deviation) between
dampings 6 % apart."""
_GRID = np.arange(-2.0, 3.0)
# With a tenth of a step their mean lay 116 below no change in a healthy Go2's walk.
_AROUND = [
    ((kind, -1), sign * KINDS[kind].step)
    for kind in ("strength", "friction")
    for sign in (-0.02, 0.02)
]
_WORST = 3.0
"""Most that an error counts beside its median, where a window chooses how it begins."""


class Settled:
    """How the windows of a motion begin, and the likelihood of what is left of them.

    Args:
        motion: that was measured.
        run: replays changes.

    Attributes:
        run: replays changes beside the last of `begun`; see `Aside`.
        begins: of windows.
        likelihood: leaves out what other beginnings could explain.
    """

    def __init__(self, motion: Motion, run: RunOfAll) -> None:
        self._real, self._all = motion.answers, run
        self.run: Run = run
        self._turns = 1 + motion.sought  # one that was found without a change hides a change
        self.begins: Float64
        self.likelihood: Likelihood

    def begin(self) -> Float64:
        """Find how windows begin without a change, and return the answers."""
        self._first = self._all.settle({})
        return self.begun({})

    def part(self, chosen: Bool, now: Float64) -> Settled:
        """Return some of the windows alone, shape (w,), whose answers are `now` of all windows.

        These begin as without a change, whatever the change is: five times less to replay.
        """
        part = copy(self)
        part._turns = 0
        part._real, part._unknown = self._real[chosen], self._unknown[chosen]
        part._first, part.begins = self._first[chosen], self.begins[chosen]
        part.run = Part(self.run, chosen)
        part.likelihood = copy(self.likelihood)  # for `leave_out`
        part._leave_out(now[chosen])
        return part

    def begun(self, change: Change) -> Float64:
        """Find how windows begin with a change, and return the answers.

        The likelihood is from now on of what is left there.
        """
        now, self._unknown = self._all.derived(change, self._first)
        self.run = Aside(self._all, change)
        if not change:
            self.likelihood = Likelihood(self._real - now)
        self._leave_out(now)
        now, self.begins = self.best_of([change])[0]
        self._leave_out(now)
        return now

    def _leave_out(self, now: Float64) -> None:
        self.likelihood.leave_out(self._unknown, self.run.likely, self._real - now)

    def refined(
        self, at: dict[Place, float]
    ) -> tuple[dict[Place, float], Float64, Float64, Fitted, float]:
        """Fit sizes of changes together; windows begin with each size as they fit it best.

        Returns:
            Sizes, answers, beginnings, the last fit, and the likelihood, as of `level`.
        """
        usual = np.array([KINDS[kind].usual for kind, _ in at])
        now, begins = self.best_of([at])[0]
        log, part, better = self.likelihood.log(self.left(now, begins)), 1.0, True
        *_, last = at
        turn = REFINED if (read_off := last in self._all.read_off) else 0  # nothing else moves
        while better:
            beside = [at | {place: size + step_of(place)} for place, size in at.items()]
            moved = self.run(beside, [begins] * len(at))
            slopes = np.stack([(e - now) / step_of(place) for e, place in zip(moved, at)], axis=-1)
            fitted = self.likelihood.fit(self.left(now, begins), slopes, usual)
            better, near = False, 0.2 * np.sqrt(np.diag(fitted.spread))
            while not better and turn < REFINED:
                sizes = zip(at.items(), part * fitted.size)
                trial = {p: self.run.clip(p, size + step) for (p, size), step in sizes}
                if all(abs(trial[place] - at[place]) < least for place, least in zip(at, near)):
                    break
                answers, its = self.best_of([trial])[0]
                there = self.likelihood.log(self.left(answers, its))
                turn, better = turn + 1, there > log
                part = min(2.0 * part, 4.0) if better else 0.3 * part
            if better:
                at, now, begins, log = trial, answers, its, there
        for row, place in enumerate(at):
            if place == last or (KINDS[place[0]].stepped and not read_off):
                at, fitted, log = self._peak(at, place, row, fitted)
        return at, *self.best_of([at])[0], fitted, log

    def _peak(
        self, at: dict[Place, float], place: Place, row: int, fitted: Fitted
    ) -> tuple[dict[Place, float], Fitted, float]:
        """Move one size to where a parabola of the likelihood peaks, and widen its deviation.

        Contacts make the likelihood rough, so that derivatives end on its flanks; a simulator
        rounds some sizes to its steps. Returns the parabola's height too.
        """
        variance, kappa = fitted.spread[row, row], max(fitted.kappa, 1.0)
        size, step = at[place], WIDE * math.sqrt(variance)
        if KINDS[place[0]].stepped:
            step = self.run.step
            size = max(round(size / step), 2) * step
        for _ in range(MOVES):
            sizes = sorted({self.run.clip(place, each) for each in size + step * _GRID})
            logs = self._logs([at | {place: each} for each in sizes])
            x = (np.array(sizes) - size) / step
            fit = np.polynomial.Polynomial.fit(x, logs, min(2, len(x) - 1), domain=[-1, 1])
            slope, bent = [*fit.coef, 0.0, 0.0][1:3]
            peak = -0.5 * slope / bent if bent < 0.0 else x[logs.argmax()]
            size += step * float(np.clip(peak, x[0], x[-1]))
            if bent < 0.0 and x[0] <= peak <= x[-1]:
                rough = 0.5 * ((logs - fit(x)) ** 2).sum() / (4.0 * bent**2)
                rough *= 1.0 / 10.0 + 4.0 * peak**2 / 14.0
                variance = max(variance, step**2 * (0.5 * kappa / -bent + rough))
                break
        else:
            variance += step**2
        spread = fitted.spread.copy()
        spread[row, row] = variance
        log = float(fit(np.clip(peak, x[0], x[-1])))
        return at | {place: self.run.clip(place, size)}, replace(fitted, spread=spread), log

    def level(self, at: dict[Place, float]) -> tuple[float, float]:
        """Return what candidates beside changes are judged against, without and with `read_off`.

        The mean likelihood of changes, which is rough, and of some that differ by a little; and
        that of the changes, since what is read off moves nothing else.
        """
        logs = self._logs([at, *({**at, p: at.get(p, 0.0) + d} for p, d in _AROUND)])
        return float(logs.mean()), float(logs[0])

    def _logs(self, changes: Sequence[Change]) -> Float64:
        found = self.best_of(changes)
        return np.array([self.likelihood.log(self.left(*each)) for each in found])

    def best_of(self, changes: Sequence[Change]) -> list[tuple[Float64, Float64]]:
        """Return answers of each change, and how windows begin that fit it best."""
        begins = [self._first] * len(changes)
        answers, twice = self.run(changes, begins), [each for each in changes for _ in range(2)]
        for _ in range(self._turns):
            tries = [self.tries(self.left(*each), each[1]) for each in zip(answers, begins)]
            more = iter(self.run(twice, [each for its in tries for each in its]))
            found = zip(answers, begins, tries)
            best = [self.best([now, next(more), next(more)], [at, *its]) for now, at, its in found]
            answers, begins = [now for now, _ in best], [at for _, at in best]
        return list(zip(answers, begins))

    def left(self, answers: Float64, begins: Float64 | None = None) -> Float64:
        """Return what is left of the motion, had windows begun as they were measured.

        Args:
            answers: of a replay, shape (w, l, m).
            begins: of that replay, by default those that are the best.
        """
        begins = self.begins if begins is None else begins
        return np.asarray(self._real - answers + np.einsum("wlmq,wq->wlm", self._unknown, begins))

    def tries(self, left: Float64, begins: Float64) -> list[Float64]:
        """Return how windows may begin, instead of so, that it explains what is left.

        Contacts resist more than a derivative says, so a step of twice the size is one of them.
        """
        step = self.likelihood.unknowns(left) - begins
        return [begins + step, begins + 2.0 * step]

    def best(self, answers: Sequence[Float64], tries: Sequence[Float64]) -> tuple[Float64, Float64]:
        """Return answers and beginnings that fit best, for each window by itself."""
        costs = []
        for answer, begins in zip(answers, tries):
            left = np.minimum(np.abs((self._real - answer) / self.likelihood.scale), _WORST)
            unlikely = begins / self.run.likely
            costs.append((left**2).sum(axis=(1, 2)) + (unlikely**2).sum(axis=1))
        window, which = np.arange(len(self._real)), np.argmin(costs, axis=0)
        return np.stack(answers)[which, window], np.stack(tries)[which, window]
