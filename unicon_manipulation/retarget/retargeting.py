"""Retargeting of one hand: joints at which a robot's fingers point as a human's do, and pinch too.

Two kinds of vectors are followed, as in AnyTeleop (Qin et al., RSS 2023) and DexPilot (Handa et
al., ICRA 2020). Each finger's, from where it begins to its tip, times the ratio of both fingers'
lengths: a stretched finger is stretched, whoever's it is. And those from the thumb's tip to the
others', which count the more the nearer these are: what touches on the human touches on the robot,
though its palm is another one.

    minimise  Σ |t_i - b_i - s_i v_i|² + Σ w_j |t_j - t_thumb - u_j|²   within the joint limits

with tips t(q), where fingers begin b, the human's vectors v, scales s, pinches u, weights w. A
thumb of three driven joints follows the human's last joint besides, with a small weight.

That is a problem of nonlinear least squares of a few variables within bounds, warm started, which
Gauss-Newton solves. Each step solves the normal equations (JᵀJ + λ diag) dq = -Jᵀr of the variables
that are free, those at a bound against which the gradient pushes them being held (Bertsekas,
Projected Newton Methods, SIAM J. Control Optim. 20(2), 1982), with Marquardt's damping λ where a
step does not help.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from unicon_base.arrays import Float64
from unicon_manipulation.retarget.hand_model import HandModel, HumanHand

PINCH = 400.0
"""Weight of a pinch that touches, against 1 of a finger's own vector: where both differ by 20 mm,
as with palms of other proportions, tips stay 0.1 mm apart."""
NEAR = 0.05
"""In [m], of the robot's: tips that are farther apart do not pinch."""
KNEE = 0.01
"""Weight of the thumb's last joint: where bones have other proportions, 10 mm of it move the tip by
0.1 mm."""
OPEN = 3.0
"""Times the distance at which tips touch, from where on distances are as they are."""
STARTS = (0.0, 0.35, 0.7)
"""Shares of the way from the default pose to the far limits, from where a hand that has just come
is looked for: one that is far away may lie behind a worse minimum."""


class Retargeting:
    """Finds the joints of a robot's hand for a human one, from where it found them last.

    Args:
        model: of the robot's hand.
        contact: tips that are to be so near to each other close wholly, in [m] of the robot's.

    Attributes:
        q: the robot's joints as the last `solve` found them in [rad], shape (n,).
        errors: how far each tip is from where its finger's vector leads, in [m], shape (f,).
    """

    memory = ("q", "_before")

    def __init__(self, model: HandModel, contact: float) -> None:
        self.model, self._contact = model, contact
        self.q, self.errors = model.default.copy(), np.zeros(len(model.fingers))
        count, points = len(model.fingers), len(model.points)
        self._thumb = model.fingers.index("thumb") if "thumb" in model.fingers else -1
        others = [i for i in range(count) if i != self._thumb] if self._thumb >= 0 else []
        self._others, self._own = np.array(others, np.intp), points + np.arange(len(others))
        # Rows: each point's own vector, then the pinches. Columns: the points.
        self._before, self._ahead = self.q.copy(), np.zeros(len(self.q))
        self._rows = np.vstack((np.eye(points), np.zeros((len(others), points))))
        self._rows[count:points] *= KNEE**0.5
        self._wanted, self._used = np.zeros((len(self._rows), 3)), len(self._rows)
        self._jacobian = model.jacobian.reshape(points, -1)
        self._solver = Bounded(self._residual, model.lower, model.upper)
        upwards = model.upper - model.default >= model.default - model.lower
        way = np.where(upwards, model.upper, model.lower) - model.default
        self._starts = [model.default + share * way for share in STARTS]

    def solve(self, human: HumanHand, scale: Float64, *, anew: bool) -> None:
        """Find `q` and `errors`.

        Args:
            human: as it looked last, with the fingers of the robot.
            scale: the robot's length for one of the human's, of each finger, shape (f,).
            anew: the hand has just come: look from several places, not from where it was last.
        """
        model, count, points = self.model, len(scale), len(self.model.points)
        wanted = self._wanted[:count]
        np.matmul(human.vectors * scale[:, None], model.palm.T, out=wanted)
        wanted += model.begins
        if model.knee:
            knee = model.palm @ human.knee * scale[self._thumb] + model.begins[self._thumb]
            self._wanted[count] = KNEE**0.5 * knee
        pinches = len(self._others) > 0 and self._pinch(human.tips, scale)
        self._used = len(self._rows) if pinches else points
        if anew:
            found = []
            for start in self._starts:
                q = start.copy()
                found.append((self._solver.solve(q), q))
            self.q[...] = self._before[...] = min(found, key=lambda each: each[0])[1]
        # It begins where the joints are if they go on as they did: that saves a step in three.
        self._ahead[...] = self.q
        self._ahead -= self._before
        self._before[...] = self.q
        self.q += self._ahead
        self._solver.solve(self.q)
        off = wanted - model.tips
        np.sqrt(np.einsum("fx,fx->f", off, off), out=self.errors)

    def _pinch(self, tips: Float64, scale: Float64) -> bool:
        """Write the rows of the pinches, and what is wanted of them; return whether any counts."""
        thumb, others, contact, points = self._thumb, self._others, self._contact, self._own[0]
        apart = tips[others] - tips[thumb]
        apart *= 0.5 * (scale[others] + scale[thumb])[:, None]
        distance = np.sqrt(np.einsum("fx,fx->f", apart, apart))
        if distance.min() >= NEAR:
            return False
        weight = PINCH**0.5 * np.maximum((NEAR - distance) / (NEAR - contact), 0.0) ** 2
        np.minimum(weight, PINCH**0.5, out=weight)
        self._rows[self._own, others] = weight
        self._rows[points:, thumb] = -weight
        if contact > 0.0:
            # 0 up to the contact, as it is from OPEN times that on, and on a line between.
            short = (distance - contact) * (OPEN / (OPEN - 1.0)) / np.maximum(distance, contact)
            weight *= np.minimum(np.maximum(short, 0.0), 1.0)
        np.matmul(apart * weight[:, None], self.model.palm.T, out=self._wanted[points:])
        return True

    def _residual(self, q: Float64) -> tuple[Float64, Float64]:
        model = self.model
        model.put(q)
        rows, used = self._rows, self._used
        if used == len(model.tips):  # what is wanted of them is not weighed
            return (model.tips - self._wanted[:used]).ravel(), model.jacobian
        residual = rows[:used] @ model.points
        residual -= self._wanted[:used]
        return residual.ravel(), (rows[:used] @ self._jacobian).reshape(-1, len(q))


