"""Links and what they look like: a robot's tree as URDF and transforms have it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from unicon_core.models.quaternions import Float


@dataclass
class Geom:
    """One shape of a link.

    Attributes:
        shape: `box`, `sphere`, `cylinder` or `mesh`.
        size: box: edges; sphere: radius; cylinder: radius, length; in [m]; mesh: scale.
        position: in the link's frame, [m], shape (3,).
        quat: geom to link, wxyz.
        rgba: colour; empty for that of a mesh's own file.
        number: of the model's geom of which it is a part, -1 for none.
        uri: of a mesh's file.
    """

    shape: str
    size: tuple[float, ...]
    position: Float
    quat: Float
    rgba: tuple[float, ...]
    number: int = -1
    uri: str = ""


@dataclass
class Link:
    """One link and the joint that carries it.

    Attributes:
        name: frame name.
        parent: number of the parent link, -1 for the root.
        position: of the joint in the parent's frame in [m], shape (3,).
        quat: link to parent at joint position 0, wxyz.
        joint: name of the joint in the robot's words, "" where it is fixed.
        index: number of the joint in the robot's order, -1 where it is none of them.
        sliding: moves along the axis and does not turn about it.
        axis: unit vector in the link's frame, shape (3,).
        lower, upper: limits in [rad] or [m]; NaN where there are none.
        mass: in [kg], 0 for a link without inertia.
        centre: centre of mass in the link's frame in [m], shape (3,).
        inertia_quat: principal axes to link, wxyz.
        inertia: principal moments in [kg·m²], shape (3,).
        geoms: what it looks like, in primitives.
        looks: what it looks like with meshes; None where it has none.
        number: of the model's joint that carries it, -1 where it is fixed.
    """

    name: str
    parent: int
    position: Float = field(default_factory=lambda: np.zeros(3))
    quat: Float = field(default_factory=lambda: np.array((1.0, 0.0, 0.0, 0.0)))
    joint: str = ""
    index: int = -1
    sliding: bool = False
    axis: Float = field(default_factory=lambda: np.array((0.0, 0.0, 1.0)))
    lower: float = float("nan")
    upper: float = float("nan")
    mass: float = 0.0
    centre: Float = field(default_factory=lambda: np.zeros(3))
    inertia_quat: Float = field(default_factory=lambda: np.array((1.0, 0.0, 0.0, 0.0)))
    inertia: Float = field(default_factory=lambda: np.zeros(3))
    geoms: list[Geom] = field(default_factory=list)
    looks: list[Geom] | None = None
    number: int = -1
