"""Shapes: what the bodies of a model look like, as triangles.

A body whose model shows nothing but contact dots gets the hull of its collision geoms, else the
ellipsoid of its inertia, and bones to its children. `Looks` puts shapes into a viewer's scene.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray
from viser import _messages

from unicon_base.arrays import Float32, Float64
from unicon_core.models.loaded import LoadedModel, import_mujoco
from unicon_core.platforms.kit.base import rotation

_SHOWN = 3  # MuJoCo's own viewers hide the groups of geoms from here on
_DOT, _BONE = 0.02, 0.025  # of the robot's reach: radius of a contact dot, of a bone at most
_BONE_COLOUR = (0.55, 0.58, 0.63, 1.0)
_UNSEEN = 0.05  # a geom below this opacity is there for contacts alone


_GHOST, _FAINT = (70, 130, 230), 0.3
_STILL = 1e-5  # [m], and of a quaternion: what moved less stays where it is


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
        loaded: a model.
    """
    model = loaded.model
    parts: dict[tuple[int, tuple[float, ...]], list[Any]] = {}
    dressed, hidden = set[int](), dict[int, list[Float64]]()
    root = int(model.body_rootid[model.jnt_bodyid[loaded.joints[0]]])
    own = [body for body in range(1, model.nbody) if model.body_rootid[body] == root]
    # Of four limbs each has a quarter of all lengths.
    reach = max(float(np.linalg.norm(model.body_pos[own[1:]], axis=1).sum()) / 4.0, 0.05)
    for geom in range(model.ngeom):
        body, colour = int(model.geom_bodyid[geom]), _colour(model, geom)
        found = _triangles(model, geom)
        if found is None:
            continue
        found.apply_transform(_matrix(model.geom_pos[geom], model.geom_quat[geom]))
        seen = model.geom_group[geom] < _SHOWN and colour[3] >= _UNSEEN
        if seen:
            parts.setdefault((body, colour), []).append(found)
        if seen and model.geom_rbound[geom] >= _DOT * reach:
            dressed.add(body)
        hidden.setdefault(body, [np.zeros((1, 3))]).append(found.vertices)
    for body in own:
        if body in dressed:
            continue
        made = _stand_in(model, body, hidden.get(body), reach)
        children = model.body_pos[1:][model.body_parentid[1:] == body]
        made += [_bone(each, reach) for each in children if np.linalg.norm(each) > 1e-3]
        if made:
            parts.setdefault((body, _BONE_COLOUR), []).extend(made)
    shapes = []
    for (body, colour), meshes in parts.items():
        mesh = trimesh.util.concatenate(meshes)
        vertices, faces = np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.uint32)
        shapes.append(Shape(body, vertices, faces, colour))
    return shapes


def _stand_in(model: Any, body: int, hidden: list[Float64] | None, reach: float) -> list[Any]:
    """Return the hull of a body's collision geoms and its origin, else its inertia's ellipsoid."""
    points = np.vstack(hidden or [np.zeros((1, 3))])
    if np.ptp(points, axis=0).min() > 1e-4:
        return [trimesh.convex.convex_hull(points)]
    mass, inertia = float(model.body_mass[body]), np.array(model.body_inertia[body])
    if mass < 1e-3:
        return []
    squares = 2.5 / mass * (inertia.sum() - 2.0 * inertia)  # of a solid ellipsoid
    axes = np.clip(np.sqrt(np.maximum(squares, 0.0)), 0.01 * reach, 0.2 * reach)
    ball = trimesh.creation.icosphere(2, 1.0).apply_scale(axes)
    return [ball.apply_transform(_matrix(model.body_ipos[body], model.body_iquat[body]))]


def _matrix(position: Float64, quat: Float64) -> Float64:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation(quat), position
    return matrix


def _colour(model: Any, geom: int) -> tuple[float, ...]:
    material = int(model.geom_matid[geom])
    rgba = model.mat_rgba[material] if material >= 0 else model.geom_rgba[geom]
    return tuple(round(float(x), 3) for x in rgba)


def _bone(child: Float64, reach: float) -> Any:
    """Return a bone from a body's origin to a child's, with a ball at its joint."""
    length = float(np.linalg.norm(child))
    radius = min(0.12 * length, _BONE * reach)
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


def move(node: Any, position: Sequence[float], quat: Sequence[float] | None = None) -> None:
    """Put a node of a scene where it has moved to.

    Its own properties compare with what was there, which took half of a viewer's time.

    Args:
        node: viser's handle.
        position: in its parent in [m], three numbers.
        quat: likewise, wxyz; None where it never turns.
    """
    inside = node._impl
    queue = inside.api._queue_scene_message
    queue(_messages.SetPositionMessage(inside.name, tuple(position)))
    if quat is not None:
        queue(_messages.SetOrientationMessage(inside.name, tuple(quat)))


class Looks:
    """The shapes of a robot in one viewer's scene.

    Args:
        api: viser's scene of this viewer.
        shapes: of its bodies.
        name: of the nodes; those of a `ghost` are transparent.

    Attributes:
        root: viser's handle of all.
        meshes: its handles, by the number of the body.
    """

    def __init__(self, api: Any, shapes: Sequence[Shape], name: str) -> None:
        ghost = name == "ghost"
        self._poses = np.full((1 + max((shape.body for shape in shapes), default=0), 7), np.inf)
        self.root = api.add_frame(f"/world/{name}", show_axes=False)
        self.meshes: dict[int, list[Any]] = {}
        self._frames: dict[int, Any] = {}
        for number, shape in enumerate(shapes):
            if ghost and not shape.body:
                continue
            place = f"/world/{name}/{shape.body}"
            if shape.body not in self._frames:
                self._frames[shape.body] = api.add_frame(place, show_axes=False)
            opacity = _FAINT if ghost else shape.rgba[3]
            mesh = api.add_mesh_simple(
                f"{place}/shape_{number}",
                shape.vertices,
                shape.faces,
                color=_GHOST if ghost else tuple(round(255 * x) for x in shape.rgba[:3]),
                opacity=None if opacity > 0.98 else opacity,
                flat_shading=True,
                side="double",
            )
            self.meshes.setdefault(shape.body, []).append(mesh)

    def put(self, position: Float64, quat: Float64) -> None:
        """Put the bodies that have moved where they are.

        Args:
            position: of the model's bodies in the world in [m], shape (bodies, 3).
            quat: of the bodies, wxyz, shape (bodies, 4).
        """
        poses = np.hstack([position, quat])[: len(self._poses)]
        for body in np.flatnonzero(np.abs(poses - self._poses).max(axis=1) > _STILL).tolist():
            self._poses[body] = poses[body]
            if body in self._frames:
                place = poses[body].tolist()
                move(self._frames[body], place[:3], place[3:])