Residual = Callable[[Float64], tuple[Float64, Float64]]

MOST = 20
"""Looks at a place. A hand that is followed takes 1 to 3, one from far away 6 to 12; where so many
do not do, the next call goes on."""
SMALL = 2e-3
"""A step in [rad] that is taken without a look at where it leads: the error behind it is about its
square where the goal can be reached, and the next call goes on from there. A step that damping has
made small is none of these."""
LEAST, FIRST = 1e-9, 0.01
"""Of the damping: below it there is none, and where the first step does not help."""
FLOOR = 1e-9
"""Of the diagonal in [m²]: a joint that moves nothing has 0; one of a finger 1e-4 to 1e-2."""
INSIDE = 0.02
"""Share of its range by which a joint is started inside its bounds. A finger may be straight at
one: what it misses then lies along it, no gradient bends it, and it would stay so for ever."""


class Bounded:
    """Solves one problem again and again.

    Args:
        residual: returns r(q), shape (m,), and its Jacobian, shape (m, n).
        lower: smallest allowed value, shape (n,).
        upper: largest.

    Attributes:
        looks: that the last `solve` took.
    """

    def __init__(self, residual: Residual, lower: Float64, upper: Float64) -> None:
        self._residual, self._lower, self._upper = residual, lower, upper
        inside = INSIDE * (upper - lower)
        self._from, self._to = lower + inside, upper - inside
        count = len(lower)
        self._normal, self._gradient = np.zeros((count, count)), np.zeros(count)
        self._system = np.zeros((count, count))
        self._diagonal = self._system.reshape(-1)[:: count + 1]
        self.looks = 0

    def solve(self, q: Float64) -> float:
        """Improve `q` in place, from within its bounds; return |r(q)|², or nearly so."""
        lower, upper = self._lower, self._upper
        system, diagonal = self._system, self._diagonal
        np.maximum(q, self._from, out=q)
        np.minimum(q, self._to, out=q)
        cost, damping, moved = self._linearise(q), LEAST, True
        for self.looks in range(1, MOST):
            if moved:
                wanted = self._gradient.copy()
                system[...] = self._normal
                if self.looks > 1:  # the first is inside
                    held = ((q <= lower) & (wanted > 0.0)) | ((q >= upper) & (wanted < 0.0))
                    if held.any():
                        wanted[held] = system[held] = system[:, held] = 0.0
                diagonal += FLOOR
            if damping > LEAST:
                diagonal *= 1.0 + damping
            trial = q - np.linalg.solve(system, wanted)
            np.maximum(trial, lower, out=trial)
            np.minimum(trial, upper, out=trial)
            moves = trial - q
            step = max(float(moves.max()), -float(moves.min()))
            if step < (SMALL if moved else SMALL**2):
                q[...] = trial
                break
            found = self._linearise(trial)
            moved = found <= cost
            if moved:
                q[...], cost = trial, found
                damping = max(damping * 0.1, LEAST)
            else:
                damping = max(damping * 10.0, FIRST)
        return cost

    def _linearise(self, q: Float64) -> float:
        """Take residual and Jacobian at `q` into the normal equations; return |r|²."""
        residual, jacobian = self._residual(q)
        np.matmul(jacobian.T, jacobian, out=self._normal)
        np.matmul(jacobian.T, residual, out=self._gradient)
        return float(residual @ residual)
