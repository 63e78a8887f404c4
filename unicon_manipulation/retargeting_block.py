"""Block `retarget`: a robot's hand does what a human's does, as a headset tells it.

commands:
  - webxr
  - {of: left_hand, retarget: {hand: webxr_left_hand}}
flow: {zip: [{policy: walk}, {of: left_hand, forward_command: {max_rate: 6.0}}]}
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Annotated, Any, Literal

import numpy as np

from unicon_base import TextSink, WorkflowError, alternatives
from unicon_base.arrays import Float32, Float64
from unicon_base.schema.marks import Within, positive
from unicon_core.blocks.postures import single
from unicon_core.blocks.safety.limits import rates_of
from unicon_core.bounds import MaxRate
from unicon_core.flow.block import Reads, Writes
from unicon_core.robots import Robot
from unicon_core.states import StateSpec
from unicon_core.states.standard import forwarded_states
from unicon_core.workflow.autowire import BuildContext
from unicon_manipulation.retarget.hand_model import ABSENT, JOINTS, HandModel, HumanHand, told_hand

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

    Each finger's vector is followed, from where it begins to its tip, times the ratio of both
    fingers' lengths, as in AnyTeleop (Qin et al., RSS 2023); and those from the thumb's tip to the
    others', as in DexPilot (Handa et al., ICRA 2020), which count the more the nearer these are:

        minimise  Σ |t_i - b_i - s_i v_i|² + Σ w_j |t_j - t_thumb - u_j|²   within the joint limits

    with tips t(q), where fingers begin b, the human's vectors v, scales s, pinches u, weights w. A
    thumb of three driven joints follows the human's last joint besides, with a small weight.

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
    """Solves one nonlinear least-squares problem within bounds again and again, by Gauss-Newton.

    Each step solves (JᵀJ + λ diag) dq = -Jᵀr of the free variables; those at a bound against which
    the gradient pushes them are held (Bertsekas, Projected Newton Methods, SIAM J. Control Optim.
    20(2), 1982). λ is Marquardt's damping where a step does not help.

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


SCALES = 0.2, 5.0
FASTEST = 1000.0
"""In [Hz]: what cuts off there cuts nothing."""
SETTLED = 2.0
"""In [s]: over which a human's lengths are averaged, and after which a hand that cannot be one is
told of again."""


