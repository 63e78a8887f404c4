"""What a robot file says of a hand: its side, its palm's axes and its fingers, for retargeting.

hand:
  side: left
  palm: {body: L_hand_base_link, quat: [0.5, -0.5, 0.5, -0.5]}
  fingers: {thumb: {body: L_thumb_tip}, index: {body: L_index_tip}}
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Literal, get_args

from unicon_core.robots.places import Place
from unicon_core.schema.marks import Matches, NotEmpty, Write

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
