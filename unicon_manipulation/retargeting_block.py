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

from unicon_base.arrays import Float32, Float64
from unicon_base.errors import WorkflowError, alternatives
from unicon_base.schema.marks import Within, positive
from unicon_core.blocks.joint_command import single
from unicon_core.blocks.safety.limits import rates_of
from unicon_core.bounds import MaxRate
from unicon_core.flow.block import Reads, Writes
from unicon_core.robots import Robot
from unicon_core.states import StateSpec
from unicon_core.states.standard import forwarded_states
from unicon_core.workflow.autowire import BuildContext
from unicon_manipulation.retarget.hand_model import ABSENT, JOINTS, HandModel, HumanHand, told_hand
from unicon_manipulation.retarget.retargeting import NEAR, Retargeting

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
        self.tell: Callable[[str], None] = lambda found: tell(f"{who}: {found}")
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
        model, q, smooth, sent = (
            self._retargeting.model,
            self._retargeting.q,
            self._smooth,
            self._sent,
        )
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
