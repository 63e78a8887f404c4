"""Frames: what a headset's page sends in each of its frames, as bytes and in our axes.

WebXR's axes are x right, y up, z back (W3C, WebXR Device API, section 7.1); ours are x forward,
y left, z up (REP-103). Both the world's and each pose's own axes are turned, so that the head's x
looks forward, and a joint's x points to the finger's tip and its z out of the back of the hand.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping

import numpy as np

from unicon_base.arrays import Float32

_FINGER = ("metacarpal", "phalanx-proximal", "phalanx-intermediate", "phalanx-distal", "tip")
JOINTS = (
    "wrist",
    "thumb-metacarpal",
    "thumb-phalanx-proximal",
    "thumb-phalanx-distal",
    "thumb-tip",
    *(
        f"{finger}-finger-{bone}"
        for finger in ("index", "middle", "ring", "pinky")
        for bone in _FINGER
    ),
)
"""Of a hand, in the order of XRHandJoint (W3C, WebXR Hand Input Module, section 3.2)."""

PARTS: Mapping[str, slice] = {
    "head": slice(0, 1),
    "left_hand": slice(1, 26),
    "right_hand": slice(26, 51),
    "left_controller": slice(51, 52),
    "right_controller": slice(52, 53),
    "left_aim": slice(53, 54),
    "right_aim": slice(54, 55),
}
"""Where the poses of each stand among the 55; the number of a part is its bit in `flags`."""

BUTTONS = ("trigger", "squeeze", "touchpad", "thumbstick", "a", "b", "more_1", "more_2")
"""Of a controller, as `xr-standard` has them (W3C, WebXR Gamepads Module, section 3.3); `a` and `b`
are X and Y on the left."""
AXES = ("touchpad_x", "touchpad_y", "thumbstick_x", "thumbstick_y")
"""-1 to 1, right and down positive."""

VERSION = 1
FRAME = np.dtype(
    [
        ("version", "<u2"),
        ("flags", "<u2"),
        ("number", "<u4"),
        ("time", "<f8"),
        ("poses", "<f4", (55, 7)),
        ("buttons", "<f4", (2, 8)),
        ("axes", "<f4", (2, 4)),
    ]
)
"""1652 B: `time` is the page's in [ms]; a pose is position [m] and quaternion xyzw, by WebXR."""

PING, ANSWER = struct.Struct("<q"), struct.Struct("<qd")
"""Our time in [ns], and in the answer the page's in [ms]."""

FAR = 1000.0
"""No pose is further away, in [m]."""

_PART_OF = np.repeat(np.arange(len(PARTS)), [part.stop - part.start for part in PARTS.values()])
_OURS = [2, 0, 1]
_SIGN = np.array([-1.0, -1.0, 1.0], np.float32)
_NEUTRAL = np.array([0, 0, 0, 1, 0, 0, 0], np.float32)


class Refused(Exception):
    """A message that is not taken; its text says why, the same for all alike."""


class Frame:
    """A message, taken apart.

    Args:
        data: of the message.

    Attributes:
        number: of the headset's frame.
        time: when it was, of the page's clock in [ms].
        valid: 1 where a part is tracked, shape (7,), as of `PARTS`.
        poses: position [m] and quaternion wxyz in our axes, shape (55, 7); identity where not.
        buttons: pressed how far, 0 to 1, left and right, shape (2, 8).
        axes: -1 to 1, left and right, shape (2, 4).

    Raises:
        Refused: it is none, or holds what cannot be.
    """

    def __init__(self, data: bytes) -> None:
        if len(data) != FRAME.itemsize:
            raise Refused("wrong length")
        told = np.frombuffer(data, FRAME)[0]
        if told["version"] != VERSION:
            raise Refused("wrong version")
        self.number, self.time = int(told["number"]), float(told["time"])
        flags = int(told["flags"])
        if flags >> len(PARTS):
            raise Refused("unknown parts")
        if not 0.0 <= self.time < 1e12:
            raise Refused("no time")
        self.valid = (flags >> np.arange(len(PARTS)) & 1).astype(np.int32)
        self.poses = self._turned(told["poses"])
        self.buttons, self.axes = told["buttons"], told["axes"]
        if (
            not ((self.buttons >= 0.0) & (self.buttons <= 1.0)).all()
            or not (np.abs(self.axes) <= 1.0).all()
        ):
            raise Refused("not a button")  # neither is NaN

    def _turned(self, raw: Float32) -> Float32:
        there = self.valid[_PART_OF].astype(bool)
        poses = np.tile(_NEUTRAL, (len(raw), 1))
        given = raw[there]
        if not (np.abs(given) < FAR).all():  # nor is NaN
            raise Refused("not finite")
        length = np.linalg.norm(given[:, 3:], axis=1, keepdims=True)
        if not ((length > 0.9) & (length < 1.1)).all():
            raise Refused("not a rotation")
        turned = poses[there]
        turned[:, :3] = given[:, _OURS] * _SIGN
        turned[:, 3] = given[:, 6]
        turned[:, 4:] = given[:, 3:6][:, _OURS] * _SIGN
        turned[:, 3:] /= length
        poses[there] = turned
        return poses