class Retarget:
    """Command the joints at which the fingers point as those of a human hand, and pinch as they do.

    Nothing is commanded (NaN) while the hand is not tracked, or cannot be one, which is told.

    Args:
        context: of the robot's hand.
        hand: state of the human's 25 poses, shape (25, 7), as `webxr` writes them;
            `webxr_left_hand` or `webxr_right_hand` unless given, by the side.
        side: of the human's hand, left or right; the robot's unless given. One of the other side is
            mirrored.
        scale: length of the robot's fingers for one of the human's; measured of each finger unless
            given.
        contact: fingertips that should be so near to the thumb's close wholly, in [m] of the
            robot's hand. Of a human's pinch headsets tell 0.01 to 0.02.
        filter: where a low pass of first order cuts off, in [Hz]; None for none.
        max_rate: of a commanded position in [rad/s], or `robot` for the robot file's velocity
            limits; None for none.
        model: MJCF or URDF instead of the robot file's.

    Raises:
        WorkflowError: there is no such state, or nobody says the side.
        RobotError: the robot file says nothing of a hand.
        ModelError: there is no model of it.
        MissingDependencyError: mujoco is not installed.
    """

    memory = ("scale", "_retargeting", "_lengths", "_smooth", "_sent", "_follows", "_told")

    def __init__(
        self,
        joint_pos: Reads,
        joint_pos_command: Writes,
        *,
        context: BuildContext,
        hand: str = "",
        side: Literal["left", "right"] | None = None,
        scale: Annotated[float | None, Within(*SCALES)] = None,
        contact: Annotated[float, Within(0.0, 0.5 * NEAR, "m")] = 0.0,
        filter: Annotated[float | None, positive(FASTEST, "Hz")] = None,
        max_rate: MaxRate | None = None,
        model: str | None = None,
    ) -> None:
        single(joint_pos)
        robot, period = context.robot, context.period
        human = side or told_hand(robot).side
        if not human:
            raise WorkflowError(
                f"robot {robot.name} may be a left or a right hand; say which: side: left"
            )
        hands = HandModel(robot, human, model, context.relative_to)
        name = hand or f"webxr_{human}_hand"
        mirrored = told_hand(robot).side not in ("", human)
        self._human = HumanHand(_poses(context, name), hands.fingers, human, mirrored=mirrored)
        self._retargeting = Retargeting(hands, contact)
        self.reads, self.writes = (name,), (_error(human),)
        self.moves: tuple[str, ...] = ()
        if not hands.moved.all():
            self.moves = tuple(np.array(robot.joint_names)[hands.moved].tolist())
        self._joint_pos, self._command = joint_pos, joint_pos_command
        self._error = context.states[_error(human)]
        tell, who = context.tell, f"retarget of {robot.name}"
        self.tell: TextSink = lambda found: tell(f"{who}: {found}")
        rate = np.full(robot.num_joints, np.inf)
        if max_rate is not None:
            rate = rates_of(max_rate, robot, "retarget").astype(np.float64)
        self._moved, self._step = hands.moved, rate * period
        self._given, self.scale = scale, np.full(len(hands.fingers), scale or 1.0)
        self._lengths = np.ones(len(hands.fingers))
        cut = FASTEST if filter is None else filter
        self._share = 1.0 if cut >= FASTEST else 1.0 - math.exp(-2.0 * math.pi * cut * period)
        self._as_found = self._share == 1.0 and bool(np.isinf(self._step).all())
        self._slow = 1.0 - math.exp(-period / SETTLED)
        self._again = max(1, round(SETTLED / period))
        self._smooth, self._sent = (np.zeros(len(rate)) for _ in range(2))
        self._follows, self._told = False, 0

    @staticmethod
    def declares(*, robot: Robot, side: str | None = None, **_: Any) -> Mapping[str, StateSpec]:
        """Return the states of joint commands, and of how far the tips are off."""
        specs = forwarded_states(robot.joint_names)
        told = side or (robot.hand.side if robot.hand is not None else "")
        if robot.hand is not None and told:
            fingers = tuple(robot.hand.fingers)
            specs[_error(told)] = StateSpec(
                (len(fingers),),
                unit="m",
                names=fingers,
                description="of each tip from where the human's finger leads it; NaN: no hand",
                initial=math.nan,
            )
        return specs

    def __call__(self) -> None:
        human, retargeting = self._human, self._retargeting
        found = human.look()
        wrong = bool(found) and found != ABSENT
        if wrong and self._told == 0:
            self.tell(f"{found}; nothing is commanded until it can be a hand")
        self._told = self._again if wrong else max(self._told - 1, 0)
        if found:
            self.reset()
            self._command[...] = self._error[...] = np.nan
            return
        anew, self._follows = not self._follows, True
        self._lengths += (1.0 if anew else self._slow) * (human.lengths - self._lengths)
        if self._given is None:
            np.divide(retargeting.model.reach, self._lengths, out=self.scale)
        retargeting.solve(human, self.scale, anew=anew)
        sent = retargeting.q if self._as_found else self._followed(anew)
        np.copyto(self._command, sent, where=self._moved, casting="same_kind")
        self._error[...] = retargeting.errors

    def _followed(self, anew: bool) -> Float64:
        """Return what is sent: what was found behind the low pass, no faster than allowed."""
        retargeting, smooth, sent = self._retargeting, self._smooth, self._sent
        model, q = retargeting.model, retargeting.q
        if anew:
            smooth[...] = q
            measured = np.where(np.isfinite(self._joint_pos), self._joint_pos, smooth)
            np.clip(measured, model.lower, model.upper, out=sent)
        smooth += self._share * (q - smooth)
        np.clip(smooth, sent - self._step, sent + self._step, out=sent)
        return sent

    def reset(self) -> None:
        """Follow the next hand as one that has just come."""
        self._follows = False


def _poses(context: BuildContext, name: str) -> Float32:
    specs = context.states.layout.specs
    if name not in specs:
        hands = [each for each, spec in specs.items() if spec.shape == (JOINTS, 7)]
        raise WorkflowError(
            f"no state {name!r} of a human hand; {alternatives(name, hands)}; put a block that "
            "writes it, such as webxr, before, and name it: hand: STATE"
        )
    if specs[name].shape != (JOINTS, 7):
        raise WorkflowError(
            f"state {name!r} has shape {list(specs[name].shape)}; a human hand has [{JOINTS}, 7], "
            "position and quaternion wxyz of each joint"
        )
    return context.states[name]


def _error(side: str) -> str:
    return f"{side}_hand_retarget_error"
