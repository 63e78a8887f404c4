"""Shapes: what the bodies of a model look like, as triangles; bones where a body has no looks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from unicon_base.arrays import Float32, Float64
from unicon_core.models.loaded import LoadedModel, import_mujoco
from unicon_core.platforms.kit.base import rotation

_SHOWN = 3  # MuJoCo's own viewers hide the groups of geoms from here on
_BONE = (0.012, 0.045)  # thinnest and thickest, by the radius in [m]
_BONE_COLOUR = (0.55, 0.58, 0.63, 1.0)
_FAINT = 0.05  # a geom below this opacity is there for contacts alone


@dataclass(frozen=True)
class Shape:
    """The triangles of one colour of one body.

    Attributes:
        body: its number in the model; 0 stands still.
        vertices: in the body's frame in [m], shape (v, 3).
        faces: indices of vertices, shape (f, 3).
        rgba: colour, each 0 to 1.
    """

    body: int
    vertices: Float32
    faces: NDArray[np.uint32]
    rgba: tuple[float, ...]


def shapes_of(loaded: LoadedModel) -> list[Shape]:
    """Return the shapes of all bodies; planes are left out, since the page draws its own ground.

    Args:
        loaded: a model; a body of its robot without a visible geom gets bones to its children.
    """
    model = loaded.model
    parts: dict[tuple[int, tuple[float, ...]], list[Any]] = {}
    dressed = set()
    for geom in range(model.ngeom):
        body, colour = int(model.geom_bodyid[geom]), _colour(model, geom)
        if model.geom_group[geom] >= _SHOWN or colour[3] < _FAINT:
            continue
        found = _triangles(model, geom)
        if found is None:
            continue
        matrix = np.eye(4)
        matrix[:3, :3] = rotation(model.geom_quat[geom])
        matrix[:3, 3] = model.geom_pos[geom]
        parts.setdefault((body, colour), []).append(found.apply_transform(matrix))
        dressed.add(body)
    root = int(model.body_rootid[model.jnt_bodyid[loaded.joints[0]]])
    for body in range(1, model.nbody):
        parent = int(model.body_parentid[body])
        if int(model.body_rootid[body]) == root and parent and parent not in dressed:
            bone = _bone(np.array(model.body_pos[body]))
            if bone is not None:
                parts.setdefault((parent, _BONE_COLOUR), []).append(bone)
    shapes = []
    for (body, colour), meshes in parts.items():
        mesh = trimesh.util.concatenate(meshes)
        vertices, faces = np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.uint32)
        shapes.append(Shape(body, vertices, faces, colour))
    return shapes


def _colour(model: Any, geom: int) -> tuple[float, ...]:
    material = int(model.geom_matid[geom])
    rgba = model.mat_rgba[material] if material >= 0 else model.geom_rgba[geom]
    return tuple(round(float(x), 3) for x in rgba)


def _bone(child: Float64) -> Any:
    length = float(np.linalg.norm(child))
    if length < 1e-3:
        return None
    radius = float(np.clip(0.12 * length, *_BONE))
    bone = trimesh.creation.cylinder(radius, segment=[np.zeros(3), child], sections=12)
    return trimesh.util.concatenate([bone, trimesh.creation.icosphere(1, 1.3 * radius)])


def _triangles(model: Any, geom: int) -> Any:
    """Return a geom in its own frame; None for what has no triangles."""
    kind = import_mujoco().mjtGeom(int(model.geom_type[geom])).name.removeprefix("mjGEOM_")
    size, number = np.array(model.geom_size[geom], float), int(model.geom_dataid[geom])
    make = trimesh.creation
    if kind == "SPHERE":
        return make.icosphere(2, size[0])
    if kind == "ELLIPSOID":
        return make.icosphere(2, 1.0).apply_scale(size)
    if kind == "CYLINDER":
        return make.cylinder(size[0], 2.0 * size[1], sections=24)
    if kind == "CAPSULE":
        capsule = make.capsule(2.0 * size[1], size[0], count=[16, 12])
        return capsule.apply_translation(-capsule.bounds.mean(axis=0))
    if kind == "BOX":
        return make.box(2.0 * size)
    if kind == "MESH":
        mesh = model.mesh(number)
        first, face = int(mesh.vertadr[0]), int(mesh.faceadr[0])
        vertices = np.array(model.mesh_vert[first : first + int(mesh.vertnum[0])])
        faces = np.array(model.mesh_face[face : face + int(mesh.facenum[0])])
        return trimesh.Trimesh(vertices, faces, process=False)
    return _field(model, number) if kind == "HFIELD" else None


def _field(model: Any, number: int) -> Any:
    """Return a height field's surface."""
    rows, columns = int(model.hfield_nrow[number]), int(model.hfield_ncol[number])
    wide, deep, high, _ = (float(x) for x in model.hfield_size[number])
    first = int(model.hfield_adr[number])
    height = np.array(model.hfield_data[first : first + rows * columns]) * high
    x, y = np.meshgrid(np.linspace(-wide, wide, columns), np.linspace(-deep, deep, rows))
    cells = np.arange(rows * columns).reshape(rows, columns)
    a, c = (each[:, :-1].ravel() for each in (cells[:-1], cells[1:]))  # b = a + 1, d = c + 1
    faces = np.concatenate([np.stack([a, a + 1, c + 1], 1), np.stack([a, c + 1, c], 1)])
    return trimesh.Trimesh(np.stack([x.ravel(), y.ravel(), height], 1), faces, process=False)
