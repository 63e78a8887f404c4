"""Arm: writes the target of one end effector, as one of the operator's hands moves it.

Its clutch must be seen open before it closes: whoever comes back with a closed hand moves nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, TypeAlias

import numpy as np

from unicon_base.errors import WorkflowError
from unicon_core.models.frames import Quat, Vector
from unicon_core.states import States
from unicon_core.states.standard import pose_of as pose_state
from unicon_core.states.standard import target_of
from unicon_manipulation.teleop.hand import Hand
from unicon_manipulation.teleop.operator import Headset, OperatorHand, pose_of

Mode: TypeAlias = Literal["hold", "toggle", "always"]


class Clutch:
    """The clutch of one hand.

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
        if clutch(self.theirs.closed) and not was and not self._engage(headset, ours):
            clutch.drop()
        if clutch.engaged:
            if was:
                hand.follow(self.theirs.position, self.theirs.quat, headset.dt)
        else:
            hand.hold()
        if hand.live:
            self._write(stamp)
        return clutch.engaged

    def _engage(self, headset: Headset, ours: tuple[Vector, Quat]) -> bool:
        yaw = headset.heading()
        if yaw is None:
            return False
        self.hand.engage(self.theirs.position, self.theirs.quat, yaw, ours)
        return True

    def _write(self, stamp: int) -> None:
        hand = self.hand
        self._target[:3], self._target[3:] = hand.position, hand.quat
        self._velocity[:3], self._velocity[3:] = hand.velocity, hand.spin
        self._stamp[...] = stamp
