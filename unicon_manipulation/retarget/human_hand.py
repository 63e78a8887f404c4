"""A human hand as a headset tells it: its fingers' vectors, and whether it can be one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from unicon_base.arrays import Float32, Float64

JOINTS = 25
"""Of a hand in WebXR, in the order of XRHandJoint (W3C, WebXR Hand Input Module, section 3.2): the
wrist, four of the thumb, then five of each finger, the first of them in the palm."""

CHAINS = {
    "thumb": (1, 2, 3, 4),
    "index": (6, 7, 8, 9),
    "middle": (11, 12, 13, 14),
    "ring": (16, 17, 18, 19),
    "pinky": (21, 22, 23, 24),
}
"""Finger to its joints from where it begins to move, to its tip: three bones."""

_INDEX, _PINKY = CHAINS["index"][0], CHAINS["pinky"][0]

ABSENT = "absent"
"""What `look` tells of a hand that nobody tracks."""

# [m]. A grown-up's phalanges have 16 to 45 mm on average, the thumb's bone in the palm 46 (Buryanov
# & Kotiuk, Proportions of Hand Segments, Int. J. Morphol. 28(3), 2010). What has a third of that or
# twice as much may be a hand; a finger of 1 m is none.
BONE = 0.005, 0.11
FINGER = 0.03, 0.2
PALM = 0.005, 0.22
WIDE = 0.02
"""In [m]: the knuckle of the index finger is that far and more to one side of the pinky's."""
_LOW, _HIGH = np.array((PALM, BONE, BONE, BONE)).T
_WHAT = ("the way from the wrist to the", *("a bone of the",) * 3)


class HumanHand:
    """What the fingers of a human hand say, of its 25 poses.

    Args:
        poses: position [m] and quaternion wxyz of each joint, in any one frame, shape (25, 7). The
            wrist's x leads to the fingers, its z out of the back of the hand.
        fingers: those that are asked for, as of `FINGERS` of a robot file.
        side: left or right; "" for either.
        mirrored: give what a hand of the other side would.

    Attributes:
        vectors: from where each finger begins to its tip, in the wrist's frame in [m], shape
            (f, 3).
        lengths: of the fingers along their bones in [m], however they bend, shape (f,).
        tips: of the fingers, in the wrist's frame from the wrist in [m], shape (f, 3).
        knee: from where the thumb begins to its last joint likewise, shape (3,).
    """

    def __init__(
        self,
        poses: Float32,
        fingers: Sequence[str],
        side: str = "",
        *,
        mirrored: bool = False,
    ) -> None:
        self._points, self._wrist, self._side = poses[:, :3], poses[0, 3:], side
        self._fingers = tuple(fingers)
        self._chains = np.array([(0, *CHAINS[finger]) for finger in fingers])
        count = len(fingers)
        self.vectors, self.tips = np.zeros((count, 3)), np.zeros((count, 3))
        self.lengths, self.knee = np.zeros(count), np.zeros(3)
        self._across = np.array((1.0, -1.0, 1.0)) if mirrored else np.ones(3)
        self._thumb = self._fingers.index("thumb") if "thumb" in self._fingers else -1

    def look(self) -> str:
        """Take the poses anew; return "" if they are a hand, `ABSENT`, or what is wrong."""
        chains = self._points[self._chains].astype(np.float64)
        ways = chains[:, 1:] - chains[:, :-1]
        sizes = np.sqrt(np.einsum("fbx,fbx->fb", ways, ways))
        np.sum(sizes[:, 1:], axis=1, out=self.lengths)
        w, x, y, z = self._wrist.tolist()
        norm = w * w + x * x + y * y + z * z
        if not (
            ((sizes >= _LOW) & (sizes <= _HIGH)).all()
            and self.lengths.min() >= FINGER[0]
            and self.lengths.max() <= FINGER[1]
            and 0.8 < norm < 1.2
        ):
            return self._wrong(sizes, norm)
        turn = _matrix(w, x, y, z, norm)
        wide = float((self._points[_INDEX] - self._points[_PINKY]) @ turn[:, 1])
        if self._side and (wide < -WIDE if self._side == "right" else wide > WIDE):
            return f"it is not a {self._side} hand"
        turn *= self._across
        if self._thumb >= 0:
            thumb = chains[self._thumb]
            np.matmul(thumb[3] - thumb[1], turn, out=self.knee)
        tips = chains[:, 4]
        np.matmul(tips - chains[:, 1], turn, out=self.vectors)
        np.matmul(tips - chains[:, 0], turn, out=self.tips)
        return ""

    def _wrong(self, sizes: Float64, norm: float) -> str:
        """Return why it is not a hand."""
        if np.isnan(self._points).any() or norm != norm or not sizes.any():
            return ABSENT  # as where nothing is tracked, all joints at one place
        if not np.isfinite(sizes).all():
            return "a joint is infinitely far away"
        if not 0.8 < norm < 1.2:
            return f"the wrist's quaternion has length {norm**0.5:.3g}"
        off = np.maximum(_LOW - sizes, sizes - _HIGH)
        if off.max() > 0.0:
            finger, bone = np.unravel_index(int(off.argmax()), off.shape)
            return f"{_WHAT[bone]} {self._fingers[finger]} is {sizes[finger, bone]:.3g} m"
        off = np.maximum(FINGER[0] - self.lengths, self.lengths - FINGER[1])
        finger = off.argmax()
        return f"the length of the {self._fingers[finger]} is {self.lengths[finger]:.3g} m"


def _matrix(w: float, x: float, y: float, z: float, norm: float) -> Float64:
    """Return the rotation of a quaternion wxyz whose length's square is `norm`, shape (3, 3)."""
    s = 2.0 / norm
    return np.array(
        (
            (1.0 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y)),
            (s * (x * y + w * z), 1.0 - s * (x * x + z * z), s * (y * z - w * x)),
            (s * (x * z - w * y), s * (y * z + w * x), 1.0 - s * (x * x + y * y)),
        )
    )
