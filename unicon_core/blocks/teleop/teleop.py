"""Block `teleop`: an operator's hands move the robot's, in the axes in which he looks ahead.

    estimate: [{frames: {of: [left_hand, right_hand]}}]
    commands:
      - webxr
      - teleop: {box: [[0.1, -0.6, -0.2], [0.6, 0.6, 0.5]]}     # m, in the base's frame
      - reach: {effectors: [left_hand, right_hand], moves: [arms]}

Nothing moves before the clutch is engaged, and nothing jumps when it is: the operator's hand and
the robot's are taken as equal at that moment. While it is open the target stays, so that the
operator can go back with his hand; what is not tracked has no target, and the arms go home.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from unicon_core.blocks.joint_command import ticks_of
from unicon_core.blocks.teleop.arm import Arm
from unicon_core.blocks.teleop.clutch import MODES, Clutch, Mode
from unicon_core.blocks.teleop.hand import Hand, Pace
from unicon_core.blocks.teleop.one_euro import OneEuro
from unicon_core.blocks.teleop.operator import FINGERS, SIDES, Headset, Side
from unicon_core.blocks.teleop.workspace import Workspace
from unicon_core.bounds import within
from unicon_core.errors import WorkflowError, alternatives
from unicon_core.states import StateSpec
from unicon_core.states.effectors import target_states
from unicon_core.workflow.autowire import BuildContext

SPEED, TURN = 5.0, 20.0
"""Largest `max_speed` in [m/s] and `max_turn` in [rad/s]: a hand that throws has 10 m/s."""
FARTHEST = 3.0
"""Of a workspace in [m]; no arm is longer."""
PINCHED = 0.06
"""How long fingers have to be together in [s]: headsets see a pinch now and then that is none."""
STEADY = 0.5
"""How long a hand has to be tracked before `always` engages, in [s]."""


def teleop(
    *,
    context: BuildContext,
    box: Sequence[Sequence[float]],
    left: str | None = "left_hand",
    right: str | None = "right_hand",
    device: str = "webxr",
    sphere: Sequence[float] | None = None,
    clutch: str | Mapping[str, str] = "hold",
    pinch: str = "ring",
    scale: float = 1.0,
    max_speed: float = 0.5,
    max_turn: float = 2.0,
    smooth: Sequence[float] | None = None,
    home: str | None = "a",
    stale: float = 0.2,
) -> Teleop:
    """Write targets of end effectors: `E_target`, `E_target_velocity` and `E_target_stamp_ns`.

    Args:
        box: [[x, y, z], [x, y, z]], least and largest of a target in the base's frame in [m].
        left: end effector that the operator's left hand moves; null for none.
        right: the same of the right hand.
        device: prefix of the headset's states.
        sphere: [x, y, z, radius] in [m], about the left shoulder; of the right one y is -y.
        clutch: `hold`, engaged while it is closed; `toggle`, each closing turns it over; `always`,
            engaged half a second after the hand came; or {controller: …, hand: …}. A controller's
            is its squeeze button, a bare hand's a pinch of the thumb.
        pinch: finger whose tip meets the thumb's: index, middle, ring or pinky.
        scale: way of the robot's hand for that of the operator's.
        max_speed: of a target in [m/s].
        max_turn: of a target in [rad/s].
        smooth: [Hz, Hz for 1 m/s], cut-off of the One-Euro filter and its slope; None for none.
        home: button of a controller that drops the target; the arm goes home.
        stale: a headset's frame that is older has no hands, in [s].

    Raises:
        WorkflowError: an option is not plausible, or a state is not there.
    """
    effectors = {side: name for side, name in zip(SIDES, (left, right)) if name is not None}
    if not effectors or left == right:
        raise WorkflowError(
            f"left is {left!r} and right is {right!r}; give the end effector of one of them, or "
            "of each its own"
        )
    if pinch not in FINGERS:
        raise WorkflowError(f"pinch is {pinch!r}; {alternatives(pinch, FINGERS)}")
    modes = _modes(clutch)
    pace = Pace(
        within(scale, "scale", "", 4.0),
        within(max_speed, "max_speed", "m/s", SPEED),
        within(max_turn, "max_turn", "rad/s", TURN),
    )
    period = context.period
    stale = within(stale, "stale", "s", 2.0)
    headset = Headset(context.states, device)
    arms = []
    for side, name in effectors.items():
        theirs = Side(headset, side, pinch, "squeeze", home, _filter(smooth))
        sure = {"controller": 1, "hand": ticks_of(PINCHED, period, "pinch") or 1}
        steady = ticks_of(STEADY, period, "steady") or 1
        clutches = {
            kind: Clutch(mode, steady if mode == "always" else sure[kind])
            for kind, mode in modes.items()
        }
        hand = Hand(_workspace(box, sphere, side), pace, period)
        arms.append(Arm(SIDES.index(side), theirs, clutches, hand, context.states, name))
    return Teleop(headset, arms, context, stale)


def _declares(
    *, left: str | None = "left_hand", right: str | None = "right_hand", **_: Any
) -> Mapping[str, StateSpec]:
    specs = {
        "teleop_engaged": StateSpec(
            (2,), "int32", names=SIDES, description="1 while the operator's hand moves the robot's"
        ),
        "teleop_latency": StateSpec(
            (), unit="s", description="from the headset's frame to this tick; 0 while none is heard"
        ),
    }
    for name in (left, right):
        if isinstance(name, str):
            specs |= target_states(name)
    return specs


setattr(teleop, "declares", _declares)  # noqa: B010  a function has none to mypy


def _modes(clutch: str | Mapping[str, str]) -> dict[str, Mode]:
    said = clutch if isinstance(clutch, Mapping) else {"controller": clutch, "hand": clutch}
    modes: dict[str, str] = {"controller": "hold", "hand": "hold", **said}
    for kind, mode in modes.items():
        if kind not in ("controller", "hand"):
            raise WorkflowError(f"clutch of {kind!r}; {alternatives(kind, ('controller', 'hand'))}")
        if mode not in MODES:
            raise WorkflowError(f"clutch is {mode!r}; {alternatives(str(mode), MODES)}")
    return cast(dict[str, Mode], modes)


def _filter(smooth: Sequence[float] | None) -> OneEuro | None:
    if smooth is None:
        return None
    if len(smooth) != 2:
        raise WorkflowError(f"smooth is {smooth!r}; give [Hz, Hz for 1 m/s], such as [2.0, 5.0]")
    cutoff = within(smooth[0], "smooth", "Hz", 100.0)
    return OneEuro(cutoff, within(smooth[1], "smooth", "Hz", 100.0, above=False))


def _workspace(
    box: Sequence[Sequence[float]], sphere: Sequence[float] | None, side: str
) -> Workspace:
    corners = [list(map(float, corner)) for corner in box]
    good = [len(corner) for corner in corners] == [3, 3] and all(
        -FARTHEST <= lower <= upper <= FARTHEST for lower, upper in zip(*corners)
    )
    if not good:
        raise WorkflowError(
            f"box is {box!r:.80}; give [[x, y, z], [x, y, z]], least and largest in [m], at most "
            f"{FARTHEST:g}"
        )
    (a, b, c), (d, e, f) = corners
    if sphere is None:
        return Workspace((a, b, c), (d, e, f))
    ball = list(map(float, sphere))
    if len(ball) != 4 or not all(abs(v) <= FARTHEST for v in ball) or not ball[3] > 0.0:
        raise WorkflowError(
            f"sphere is {sphere!r:.80}; give [x, y, z, radius] in [m], at most {FARTHEST:g}"
        )
    x, y, z, radius = ball
    return Workspace((a, b, c), (d, e, f), (x, y if side == "left" else -y, z), radius)


class Teleop:
    """The tick of `teleop`.

    Args:
        headset: of the operator.
        arms: that he moves.
        context: of the workflow.
        stale: a headset's frame that is older has no hands, in [s].
    """

    memory = ("_headset", "_arms")

    endless = True

    def __init__(
        self, headset: Headset, arms: Sequence[Arm], context: BuildContext, stale: float
    ) -> None:
        self._headset, self._arms, self._stale = headset, tuple(arms), stale
        states = context.states
        self._engaged: NDArray[np.int32] = states["teleop_engaged"]
        self._latency: NDArray[np.float32] = states["teleop_latency"]
        self._now: NDArray[np.int64] = states["stamp_ns"]
        given = [state for arm in arms for state in arm.reads]
        self.reads = (*headset.reads, *given, "stamp_ns")
        written = [state for arm in arms for state in arm.writes]
        self.writes = ("teleop_engaged", "teleop_latency", *written)

    def __call__(self) -> None:
        headset = self._headset
        if not headset.look(self._stale):
            self._engaged[...] = 0
            self._latency[...] = 0.0
            for arm in self._arms:
                arm.lose()
            return
        self._latency[...] = headset.age
        # 0 would mean now.
        stamp = max(1, int(self._now) - round(1e9 * headset.age))
        for arm in self._arms:
            self._engaged[arm.element] = arm.follow(headset, stamp)

    def reset(self) -> None:
        """Let go of everything; who is engaged has to engage anew."""
        for arm in self._arms:
            arm.reset()
