"""Ground: a terrain as shapes in the world, for whoever lays it under a robot.

The robot begins at the origin, where the ground is flat at height 0; x points forward.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]

THICK = 0.5
"""How far shapes go down below the lowest ground, [m]: a foot at 40 m/s goes 8 cm in a step."""


@dataclass(frozen=True)
class Box:
    """A box that stands still.

    Attributes:
        centre: in the world in [m].
        half: half of its edges in [m].
        pitch: by which it is turned about y in [rad]; its front goes down.
        friction: factor on that of the floor.
    """

    centre: tuple[float, float, float]
    half: tuple[float, float, float]
    pitch: float = 0.0
    friction: float = 1.0

    @property
    def quat(self) -> tuple[float, float, float, float]:
        """Box to world, wxyz."""
        return math.cos(self.pitch / 2), 0.0, math.sin(self.pitch / 2), 0.0


@dataclass(frozen=True, eq=False)
class Field:
    """Heights at the points of a grid; between them the ground is made of triangles.

    Attributes:
        heights: in [m], shape (points in y, points in x).
        half: from the middle to the edge in [m].
    """

    heights: Float
    half: float


@dataclass(frozen=True, eq=False)
class Ground:
    """What a terrain is made of.

    Attributes:
        floor: height of the floor below and beyond all of it in [m].
        boxes: that lie on it.
        field: or heights over it.
    """

    floor: float
    boxes: tuple[Box, ...] = ()
    field: Field | None = None


def block(
    x: tuple[float, float],
    y: tuple[float, float],
    top: float,
    floor: float,
    friction: float = 1.0,
) -> Box:
    """Return an upright box by its ends in x and y and its top, down below the floor, in [m]."""
    bottom = min(floor, top) - THICK
    return Box(
        ((x[0] + x[1]) / 2, (y[0] + y[1]) / 2, (top + bottom) / 2),
        ((x[1] - x[0]) / 2, (y[1] - y[0]) / 2, (top - bottom) / 2),
        friction=friction,
    )
