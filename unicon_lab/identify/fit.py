"""Fit: the figures of joints under which open-loop replays come closest to what was measured.

Minimised is the mean over joints of the aligned MSE of the replays, by damped least squares
(Levenberg 1944, Marquardt 1963) with derivatives by differences. Figures come in one after the
other, those first that explain most, as long as they explain more than noise would. The shift in
time is held at zero where delays are estimated: it would hide them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from unicon_base.arrays import Bool, Float64, Int64
from unicon_base.errors import UniconError, alternatives
from unicon_core.metrics import aligned_mse
from unicon_core.models.load import load_model
from unicon_core.platforms.kit.scene import Scene
from unicon_core.robots import Robot
from unicon_core.robots.load import JOINT_PHYSICS, joint_physics, joints_like
from unicon_lab.identify.found import Fit, Parameter
from unicon_lab.identify.replays import Motion, Replays

Normal = tuple[Float64, Float64, float]
"""The curvature (p, p), what the answers ask for (p,), and the noise in [rad]."""

# What a figure is varied by for its derivative, and how far off it may well be beforehand: the
# latter holds those at the model's that the motion says nothing of.
_STEP = {"strength": 0.03, "friction": 0.05, "armature": 0.002, "delay": 0.002}
_PRIOR = {"strength": 0.5, "friction": 1.0, "armature": 0.02, "delay": 0.01}
_MOST = {"strength": 2.0, "friction": 20.0, "armature": 0.5, "delay": 0.02}

ROUNDS = 12
DAMPINGS = (0.001, 0.03, 0.5, 10.0)
"""Tried at once in each round, in parts of the curvature."""
ENOUGH = 0.01
"""Share of the loss: a round that gains less is the last one."""
TELLS = 12.0
"""Chi-squared from which a figure tells: with 100 of them one in 20 fits does so by chance."""
HELD_OUT = 4
"""Every fourth window is left out of the fit, and tells whether it holds."""


def fit(
    motion: Motion,
    robot: Robot,
    *,
    scene: Scene | None = None,
    words: Sequence[str] = tuple(JOINT_PHYSICS),
    joints: Sequence[str] = ("*",),
    processes: int = 1,
    tell: Callable[[str], None] = lambda text: None,
) -> Fit:
    """Estimate figures of joints from a recorded motion.

    Args:
        motion: what was measured and commanded.
        robot: whose simulator is fitted; what its file says under `simulated` is the beginning.
        scene: its model; None for the robot file's.
        words: what is estimated, of `JOINT_PHYSICS`.
        joints: names and patterns of the joints whose figures are.
        processes: that replay at once.
        tell: takes a line for each round.

    Raises:
        UniconError: no such word or joint, or the simulator cannot be built.
    """
    for word in words:
        if word not in JOINT_PHYSICS:
            raise UniconError(f"no figure {word!r} of joints; {alternatives(word, JOINT_PHYSICS)}")
    which = sorted({i for pattern in joints for i in joints_like(pattern, robot)})
    if not which or not words:
        raise UniconError("nothing to estimate; name joints and figures")
    scene = scene or Scene()
    figures, limbs = _simulator(robot, scene)
    keys = [(i, word) for word in words for i in which]
    with Replays(robot, scene, motion, processes) as replays:
        return _Search(motion, robot, keys, figures, limbs, replays, tell).run()


def _simulator(robot: Robot, scene: Scene) -> tuple[dict[str, Float64], Int64]:
    """Return what the simulator has of each figure, and which limb each joint belongs to.

    Both of shape (n,).
    """
    loaded = load_model(scene.model_path(robot), robot, quiet=True)
    model, physics = loaded.model, joint_physics(robot, scene.joints)
    dofs = loaded.dofs
    figures = {
        "strength": np.nan_to_num(physics.strength, nan=1.0),
        "friction": _said(physics.friction, model.dof_frictionloss[dofs]),
        "armature": _said(physics.armature, model.dof_armature[dofs]),
        "delay": np.nan_to_num(physics.delay),
    }
    root = 0 if loaded.base is None else int(model.jnt_bodyid[loaded.base])
    limbs = []
    for joint in loaded.joints:
        body = int(model.jnt_bodyid[joint])
        while int(model.body_parentid[body]) not in (root, 0):
            body = int(model.body_parentid[body])
        limbs.append(body)
    return figures, np.array(limbs)


def _said(figures: Float64, otherwise: Float64) -> Float64:
    return np.where(np.isnan(figures), otherwise, figures)


class _Search:
    """The rounds of a fit."""

    def __init__(
        self,
        motion: Motion,
        robot: Robot,
        keys: Sequence[tuple[int, str]],
        figures: dict[str, Float64],
        limbs: Int64,
        replays: Replays,
        tell: Callable[[str], None],
    ) -> None:
        self._motion, self._robot, self._keys, self._replays = motion, robot, keys, replays
        self._tell, self._real = tell, motion.answers
        self._begin = np.array([figures[word][i] for i, word in keys])
        self._limbs, self._groups = limbs, _groups(keys, limbs)
        # A window knows one tick before it: no longer delay can show.
        largest = _MOST | {"delay": min(_MOST["delay"], motion.period)}
        self._step, self._prior, most = (
            np.array([known[word] for _, word in keys]) for known in (_STEP, _PRIOR, largest)
        )
        self._most = np.maximum(most, self._begin)
        self._shift = 0 if any(word == "delay" for _, word in keys) else motion.length // 2
        count = len(self._real)
        self._held = np.arange(count) % HELD_OUT == HELD_OUT - 1
        self._fitted = ~self._held

    def run(self) -> Fit:
        """Go round by round to where the loss is smallest."""
        at, free = self._begin.copy(), np.zeros(len(self._begin), np.bool_)
        barred = free.copy()  # figures that turned out not to differ
        first = now = self._replay([at])[0]
        weights, deviations, rounds = self._weights(now), np.zeros(len(at)), 0
        for rounds in range(1, ROUNDS + 1):
            slopes = self._slopes(at, now)
            known = int(free.sum())
            normal = self._normal(now, slopes, weights)
            free |= self._telling(normal, free) & ~barred
            tried = self._candidates(at, normal, free)
            answers = self._replay(tried)
            costs = [self._cost(a, x, weights) for a, x in zip(answers, tried)]
            best, old = int(np.argmin(costs)), self._cost(now, at, weights)
            if costs[best] < old:
                at, now = tried[best], answers[best]
            self._tell(
                f"round {rounds}: {free.sum()} figures, aligned MSE "
                f"{self._loss(now, self._fitted):.4g} of {self._loss(first, self._fitted):.4g} rad²"
            )
            if costs[best] > (1.0 - ENOUGH) * old and free.sum() == known:
                deviations = self._deviations(now, slopes, weights, free)
                idle = free & (np.abs(at - self._begin) <= deviations)
                if not idle.any():
                    break
                free, barred = free & ~idle, barred | idle
                at[idle] = self._begin[idle]
                now = self._replay([at])[0]
            weights = self._weights(now)
        else:
            deviations = self._deviations(now, self._slopes(at, now), weights, free)
        return self._fit(at, deviations, free, first, now, rounds)

    def _replay(self, points: Sequence[Float64]) -> list[Float64]:
        sets: list[dict[str, dict[str, float]]] = []
        for point in points:
            sets.append({})
            for (i, word), value in zip(self._keys, point):
                sets[-1].setdefault(self._robot.joint_names[i], {})[word] = float(value)
        return self._replays(sets)

    def _slopes(self, at: Float64, now: Float64) -> Float64:
        """Return the derivatives of every answer, shape (w, l, n, p)."""
        steps = np.where(at + self._step <= self._most, self._step, -self._step)
        points = []
        for group in self._groups:
            points.append(at.copy())
            points[-1][group] += steps[group]
        slopes = np.zeros((*now.shape, len(at)))
        for group, answer in zip(self._groups, self._replay(points)):
            for k in group:
                own = self._limbs == self._limbs[self._keys[k][0]]
                slopes[:, :, own, k] = (answer - now)[:, :, own] / steps[k]
        return slopes

    def _normal(self, now: Float64, slopes: Float64, weights: Float64) -> Normal:
        residual, slopes = self._aligned(now, slopes)
        root = np.sqrt(weights)[self._fitted, None, None]
        rows = (slopes[self._fitted] * root[..., None]).reshape(-1, slopes.shape[-1])
        asked = rows.T @ (residual[self._fitted] * root).reshape(-1)
        return rows.T @ rows, asked, self._noise(residual, weights)

    def _telling(self, normal: Normal, free: Bool) -> Bool:
        """Return the figures that would explain more than noise does, beside those that are free.

        With all of them free a run of seconds would be explained by many that are as they should
        be. Of those that tell, the best is taken, and what tells half as much.
        """
        curvature, asked, noise = normal
        curvature = curvature + np.diag((noise / self._prior) ** 2)
        gains = np.zeros(len(asked))
        some = np.flatnonzero(free)
        for k in np.flatnonzero(~free):
            across = np.linalg.solve(curvature[np.ix_(some, some)], curvature[some, k])
            left = asked[k] - across @ asked[some]
            gains[k] = left**2 / (curvature[k, k] - across @ curvature[some, k])
        # Within a window the noise is one: its ticks count as one sample.
        enough = TELLS * noise**2 * self._motion.length
        found: Bool = (gains > enough) & (gains >= 0.5 * gains.max())
        return found

    def _candidates(self, at: Float64, normal: Normal, free: Bool) -> list[Float64]:
        curvature, asked, noise = normal
        ridge = (noise / self._prior) ** 2
        asked = asked + ridge * (self._begin - at)
        some, found = np.flatnonzero(free), []
        for damping in DAMPINGS:
            matrix = curvature + np.diag(ridge + damping * (np.diag(curvature) + ridge))
            point = at.copy()
            point[some] += np.linalg.solve(matrix[np.ix_(some, some)], asked[some])
            found.append(np.clip(point, 0.0, self._most))
        return found

    def _aligned(self, now: Float64, slopes: Float64) -> tuple[Float64, Float64]:
        """Return real - now and the slopes, each joint of now at the shift that suits it best."""
        residual = self._real - now
        if not self._shift:
            return residual, slopes
        slopes = slopes.copy()
        for joint, shift in enumerate(self._losses(now, self._fitted)[1]):
            if shift:
                apart = np.zeros_like(residual[:, :, joint])
                turned = np.zeros_like(slopes[:, :, joint])
                low, high = max(0, -shift), self._motion.length - max(0, shift)
                real = self._real[:, low + shift : high + shift, joint]
                apart[:, low:high] = real - now[:, low:high, joint]
                turned[:, low:high] = slopes[:, low:high, joint]
                residual[:, :, joint], slopes[:, :, joint] = apart, turned
        return residual, slopes

    def _weights(self, now: Float64) -> Float64:
        """Return a weight for each window (Huber's): pushes and slips do not count in full."""
        size = np.sqrt(((self._real - now) ** 2).mean(axis=(1, 2)))
        usual = 2.0 * float(np.median(size))
        weights: Float64 = np.minimum(1.0, usual / np.maximum(size, 1e-12))
        return weights

    def _noise(self, residual: Float64, weights: Float64) -> float:
        squares = (residual**2).mean(axis=(1, 2))[self._fitted]
        weighted = weights[self._fitted]
        return math.sqrt(float((squares * weighted).sum() / weighted.sum()))

    def _cost(self, now: Float64, at: Float64, weights: Float64) -> float:
        """Return what is minimised: weighted squares, and how far the figures went."""
        residual, _ = self._aligned(now, np.zeros((*now.shape, 1)))
        noise = max(self._noise(residual, weights), 1e-9)
        squares = float(((residual**2).sum(axis=(1, 2)) * weights)[self._fitted].sum())
        return squares + noise**2 * float((((at - self._begin) / self._prior) ** 2).sum())

    def _losses(self, now: Float64, windows: Bool) -> tuple[Float64, Int64]:
        """Return each joint's aligned MSE [rad²] over windows, and its shift, shape (n,).

        Of all shifts within a window the one that suits all windows together.
        """
        real, sim = (values[windows].transpose(2, 1, 0) for values in (self._real, now))
        found = aligned_mse(real, sim, max_shift=self._shift)
        return found.loss / real.shape[-1], found.shift

    def _loss(self, now: Float64, windows: Bool) -> float:
        return float(self._losses(now, windows)[0].mean())

    def _deviations(self, now: Float64, slopes: Float64, weights: Float64, free: Bool) -> Float64:
        """Return half of the 95 % interval of each free figure, 0 of the others.

        The scatter of the windows tells it (sandwich), since what is left within one is no white
        noise: A⁻¹ (Σ g gᵀ) A⁻¹ of the curvature A and each window's slope g.
        """
        some = np.flatnonzero(free)
        residual, slopes = self._aligned(now, slopes[..., some])
        rows, apart = slopes[self._fitted], residual[self._fitted]
        weight = weights[self._fitted]
        ridge = np.diag((self._noise(residual, weights) / self._prior[some]) ** 2)
        inverse = np.linalg.inv(np.einsum("wlnp,wlnq,w->pq", rows, rows, weight) + ridge)
        each = np.einsum("wlnp,wln,w->wp", rows, apart, weight)
        scatter = 2.0 * each.T @ each  # windows overlap by half
        spread = np.diag(inverse @ (scatter + ridge) @ inverse)
        found = np.zeros(len(free))
        found[some] = 1.96 * np.sqrt(np.maximum(spread, 0.0))
        return found

    def _fit(
        self,
        at: Float64,
        deviations: Float64,
        free: Bool,
        first: Float64,
        now: Float64,
        rounds: int,
    ) -> Fit:
        names, every = self._robot.joint_names, np.ones(len(self._real), np.bool_)
        parameters = tuple(
            Parameter(names[i], word, float(before), float(after), float(deviation))
            for (i, word), before, after, deviation, known in zip(
                self._keys, self._begin, at, deviations, free
            )
            if known
        )
        losses = [self._losses(answer, every)[0] for answer in (first, now)]
        return Fit(
            parameters=parameters,
            before=self._loss(first, self._fitted),
            after=self._loss(now, self._fitted),
            held_before=self._loss(first, self._held),
            held_after=self._loss(now, self._held),
            by_joint={n: (float(b), float(a)) for n, b, a in zip(names, *losses)},
            windows=(int(self._fitted.sum()), int(self._held.sum())),
            rounds=rounds,
            noise=self._noise(self._real - now, self._weights(now)),
        )


def _groups(keys: Sequence[tuple[int, str]], limbs: Int64) -> list[list[int]]:
    """Return figures that are varied in one replay: the same one of joints of different limbs.

    What a joint does to another limb, through the base, is left out of the derivatives: a round
    is judged by whole replays anyway.
    """
    groups: list[tuple[str, set[int], list[int]]] = []
    for k, (joint, word) in enumerate(keys):
        limb = int(limbs[joint])
        for known, used, group in groups:
            if known == word and limb not in used:
                used.add(limb)
                group.append(k)
                break
        else:
            groups.append((word, {limb}, [k]))
    return [group for _, _, group in groups]
