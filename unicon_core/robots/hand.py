"""What a robot file says of a hand: its side, its palm's axes and its fingers, for retargeting.

hand:
  side: left
  palm: {body: L_hand_base_link, quat: [0.5, -0.5, 0.5, -0.5]}
  fingers: {thumb: {body: L_thumb_tip}, index: {body: L_index_tip}}
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from unicon_core.errors import alternatives
from unicon_core.robots.places import Place, places_of, wrong_places

HAND_KEYS = ("side", "palm", "fingers")
SIDES = ("left", "right")
FINGERS = ("thumb", "index", "middle", "ring", "pinky")
"""As of the joints of a human hand in WebXR; a robot may have fewer."""

_EXAMPLE = "write {side: left, palm: {body: …, quat: […]}, fingers: {thumb: {body: …}, …}}"


@dataclass(frozen=True)
class Hand:
    """Which part of a robot's hand is which of a human's."""

    side: str
    """left or right; "" where the file is of both: its places are the left's then."""
    palm: Place
    """Frame of the palm: x to the fingers, z out of the back of the hand, y to the left of both."""
    fingers: Mapping[str, Place]
    """Finger, in the order of `FINGERS`, to the place of its tip."""

    def of(self, side: str) -> Hand:
        """Return the hand of a side; where the file is of both, y is mirrored for the right one."""
        if self.side or side != "right":
            return self
        fingers = {finger: _mirrored(place) for finger, place in self.fingers.items()}
        return Hand(side, _mirrored(self.palm), fingers)


def _mirrored(place: Place) -> Place:
    (x, y, z), (qw, qx, qy, qz) = place.position, place.quat
    return Place(place.body, (x, -y, z), (qw, -qx, qy, -qz))


def hand_of(said: Mapping[str, Any] | None) -> Hand | None:
    """Return the hand that a checked mapping says, None where it says nothing."""
    if said is None:
        return None
    fingers = places_of(said["fingers"])
    ordered = {finger: fingers[finger] for finger in FINGERS if finger in fingers}
    return Hand(said.get("side", ""), places_of({"palm": said["palm"]})["palm"], ordered)


def wrong_hand(said: object) -> Iterator[tuple[tuple[str, ...], str]]:
    """Yield what is wrong with a hand: keys that lead to it, and the words behind them.

    Args:
        said: `side`, which may be left out, `palm`, a place, and `fingers`, name to place.
    """
    if not isinstance(said, Mapping):
        yield (), f"is {said!r:.60}; {_EXAMPLE}"
        return
    for key in said:
        if key not in HAND_KEYS:
            yield (str(key),), f"is not known; {alternatives(str(key), HAND_KEYS)}"
    if "side" in said and said["side"] not in SIDES:
        yield ("side",), f"is {said['side']!r:.60}; write left or right, and nothing for both"
    for key in ("palm", "fingers"):
        if key not in said:
            yield (), f"has no {key!r}; {_EXAMPLE}"
    if "palm" in said:
        yield from wrong_places({"palm": said["palm"]})
    fingers = said.get("fingers", {"thumb": {"body": "-"}})
    if not isinstance(fingers, Mapping) or not fingers:
        yield ("fingers",), f"is {fingers!r:.60}; write {{thumb: {{body: …}}, index: …}}"
        return
    for finger in fingers:
        if finger not in FINGERS:
            known = alternatives(str(finger), FINGERS)
            yield ("fingers", str(finger)), f"is not a finger; {known}"
    for where, found in wrong_places(fingers):
        yield ("fingers", *where), found
