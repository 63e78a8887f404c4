"""The operator as a headset's states tell him: head, hands or controllers, and what they press.

Parts, buttons and joints are found by the names that the states give their elements; joints of a
hand stand in the order of XRHandJoint (W3C, WebXR Hand Input Module, section 3.2).
"""

from __future__ import annotations

import math
from typing import Literal

from unicon_core.arrays import Array
from unicon_core.blocks.teleop.one_euro import OneEuro
from unicon_core.errors import WorkflowError, alternatives
from unicon_core.models.plain_turns import Quat, Vector
from unicon_core.states import States

SIDES = ("left", "right")
WRIST, THUMB = 0, 4
"""Joints of a hand; the latter is the thumb's tip."""
Finger = Literal["index", "middle", "ring", "pinky"]
FINGERS: dict[Finger, int] = {"index": 9, "middle": 14, "ring": 19, "pinky": 24}
"""Finger to the joint that is its tip."""

CLOSED, OPEN = 0.02, 0.035
"""Distance of two fingertips' joints in [m] that is a pinch, and that is none any more: they lie
inside the fingers, 6 to 8 mm below the skin."""
PRESSED, RELEASED = 0.6, 0.4
"""How far a button is pressed, 0 to 1."""

FAR = 10.0
"""No hand is farther from where the session began, in [m]."""


def pose_of(view: Array) -> tuple[Vector, Quat] | None:
    """Return position [m] and unit quaternion wxyz of a pose, None where it cannot be one."""
    x, y, z, w, i, j, k = view.tolist()
    length = math.sqrt(w * w + i * i + j * j + k * k)
    if not (0.9 < length < 1.1 and abs(x) < FAR and abs(y) < FAR and abs(z) < FAR):
        return None  # so is NaN
    return (x, y, z), (w / length, i / length, j / length, k / length)


def heading(quat: Quat) -> float:
    """Return where a head looks to about the vertical, in [rad]; x is forward, z is up.

    Its own up stands in where it looks up or down, so that bowing is not a turn.

    Args:
        quat: unit quaternion wxyz, head to world.
    """
    w, x, y, z = quat
    up = 2.0 * (x * z - w * y)  # of the forward axis
    forward = 1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z)
    crown = 2.0 * (x * z + w * y), 2.0 * (y * z - w * x)
    return math.atan2(forward[1] - up * crown[1], forward[0] - up * crown[0])


class Headset:
    """What both hands share: whether it is heard, when its poses were true, and the head.

    Args:
        states: of the workflow.
        name: of the device, which stands before its states.

    Attributes:
        reads: its states.
        valid: 1 for each part that is tracked.
        fresh: new poses came in this tick.
        dt: between them and those before, in [s]; 0 where there were none.
        age: of the poses in [s]: from the headset's frame to this tick.

    Raises:
        WorkflowError: there is no such device.
    """

    memory = ("fresh", "dt", "age", "_last")

    def __init__(self, states: States, name: str) -> None:
        self.name, self.reads = name, list[str]()
        self._states = states
        self._alive, self._stamp = self.view("alive"), self.view("stamp_ns")
        self._age, self._head = self.view("age"), self.view("head")
        self.valid = self.view("valid")
        self._head_part = self.part("head")
        self._last = 0
        self.fresh, self.dt, self.age = False, 0.0, 0.0

    def view(self, what: str) -> Array:
        """Return a state of the device, which is then one of `reads`."""
        state = f"{self.name}_{what}"
        if state not in self._states.layout.specs:
            raise WorkflowError(
                f"no state {state!r}; list the device that writes it, such as webxr, "
                "before teleop (commands:), or name yours: device: PREFIX"
            )
        self.reads.append(state)
        return self._states[state]

    def part(self, name: str) -> int:
        """Return which element of `valid` is a part."""
        return self.named("valid", name)

    def named(self, what: str, element: str) -> int:
        """Return which element of a state has a name."""
        names = self._states.spec(f"{self.name}_{what}").names
        if element not in names:
            raise WorkflowError(f"no {element!r}; {alternatives(element, names)}")
        return names.index(element)

    def look(self, stale: float) -> bool:
        """See what has come; return whether the headset is heard.

        Args:
            stale: poses that are older do not count, in [s].
        """
        self.age = float(self._age)
        if not self._alive or not 0.0 <= self.age <= stale:
            self.fresh, self.dt, self._last = False, 0.0, 0
            return False
        stamp = int(self._stamp)
        self.fresh = stamp > self._last
        self.dt = 1e-9 * (stamp - self._last) if self.fresh and self._last else 0.0
        self._last = stamp
        return True

    def heading(self) -> float | None:
        """Return the head's, None where it is not tracked."""
        if not self.valid[self._head_part]:
            return None
        pose = pose_of(self._head)
        return None if pose is None else heading(pose[1])


class Side:
    """One of the operator's hands: the controller in it where that is tracked, else the bare hand.

    Args:
        headset: of the operator.
        side: `left` or `right`.
        finger: whose tip closes the clutch at the thumb's.
        squeeze: button of the controller that closes the clutch.
        home: button of the controller that sends the arm home, or None.
        smooth: filter of the poses, or None.

    Attributes:
        kind: `controller`, `hand`, or "" where nothing is tracked.
        position: in the headset's floor in [m].
        quat: its own to the headset's floor, unit quaternion wxyz.
        closed: button or fingers are.
        home: the button is pressed.
    """

    memory = ("kind", "closed", "home", "position", "quat", "_smooth")

    def __init__(
        self,
        headset: Headset,
        side: str,
        finger: Finger,
        squeeze: str,
        home: str | None,
        smooth: OneEuro | None,
    ) -> None:
        self._headset, self._smooth = headset, smooth
        self._hand, self._controller = (
            headset.view(f"{side}_hand"),
            headset.view(f"{side}_controller"),
        )
        self._buttons = headset.view(f"{side}_buttons")
        self._parts = headset.part(f"{side}_hand"), headset.part(f"{side}_controller")
        self._tip = FINGERS[finger]
        self._squeeze = headset.named(f"{side}_buttons", squeeze)
        self._home = -1 if home is None else headset.named(f"{side}_buttons", home)
        self.kind, self.closed, self.home = "", False, False
        self.position: Vector = (0.0, 0.0, 0.0)
        self.quat: Quat = (1.0, 0.0, 0.0, 0.0)

    def look(self) -> str:
        """Take the newest pose; return `kind`."""
        hand, controller = (bool(self._headset.valid[part]) for part in self._parts)
        kind = "controller" if controller else "hand" if hand else ""
        pose = None
        if kind:
            pose = pose_of(self._controller if controller else self._hand[WRIST])
        if pose is None or kind != self.kind:
            self.forget()
        if pose is None:
            return ""
        self.home = bool(controller and self._home >= 0 and self._buttons[self._home] > PRESSED)
        if self.kind and not self._headset.fresh:
            return self.kind
        self.kind = kind
        if self._smooth is not None:
            pose = self._smooth(*pose, self._headset.dt or 1.0)
        self.position, self.quat = pose
        self._close(controller)
        return kind

    def _close(self, controller: bool) -> None:
        if controller:
            pressed = float(self._buttons[self._squeeze])
            self.closed = pressed > (RELEASED if self.closed else PRESSED)
            return
        apart = math.dist(self._hand[THUMB, :3].tolist(), self._hand[self._tip, :3].tolist())
        self.closed = apart < (OPEN if self.closed else CLOSED)  # false for NaN

    def forget(self) -> None:
        """Begin anew with the next pose."""
        self.kind, self.closed, self.home = "", False, False
        if self._smooth is not None:
            self._smooth.reset()
