"""Workspace: where targets may be, for the arms' sake and for what stands around.

A box in the base's frame, and a ball about the shoulder. A target that is outside already, since
the robot's hand was there when the clutch was engaged, is not pulled in; it comes no farther out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from unicon_core.models.plain_turns import Vector

ROUNDS = 3
"""Of going to box and ball in turns; what is left is cut off on the way from the last target."""


@dataclass(frozen=True)
class Workspace:
    """Where the targets of one hand may be.

    Attributes:
        lower: smallest x, y, z in the base's frame in [m].
        upper: largest.
        centre: of the ball in [m].
        radius: in [m]; infinite for no ball.
    """

    lower: Vector
    upper: Vector
    centre: Vector = (0.0, 0.0, 0.0)
    radius: float = math.inf

    def inside(self, wanted: Vector, last: Vector) -> Vector:
        """Return the allowed position in [m] that is near a wanted one.

        Args:
            wanted: in the base's frame in [m].
            last: the target of the tick before, from where it is reached in a straight line.
        """
        lower = tuple(map(min, self.lower, last))
        upper = tuple(map(max, self.upper, last))
        radius = max(self.radius, math.dist(last, self.centre))
        x, y, z = wanted
        for _ in range(ROUNDS):
            x, y, z = (max(a, min(v, b)) for a, v, b in zip(lower, (x, y, z), upper))
            far = math.dist((x, y, z), self.centre)
            if far <= radius:
                return x, y, z
            x, y, z = (c + (v - c) * radius / far for c, v in zip(self.centre, (x, y, z)))
        x, y, z = (max(a, min(v, b)) for a, v, b in zip(lower, (x, y, z), upper))
        if math.dist((x, y, z), self.centre) <= radius:
            return x, y, z
        return self._cut((x, y, z), last, radius)

    def _cut(self, wanted: Vector, last: Vector, radius: float) -> Vector:
        """Return the last point in the ball on the way from one in it to one that is not."""
        way = tuple(w - v for w, v in zip(wanted, last))
        out = tuple(v - c for v, c in zip(last, self.centre))
        a = sum(w * w for w in way)
        b = sum(w * o for w, o in zip(way, out))
        c = sum(o * o for o in out) - radius * radius
        share = max(0.0, min(1.0, (-b + math.sqrt(max(b * b - a * c, 0.0))) / a)) if a else 0.0
        x, y, z = (v + share * w for v, w in zip(last, way))
        return x, y, z
