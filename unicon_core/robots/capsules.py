"""Capsules: what a robot's links are to whoever keeps them apart, of robot files.

capsules:
  left_forearm: {body: left_elbow_link, from: [0.02, 0.0, 0.0], to: [0.18, 0.0, 0.0], radius: 0.05}
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from unicon_core.schema.marks import Key, Point, Text, Unit, Within, Write


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
    radius: Annotated[float, Unit("m"), Within(0.0, 1.0, above=True)]
    end: Annotated[Point, Key("to")] = ()  # type: ignore[assignment]

    def __post_init__(self) -> None:
        object.__setattr__(self, "end", self.end or self.start)


Capsules = Annotated[
    dict[str, Capsule],
    Write("{left_forearm: {body: left_elbow_link, from: [x, y, z], to: [x, y, z], radius: 0.05}}"),
]
"""Name to capsule."""
