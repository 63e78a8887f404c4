"""Meshes made by tests: a binary STL that MuJoCo shifts and turns, and a Go2 that wears it."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

__all__ = ["WEDGE", "go2_with_meshes", "stl_vertices", "write_stl"]

CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 0.5, 0], [0, 0, 0.2]]) * 0.3 + (0.1, 0.2, -0.3)
WEDGE: NDArray[np.float32] = CORNERS.astype(np.float32)[
    [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]
]
"""Triangles of a lopsided tetrahedron away from its origin, in [m], shape (4, 3, 3)."""
_FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def write_stl(path: Path, triangles: NDArray[np.float32] = WEDGE) -> Path:
    """Write a binary STL, and return its path."""
    facets = np.zeros(len(triangles), _FACET)
    facets["corners"] = triangles
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(bytes(80) + struct.pack("<I", len(facets)) + facets.tobytes())
    return path


def stl_vertices(path: Path) -> NDArray[np.float64]:
    """Return the vertices of a binary STL in [m], shape (v, 3), as often as they stand there."""
    corners = np.frombuffer(path.read_bytes()[84:], _FACET)["corners"]
    return corners.reshape(-1, 3).astype(float)


def go2_with_meshes(folder: Path) -> Path:
    """Write our Go2 with a mesh on its trunk and one on a thigh; return the model's path."""
    write_stl(folder / "meshes" / "coque é.stl")
    write_stl(folder / "meshes" / "thigh.STL", WEDGE * 0.3)
    source = Path(__file__).resolve().parents[1] / "config" / "models" / "go2" / "go2.xml"
    mesh = '<geom class="look" type="mesh" mesh="{}"/>'
    text = source.read_text("utf-8")
    for old, new in (
        ("<compiler ", '<compiler meshdir="meshes" '),
        ("<asset>", '<asset><mesh name="trunk" file="coque é.stl"/><mesh file="thigh.STL"/>'),
        ('<geom name="trunk"', f'{mesh.format("trunk")}<geom name="trunk"'),
        ('<geom name="FR_thigh"', f'{mesh.format("thigh")}<geom name="FR_thigh"'),
    ):
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    path = folder / "go2.xml"
    path.write_text(text, "utf-8")
    return path
