"""The operator as a headset's states tell him: head, hands or controllers, and what they press.

Parts, buttons and joints are found by the names that the states give their elements; joints of a
hand stand in the order of XRHandJoint (W3C, WebXR Hand Input Module, section 3.2).

Hands that tremble are smoothed by the One-Euro filter: Casiez, Roussel, Vogel 2012, "1€ Filter: A
Simple Speed-based Low-pass Filter for Noisy Input in Interactive Systems", CHI: the cut-off
frequency rises with the speed, which is itself smoothed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Literal

from unicon_base import WorkflowError, alternatives
from unicon_base.arrays import Array
from unicon_core.blocks.controls.device import declares_controls
from unicon_core.bounds import BUTTONS
from unicon_core.flow.block import Writes
from unicon_core.models.frames import Quat, Vector, conjugate, multiply, towards, vector_of
from unicon_core.states import States

SPEED_CUTOFF = 1.0
"""Of the speed itself in [Hz], as in the paper."""


class OneEuro:
    """Smooths a pose.

    Args:
        cutoff: of a hand that keeps still in [Hz].
        slope: by how much the cut-off rises with the speed, in [Hz] for 1 m/s, or 1 rad/s.
    """

    memory = ("_position", "_quat", "_speed", "_turn")

    def __init__(self, cutoff: float, slope: float) -> None:
        self._cutoff, self._slope = cutoff, slope
        self._position: Vector | None = None
        self._quat = (1.0, 0.0, 0.0, 0.0)
        self._speed = self._turn = 0.0

    def reset(self) -> None:
        """Begin with the next pose."""
        self._position = None
        self._speed = self._turn = 0.0

    def __call__(self, position: Vector, quat: Quat, dt: float) -> tuple[Vector, Quat]:
        """Return the smoothed pose: position in [m], quaternion wxyz.

        Args:
            position: in [m].
            quat: unit quaternion wxyz.
            dt: since the last pose in [s], more than 0.
        """
        last = self._position
        if last is None:
            self._position, self._quat = position, quat
            return position, quat
        slow = _alpha(SPEED_CUTOFF, dt)
        self._speed += slow * (math.dist(position, last) / dt - self._speed)
        angle = math.hypot(*vector_of(multiply(quat, conjugate(self._quat))))
        self._turn += slow * (angle / dt - self._turn)
        near = _alpha(self._cutoff + self._slope * self._speed, dt)
        x, y, z = (a + near * (b - a) for a, b in zip(last, position))
        self._position = x, y, z
        share = _alpha(self._cutoff + self._slope * self._turn, dt)
        self._quat = towards(self._quat, quat, share)
        return self._position, self._quat


def _alpha(cutoff: float, dt: float) -> float:
    """Return the share of a new value: 1 / (1 + tau / dt), tau = 1 / (2 pi cutoff)."""
    return 1.0 / (1.0 + 1.0 / (2.0 * math.pi * cutoff * dt))


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
        alive: 1 while it is heard, shape ().
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
        self.alive, self._stamp = self.view("alive"), self.view("stamp_ns")
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
                "before the block that reads it (commands:), or name yours: device: PREFIX"
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
        if not self.alive or not 0.0 <= self.age <= stale:
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


class OperatorHand:
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
        own = [f"{side}_{part}" for part in ("hand", "controller")]
        self._hand, self._controller = map(headset.view, own)
        self._buttons = headset.view(f"{side}_buttons")
        self._parts = [*map(headset.part, own)]
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


HELD_DOWN = 0.5
"""How far a button is pressed that a state of controls counts, 0 to 1."""

# Side to the controller's button and ours.
_BUTTONS: Mapping[str, Mapping[str, str]] = {
    "left": {"squeeze": "L1", "trigger": "L2", "thumbstick": "F1", "a": "X", "b": "Y"},
    "right": {"squeeze": "R1", "trigger": "R2", "thumbstick": "F2", "a": "A", "b": "B"},
}
# Side to the elements of `sticks`: thumbstick x and y, of which y is positive to the back.
_STICKS = {"left": (0, 1), "right": (2, 3)}


class HeadsetControls:
    """Write sticks and buttons of a headset's controllers; all zero while none is tracked.

        commands: [webxr, headset_controls, {drive: {speed: [0.5, 0.3, 0.8]}}]

    Buttons are named by place, as on a Unitree remote: A and B of the right controller, X and Y of
    the left one; L1 and R1 are squeezed, L2 and R2 the triggers, F1 and F2 the pressed sticks.

    A robot that tells its own remote writes these states itself: rename them here and in the blocks
    that read them (`states: {sticks: headset_sticks}`).

    Args:
        device: prefix of the headset's states.

    Raises:
        WorkflowError: there is no such device.
    """

    memory = ()

    endless = True
    declares = staticmethod(declares_controls)

    def __init__(
        self,
        sticks: Writes,
        buttons: Writes,
        controls_alive: Writes,
        *,
        states: States,
        device: str = "webxr",
    ) -> None:
        headset = Headset(states, device)
        self._sticks, self._buttons, self._heard = sticks, buttons, controls_alive
        self._alive, self._valid = headset.alive, headset.valid
        self._sides = [
            (
                headset.part(f"{side}_controller"),
                headset.view(f"{side}_axes"),
                [headset.named(f"{side}_axes", f"thumbstick_{axis}") for axis in "xy"],
                _STICKS[side],
                headset.view(f"{side}_buttons"),
                [headset.named(f"{side}_buttons", name) for name in named],
                [BUTTONS.index(name) for name in named.values()],
            )
            for side, named in _BUTTONS.items()
        ]
        self.reads = tuple(headset.reads)

    def __call__(self) -> None:
        self._sticks[...] = 0.0
        self._buttons[...] = 0
        self._heard[...] = self._alive
        if not self._alive:
            return
        for part, axes, (across, along), (x, y), pressed, theirs, ours in self._sides:
            if not self._valid[part]:
                continue
            self._sticks[x], self._sticks[y] = _share(axes[across]), -_share(axes[along])
            for button, element in zip(theirs, ours):
                self._buttons[element] = pressed[button] > HELD_DOWN

    def reset(self) -> None:
        """Let go of what was pressed before."""
        self._sticks[...] = 0.0
        self._buttons[...] = 0
        self._heard[...] = 0


def _share(value: Any) -> float:
    return max(-1.0, min(float(value), 1.0)) if value == value else 0.0
