"""What a robot file says of its bodies: places on them, capsules, and of a hand which is which.

mounts:
  dex3_left: {body: left_wrist_yaw_link, position: [0.0415, 0.003, 0.0], quat: [1, 0, 0, 0]}
end_effectors:
  left_hand: {body: left_wrist_yaw_link, position: [0.12, 0.0, 0.0]}
capsules:
  left_forearm: {body: left_elbow_link, from: [0.02, 0.0, 0.0], to: [0.18, 0.0, 0.0], radius: 0.05}
hand:
  side: left
  palm: {body: L_hand_base_link, quat: [0.5, -0.5, 0.5, -0.5]}
  fingers: {thumb: {body: L_thumb_tip}, index: {body: L_index_tip}}
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Literal, get_args

from unicon_base.schema.marks import (
    Key,
    Matches,
    NotEmpty,
    Point,
    Quat,
    Text,
    Write,
    positive,
)


@dataclass(frozen=True)
class Place:
    """A frame that is fixed to a body of the robot's model.

    Attributes:
        body: body of the model that carries it.
        position: in the frame of that body in [m].
        quat: rotation of the frame to that body, unit quaternion wxyz.
    """

    body: Text
    position: Point = (0.0, 0.0, 0.0)
    quat: Quat = (1.0, 0.0, 0.0, 0.0)


Places = Annotated[
    dict[str, Place],
    Write("{left_hand: {body: left_wrist_yaw_link, position: [x, y, z], quat: [w, x, y, z]}}"),
]
"""Name to place."""


@dataclass(frozen=True)
class Capsule:
    """All points within a radius of a segment; one of length 0 is a sphere.

    Attributes:
        body: body of the model that carries it.
        start: of the segment, in the frame of that body in [m].
        radius: in [m].
        end: likewise; `start` where it is left out.
    """

    body: Text
    start: Annotated[Point, Key("from")]
    radius: Annotated[float, positive(1.0, "m")]
    end: Annotated[Point, Key("to")] = ()  # type: ignore[assignment]

    def __post_init__(self) -> None:
        object.__setattr__(self, "end", self.end or self.start)


Capsules = Annotated[
    dict[str, Capsule],
    Write("{left_forearm: {body: left_elbow_link, from: [x, y, z], to: [x, y, z], radius: 0.05}}"),
]
"""Name to capsule."""

Finger = Literal["thumb", "index", "middle", "ring", "pinky"]
"""As of the joints of a human hand in WebXR; a robot may have fewer."""

FINGERS: tuple[Finger, ...] = get_args(Finger)
SIDES = ("left", "right")


@dataclass(frozen=True)
class Hand:
    """Which part of a robot's hand is which of a human's.

    Attributes:
        palm: frame of the palm: x to the fingers, z out of the back of the hand, y to the left of
            both.
        fingers: finger, in the order of `FINGERS`, to the place of its tip.
        side: left or right; left out where the file is of both: its places are the left's then.
    """

    palm: Place
    fingers: Annotated[Mapping[Finger, Place], NotEmpty, Write("{thumb: {body: …}, index: …}")]
    side: Annotated[str, Matches("left|right", "left or right, and nothing for both")] = ""

    def __post_init__(self) -> None:
        ordered = {finger: self.fingers[finger] for finger in FINGERS if finger in self.fingers}
        object.__setattr__(self, "fingers", ordered)

    def of(self, side: str) -> Hand:
        """Return the hand of a side; where the file is of both, y is mirrored for the right one."""
        if self.side or side != "right":
            return self
        fingers = {finger: _mirrored(place) for finger, place in self.fingers.items()}
        return Hand(_mirrored(self.palm), fingers, side)


def _mirrored(place: Place) -> Place:
    (x, y, z), (qw, qx, qy, qz) = place.position, place.quat
    return Place(place.body, (x, -y, z), (qw, -qx, qy, -qz))
