"""Hand: where one of the robot's hands is to be, as one of the operator's moves.

At the moment at which the clutch is engaged the two are taken as equal; from then on the robot's
moves as the operator's does, in the axes in which he looks ahead: his forward is the robot's.

Its workspace is a box in the base's frame, and a ball about the shoulder. A target that is outside
already, since the robot's hand was there when the clutch was engaged, is not pulled in; it comes no
farther out.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from unicon_base import WorkflowError
from unicon_core.models.frames import (
    Quat,
    Vector,
    conjugate,
    multiply,
    plus,
    rotate,
    towards,
    turned,
    vector_of,
)
from unicon_core.states import States
from unicon_core.states.standard import pose_of as pose_state
from unicon_core.states.standard import target_of
from unicon_manipulation.teleop.operator import Headset, OperatorHand, pose_of

ROUNDS = 3
"""Of going to box and ball in turns; what is left is cut off on the way from the last target."""


@dataclass(frozen=True)
class Workspace:
    """Where the targets of one hand may be.

    Attributes:
        lower: smallest x, y, z in the base's frame in [m].
        upper: largest.
        centre: of the ball in [m].
        radius: in [m]; infinite for no ball.
    """

    lower: Vector
    upper: Vector
    centre: Vector = (0.0, 0.0, 0.0)
    radius: float = math.inf

    def inside(self, wanted: Vector, last: Vector) -> Vector:
        """Return the allowed position in [m] that is near a wanted one.

        Args:
            wanted: in the base's frame in [m].
            last: the target of the tick before, from where it is reached in a straight line.
        """
        lower = tuple(map(min, self.lower, last))
        upper = tuple(map(max, self.upper, last))
        radius = max(self.radius, math.dist(last, self.centre))
        x, y, z = wanted
        for left in range(ROUNDS, -1, -1):
            x, y, z = (max(a, min(v, b)) for a, v, b in zip(lower, (x, y, z), upper))
            far = math.dist((x, y, z), self.centre)
            if far <= radius:
                return x, y, z
            if left:
                x, y, z = (c + (v - c) * radius / far for c, v in zip(self.centre, (x, y, z)))
        return self._cut((x, y, z), last, radius)

    def _cut(self, wanted: Vector, last: Vector, radius: float) -> Vector:
        """Return the last point in the ball on the way from one in it to one that is not."""
        way = tuple(w - v for w, v in zip(wanted, last))
        out = tuple(v - c for v, c in zip(last, self.centre))
        a = sum(w * w for w in way)
        b = sum(w * o for w, o in zip(way, out))
        c = sum(o * o for o in out) - radius * radius
        share = max(0.0, min(1.0, (-b + math.sqrt(max(b * b - a * c, 0.0))) / a)) if a else 0.0
        x, y, z = (v + share * w for v, w in zip(last, way))
        return x, y, z


SMOOTHED = 0.03
"""Time constant of a target's velocity in [s]: two frames of a headset."""

_UP: Vector = (0.0, 0.0, 1.0)
_STILL: Vector = (0.0, 0.0, 0.0)


class Hand:
    """The target of one end effector.

    Args:
        workspace: where it may be.
        scale: way of the robot's hand for that of the operator's.
        speed: of a target at most, in [m/s].
        turn: of a target at most, in [rad/s].
        period: of a tick in [s].

    Attributes:
        live: there is a target.
        position: of the target in the base's frame in [m].
        quat: of the target to the base's frame, unit quaternion wxyz.
        velocity: of the target in [m/s], base's frame.
        spin: angular velocity of the target in [rad/s], base's frame.
    """

    memory = ("live", "position", "quat", "velocity", "spin", "_theirs", "_ours", "_seen", "_level")

    def __init__(
        self, workspace: Workspace, scale: float, speed: float, turn: float, period: float
    ) -> None:
        self._workspace, self._scale, self._most = workspace, scale, (speed, turn)
        self._way, self._turn = speed * period, turn * period
        self.live = False
        self.position = self.velocity = self.spin = _STILL
        self.quat: Quat = (1.0, 0.0, 0.0, 0.0)
        self._theirs = self._ours = self._seen = self.position, self.quat
        self._level = self.quat

    def engage(self, position: Vector, quat: Quat, yaw: float, ours: tuple[Vector, Quat]) -> None:
        """Take the operator's hand and the robot's as equal.

        Args:
            position: of the operator's hand in the headset's floor in [m].
            quat: of it, unit quaternion wxyz.
            yaw: where the operator looks to, in [rad].
            ours: position [m] and quaternion wxyz of the robot's hand in the base's frame; of no
                matter while a target is held, from which it then goes on.
        """
        if not self.live:
            self.position, self.quat = ours
            self.live = True
        self._theirs, self._level = (position, quat), turned(_UP, -yaw)
        self._ours = self._seen = self.position, self.quat
        self.velocity = self.spin = _STILL

    def follow(self, position: Vector, quat: Quat, dt: float) -> None:
        """Move the target on, as the operator's hand is now.

        Args:
            position: of the operator's hand in the headset's floor in [m].
            quat: of it, unit quaternion wxyz.
            dt: since the headset's frame before in [s], 0 for the same frame.
        """
        (start, begin), (ours, facing) = self._theirs, self._ours
        scale = self._scale
        way = [scale * (b - a) for a, b in zip(start, position)]
        change = multiply(self._level, multiply(quat, conjugate(begin)))
        change = multiply(change, conjugate(self._level))
        self._go(plus(ours, rotate(self._level, way)), multiply(change, facing))
        if dt > 0.0:
            self._estimate(dt)

    def _go(self, wanted: Vector, facing: Quat) -> None:
        last = self.position
        x, y, z = self._workspace.inside(wanted, last)
        far = math.dist((x, y, z), last)
        if far > self._way:
            share = self._way / far
            x, y, z = (a + share * (b - a) for a, b in zip(last, (x, y, z)))
        self.position = x, y, z
        angle = math.hypot(*vector_of(multiply(facing, conjugate(self.quat))))
        share = 1.0 if angle <= self._turn else self._turn / angle
        self.quat = towards(self.quat, facing, share)

    def _estimate(self, dt: float) -> None:
        """Estimate the velocity of what was seen in two frames of the headset."""
        position, quat = self._seen
        self._seen = self.position, self.quat
        new = dt / (dt + SMOOTHED)
        vx, vy, vz = (
            v + new * ((b - a) / dt - v) for v, a, b in zip(self.velocity, position, self.position)
        )
        wx, wy, wz = (
            w + new * (r / dt - w)
            for w, r in zip(self.spin, vector_of(multiply(self.quat, conjugate(quat))))
        )
        speed, turn = self._most
        self.velocity, self.spin = _within((vx, vy, vz), speed), _within((wx, wy, wz), turn)

    def hold(self) -> None:
        """Keep the target where it is: the clutch is open."""
        self.velocity = self.spin = _STILL

    def drop(self) -> None:
        """Have no target any more."""
        self.live = False
        self.hold()


