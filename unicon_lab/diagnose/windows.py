"""Windows of a motion: how they begin, and derivatives of their answers, and what is left.

What a window begins with was measured with noise, and the velocity and the height of the base often
not at all. It is found for each window: at first by the joints alone, then by the likelihood,
together with sizes of changes.

Likelihood of what is left of a motion once a change explains its part: what is left, r of a window
and channel, is Gaussian with a covariance over the window's ticks that is not known: it holds
sensor noise, which a window begins with, and what the simulator cannot say. So the covariance is
estimated with the change, and the likelihood is the concentrated one (Cox and Hinkley 1974, section
9.3),

    log L = -W/2 · Σ_c log det C_c,    C_c = Σ_w r_wc r_wcᵀ / W,

of W windows and channels c. A window's ticks are described by at most four polynomials of time, so
that W windows are enough to estimate C: with ten ticks and 13 windows, any change gains. Channels
are not independent, nor are windows that follow each other: it is a composite likelihood, whose
ratios are κ times too large with κ = tr(H⁻¹J)/p of curvature H and scatter J of the windows'
slopes, and whose intervals come from H⁻¹JH⁻¹ (Varin, Reid and Firth 2011). J counts the correlation
of windows up to two apart (Newey and West 1987).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from unicon_base.arrays import Bool, Float64, Int64
from unicon_lab.diagnose.motion import Motion
from unicon_lab.diagnose.plant import KINDS, Change, Place
from unicon_lab.diagnose.replays import Run

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


REFINED = 7
"""Turns in which sizes and the unknown beginnings of windows are fitted together, at most. Steps
grow while they go one way, since effects of inertia and friction saturate, and get smaller where
they turn back, since contacts make the likelihood rough (Riedmiller and Braun 1993)."""
BEGUN = 3
"""Turns in which beginnings alone are, before a candidate is compared with none."""
_SETTLED = 2
"""Turns in which the beginnings alone are fitted by the likelihood."""
_WORST = 3.0
"""Most that an error counts beside its median, where a window chooses how it begins."""

ENOUGH = 24
"""Windows, from which on every second one is enough for a first look at all changes."""


class Settled:
    """How the windows of a motion begin, and the likelihood of what is left of them.

    Args:
        motion: that was measured.
        run: replays changes.

    Attributes:
        begins: of windows.
        likelihood: leaves out what other beginnings could explain.
    """

    def __init__(self, motion: Motion, run: Run) -> None:
        self._real, self._run = motion.answers, run
        self.begins: Float64
        self.likelihood: Likelihood

    def begin(self) -> Float64:
        """Find how windows begin without a change, and return the answers."""
        self.begins = self._run.settle({})
        now, self._unknown = self._run.derived({}, self.begins)
        self.likelihood = Likelihood(self._real - now)
        self._leave_out(now)
        for _ in range(_SETTLED):
            _, self.begins = self.chosen({}, self.tries(self.begins, self.left(now)))
            now = self.derived({})
        return now

    def derived(self, change: Change) -> Float64:
        """Return the answers with a change; the likelihood is from now on of what is left there."""
        now, self._unknown = self._run.derived(change, self.begins)
        self._leave_out(now)
        return now

    def _leave_out(self, now: Float64) -> None:
        self.likelihood.leave_out(self._unknown, self._run.likely, self._real - now)

    def begun(self, at: dict[Place, float]) -> tuple[Float64, Float64]:
        """Return answers and beginnings with changes that stay, fitted as closely as others are."""
        for _ in range(BEGUN):
            now = self.derived(at)
            now, self.begins = self.chosen(at, self.tries(self.begins, self.left(now)))
        return now, self.begins

    def refined(
        self, at: dict[Place, float], begins: Float64
    ) -> tuple[dict[Place, float], Float64, Float64, Fitted]:
        """Fit sizes of changes together with how windows begin; these only where that helps one.

        Returns:
            Sizes, answers, beginnings, and the last fit.
        """
        usual = np.array([KINDS[kind].usual for kind, _ in at])
        self.begins = begins
        part, last = 1.0, np.zeros(len(at))
        for _ in range(REFINED):
            now = self.derived(at)
            beside = [at | {place: size + KINDS[place[0]].step} for place, size in at.items()]
            moved = self._run(beside, [self.begins] * len(at))
            slopes = np.stack([(e - now) / KINDS[k].step for e, (k, _) in zip(moved, at)], axis=-1)
            left = self.left(now)
            fitted = self.likelihood.fit(left, slopes, usual)
            sizes = np.array(list(at.values()))
            step = fitted.size / np.sqrt(np.diag(fitted.spread))
            along, least, last = step @ last, 0.25 * (last @ last), step
            if along < 0.0:
                part = 0.5 * min(part, 1.0)
            elif along > least:
                part = min(2.0 * part, 4.0)
            after = sizes + part * fitted.size
            after = np.array([self._run.clip(*each) for each in zip(at, after)])
            if np.all(np.abs(after - sizes) < 0.2 * np.sqrt(np.diag(fitted.spread))):
                break
            at = dict(zip(at, after.tolist()))
            tries = self.tries(self.begins, left - slopes @ (after - sizes))
            now, self.begins = self.chosen(at, tries)
        stepped = [place for place in at if KINDS[place[0]].stepped]
        for place in stepped:
            at = self._peak(at, place)
        if stepped:
            now = self._run([at], [self.begins])[0]
        return at, now, self.begins, fitted

    def _peak(self, at: dict[Place, float], place: Place) -> dict[Place, float]:
        """Return sizes with the one that a simulator rounds to its steps where a parabola peaks."""
        step = self._run.step
        grid = max(round(at[place] / step), 2) * step + step * np.arange(-2.0, 3.0)
        answers = self._run([at | {place: float(size)} for size in grid], [self.begins] * len(grid))
        logs = np.array([self.likelihood.log(self.left(e)) for e in answers])
        bent, slope, _ = np.polyfit(grid - grid[2], logs, 2)
        peak = grid[2] - 0.5 * slope / bent if bent < 0.0 else grid[logs.argmax()]
        return at | {place: float(np.clip(peak, grid[0], grid[-1]))}

    def left(self, answers: Float64, begins: Float64 | None = None) -> Float64:
        """Return what is left of the motion, had windows begun as they were measured.

        Args:
            answers: of a replay, shape (w, l, m).
            begins: of that replay, by default those that are the best.
        """
        begins = self.begins if begins is None else begins
        return np.asarray(self._real - answers + np.einsum("wlmq,wq->wlm", self._unknown, begins))

    def tries(self, begins: Float64, left: Float64) -> list[Float64]:
        """Return how windows may begin: as they do, and so that it explains what is left.

        Contacts resist more than a derivative says, so a step of twice the size is one of them.
        """
        step = self.likelihood.unknowns(left) - begins
        return [begins, begins + step, begins + 2.0 * step]

    def chosen(self, change: Change, tries: Sequence[Float64]) -> tuple[Float64, Float64]:
        """Return the answers of a change, and how each window begins where it fits best."""
        return self.best(self._run([change] * len(tries), tries), tries)

    def best(self, answers: Sequence[Float64], tries: Sequence[Float64]) -> tuple[Float64, Float64]:
        """Return answers and beginnings that fit best, for each window by itself."""
        costs = []
        for answer, begins in zip(answers, tries):
            left = np.minimum(np.abs((self._real - answer) / self.likelihood.scale), _WORST)
            unlikely = begins / self._run.likely
            costs.append((left**2).sum(axis=(1, 2)) + (unlikely**2).sum(axis=1))
        window, which = np.arange(len(self._real)), np.argmin(costs, axis=0)
        return np.stack(answers)[which, window], np.stack(tries)[which, window]


class Derivatives:
    """Derivatives of a motion's answers by the places of a plant, shape (w, l, m) each.

    Args:
        places: by which.
        limbs: of each joint, shape (n,); joints of several limbs are moved at once, each its own.
        run: replays changes.
        windows: of the motion. Of `ENOUGH`, every second one is zero until it is asked for.

    Attributes:
        half: windows that all derivatives have, shape (w,).
    """

    def __init__(self, places: Sequence[Place], limbs: Int64, run: Run, windows: int) -> None:
        self._places, self._limbs, self._run = places, limbs, run
        self.half: Bool = np.arange(windows) % (1 + (windows >= ENOUGH)) == 0
        self._found: dict[Place, Float64] = {}
        self._lacking = {*places} if windows >= ENOUGH else set[Place]()
        self._now: Float64
        self._begins: Float64

    def __getitem__(self, place: Place) -> Float64:
        return self._found[place]

    def take(self, now: Float64, begins: Float64) -> None:
        """Take all where answers are `now`, of windows that begin so."""
        self._now, self._begins = now, begins
        together: dict[tuple[str, int], list[Place]] = {}
        for kind, joint in self._places:
            turn = joint if joint < 0 else int((self._limbs[:joint] == self._limbs[joint]).sum())
            together.setdefault((kind, turn), []).append((kind, joint))
        groups = list(together.values())
        for group, slope in zip(groups, self._taken(groups, self.half)):
            for place in group:
                own = np.ones(slope.shape[-1], np.bool_)
                if len(group) > 1:
                    own[len(self._limbs) :] = False
                    own[: len(self._limbs)] = self._limbs == self._limbs[place[1]]
                self._found[place] = slope * own

    def complete(self, places: Sequence[Place]) -> None:
        """Take those of places in the other windows, too."""
        lacking = [place for place in places if place in self._lacking]
        for place, slope in zip(lacking, self._taken([[each] for each in lacking], ~self.half)):
            self._found[place] = self._found[place] + slope
        self._lacking -= {*lacking}

    def _taken(self, groups: Sequence[Sequence[Place]], windows: Bool) -> list[Float64]:
        """Return derivatives by a step of each group; zeros of other windows."""
        steps = [KINDS[group[0][0]].step for group in groups]
        changes = [dict.fromkeys(group, step) for group, step in zip(groups, steps)]
        begins = np.where(windows[:, None], self._begins, np.nan)
        moved = self._run(changes, [begins] * len(groups))
        return [np.nan_to_num((each - self._now) / step) for each, step in zip(moved, steps)]
