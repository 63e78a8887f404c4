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

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from unicon_base import WorkflowError
from unicon_base.arrays import Float32, Int32, Int64
from unicon_base.schema.marks import Within, Write, positive
from unicon_core.blocks.postures import ticks_of
from unicon_core.models.frames import Vector
from unicon_core.states import StateSpec
from unicon_core.states.standard import target_states
from unicon_core.workflow.autowire import BuildContext
from unicon_manipulation.teleop.hand import Arm, Clutch, Hand, Mode, Workspace
from unicon_manipulation.teleop.operator import SIDES, Finger, Headset, OneEuro, OperatorHand

SPEED, TURN = 5.0, 20.0
"""Largest `max_speed` in [m/s] and `max_turn` in [rad/s]: a hand that throws has 10 m/s."""
FARTHEST = 3.0
"""Of a workspace in [m]; no arm is longer."""
Coordinate = Annotated[float, Within(-FARTHEST, FARTHEST, "m")]
Radius = Annotated[float, positive(FARTHEST, "m")]
Corner = tuple[Coordinate, Coordinate, Coordinate]
Cutoff = Annotated[float, positive(100.0, "Hz")]
Slope = Annotated[float, Within(0.0, 100.0, "Hz")]
PINCHED = 0.06
"""How long fingers have to be together in [s]: headsets see a pinch now and then that is none."""
STEADY = 0.5
"""How long a hand has to be tracked before `always` engages, in [s]."""


class Teleop:
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
        WorkflowError: the options contradict each other, or a state is not there.
    """

    memory = ("_headset", "_arms")

    endless = True

    def __init__(
        self,
        *,
        context: BuildContext,
        box: Annotated[tuple[Corner, Corner], Write("[[x, y, z], [x, y, z]], least and largest")],
        left: str | None = "left_hand",
        right: str | None = "right_hand",
        device: str = "webxr",
        sphere: Annotated[
            tuple[Coordinate, Coordinate, Coordinate, Radius], Write("[x, y, z, radius]")
        ]
        | None = None,
        clutch: Mode | Mapping[Literal["controller", "hand"], Mode] = "hold",
        pinch: Finger = "ring",
        scale: Annotated[float, positive(4.0)] = 1.0,
        max_speed: Annotated[float, positive(SPEED, "m/s")] = 0.5,
        max_turn: Annotated[float, positive(TURN, "rad/s")] = 2.0,
        smooth: Annotated[tuple[Cutoff, Slope], Write("[Hz, Hz for 1 m/s], such as [2.0, 5.0]")]
        | None = None,
        home: str | None = "a",
        stale: Annotated[float, positive(2.0, "s")] = 0.2,
    ) -> None:
        effectors = {side: name for side, name in zip(SIDES, (left, right)) if name is not None}
        if not effectors or left == right:
            raise WorkflowError(
                f"left is {left!r} and right is {right!r}; give the end effector of one of them, "
                "or of each its own"
            )
        modes: dict[str, Mode] = {"controller": "hold", "hand": "hold"}
        said = clutch if isinstance(clutch, Mapping) else dict.fromkeys(modes, clutch)
        modes |= {str(kind): mode for kind, mode in said.items()}
        period = context.period
        sure = {"controller": 1, "hand": ticks_of(PINCHED, period)}
        headset, arms = Headset(context.states, device), []
        for side, name in effectors.items():
            smoother = None if smooth is None else OneEuro(*smooth)
            theirs = OperatorHand(headset, side, pinch, "squeeze", home, smoother)
            clutches = {
                kind: Clutch(mode, ticks_of(STEADY, period) if mode == "always" else sure[kind])
                for kind, mode in modes.items()
            }
            hand = Hand(_workspace(box, sphere, side), scale, max_speed, max_turn, period)
            arms.append(Arm(SIDES.index(side), theirs, clutches, hand, context.states, name))
        self._headset, self._arms, self._stale = headset, tuple(arms), stale
        states = context.states
        self._engaged: Int32 = states["teleop_engaged"]
        self._latency: Float32 = states["teleop_latency"]
        self._now: Int64 = states["stamp_ns"]
        given = [state for arm in arms for state in arm.reads]
        self.reads = (*headset.reads, *given, "stamp_ns")
        written = [state for arm in arms for state in arm.writes]
        self.writes = ("teleop_engaged", "teleop_latency", *written)

    @staticmethod
    def declares(
        *, left: str | None = "left_hand", right: str | None = "right_hand", **_: Any
    ) -> Mapping[str, StateSpec]:
        """Return the states that tell how it fares, and the targets."""
        specs = {
            "teleop_engaged": StateSpec(
                (2,),
                "int32",
                names=SIDES,
                description="1 while the operator's hand moves the robot's",
            ),
            "teleop_latency": StateSpec(
                (),
                unit="s",
                description="from the headset's frame to this tick; 0 while none is heard",
            ),
        }
        for name in (left, right):
            if name is not None:
                specs |= target_states(name)
        return specs

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
            arm.lose()


def _workspace(
    box: tuple[Vector, Vector], sphere: tuple[float, float, float, float] | None, side: str
) -> Workspace:
    if any(lower > upper for lower, upper in zip(*box)):
        raise WorkflowError(
            f"box is {list(map(list, box))}; give [[x, y, z], [x, y, z]], least and largest in [m]"
        )
    if sphere is None:
        return Workspace(*box)
    x, y, z, radius = sphere
    return Workspace(*box, (x, y if side == "left" else -y, z), radius)