def _within(vector: Vector, most: float) -> Vector:
    length = math.hypot(*vector)
    if length <= most:
        return vector
    x, y, z = (most / length * v for v in vector)
    return x, y, z


Mode: TypeAlias = Literal["hold", "toggle", "always"]


class Clutch:
    """The clutch of one hand.

    It must be seen open before it closes: an operator who comes back with a closed hand moves
    nothing.

    Args:
        mode: `hold`, engaged while it is closed; `toggle`, each closing turns it over; `always`,
            engaged while the hand is tracked.
        sure: ticks for which it has to be closed; for `always`, ticks for which the hand has to be
            tracked.

    Attributes:
        engaged: it is, just now.
    """

    memory = ("engaged", "_open", "_ticks")

    def __init__(self, mode: Mode, sure: int) -> None:
        self._mode, self._sure = mode, max(1, sure)
        self.engaged = False
        self._open = mode == "always"
        self._ticks = 0

    def __call__(self, closed: bool) -> bool:
        """Take what the operator does in this tick; return whether it is engaged.

        Args:
            closed: button or fingers are; of no matter for `always`.
        """
        if self._mode == "always":
            closed = True
        if not closed:
            self._ticks, self._open = 0, True
            if self._mode == "hold":
                self.engaged = False
            return self.engaged
        self._ticks += 1
        if self._open and self._ticks >= self._sure:
            self._open = False
            self.engaged = not self.engaged if self._mode == "toggle" else True
        return self.engaged

    def drop(self) -> None:
        """Let go, until it is closed anew: the hand is not tracked, or another thing is."""
        self.engaged, self._ticks, self._open = False, 0, self._mode == "always"


class Arm:
    """One hand of the operator and the end effector that it moves.

    Args:
        element: of `teleop_engaged`.
        theirs: the operator's hand.
        clutches: kind of what is tracked, `controller` or `hand`, to its clutch.
        hand: computes the target.
        states: of the workflow.
        name: of the end effector.

    Raises:
        WorkflowError: nobody says where the end effector is.
    """

    memory = ("theirs", "hand", "_clutches", "_kind")

    def __init__(
        self,
        element: int,
        theirs: OperatorHand,
        clutches: Mapping[str, Clutch],
        hand: Hand,
        states: States,
        name: str,
    ) -> None:
        self.element, self.theirs, self.hand, self.name = element, theirs, hand, name
        self._clutches = clutches
        pose = pose_state(name)
        if pose not in states.layout.specs:
            raise WorkflowError(
                f"no state {pose!r}, where the robot's hand is; write estimate: [{{frames: "
                f"{{of: [{name}]}}}}]"
            )
        self.reads = (pose,)
        self.writes = target_of(name)
        self._ours = states[pose]
        self._target, self._velocity, self._stamp = (states[state] for state in self.writes)
        self._kind = ""

    def lose(self) -> None:
        """Have no target: nobody sees the operator's hand."""
        self.theirs.forget()
        self._drop("")

    def _drop(self, kind: str) -> None:
        for clutch in self._clutches.values():
            clutch.drop()
        self._kind = kind
        if self.hand.live:
            self.hand.drop()
        self._target[...] = np.nan
        self._velocity[...] = 0.0
        self._stamp[...] = 0

    def follow(self, headset: Headset, stamp: int) -> bool:
        """Write the target; return whether the clutch is engaged.

        Args:
            headset: which is heard.
            stamp: when its frame was, in [ns] of `stamp_ns`.
        """
        kind, hand, ours = self.theirs.look(), self.hand, pose_of(self._ours)
        if not kind or self.theirs.home or ours is None:  # a robot that is silent has no hand
            self._drop(kind)
            return False
        if kind != self._kind:  # a controller that is laid down, or taken up
            self._clutches[kind].drop()
            self._kind = kind
        clutch = self._clutches[kind]
        was = clutch.engaged
        if clutch(self.theirs.closed) and not was:
            yaw = headset.heading()
            if yaw is None:
                clutch.drop()
            else:
                hand.engage(self.theirs.position, self.theirs.quat, yaw, ours)
        if clutch.engaged:
            if was:
                hand.follow(self.theirs.position, self.theirs.quat, headset.dt)
        else:
            hand.hold()
        if hand.live:
            self._target[:3], self._target[3:] = hand.position, hand.quat
            self._velocity[:3], self._velocity[3:] = hand.velocity, hand.spin
            self._stamp[...] = stamp
        return clutch.engaged
