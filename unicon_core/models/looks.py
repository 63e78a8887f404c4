"""Looks: links with the meshes that show them, for robot_description; collisions stay primitives.

Of an MJCF they are the mesh geoms that MuJoCo shows (groups 0 to 2), without those that collide
where others do not. Of a URDF they are its own `<visual>` elements, which MuJoCo mostly drops.
"""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from unicon_core.errors import UniconError
from unicon_core.models.find import pick_model
from unicon_core.models.kinematic_tree import read_tree
from unicon_core.models.links import Geom, Link
from unicon_core.models.load import load_model
from unicon_core.models.loaded import LoadedModel, import_mujoco
from unicon_core.models.mesh_files import MeshFiles
from unicon_core.models.quaternions import Float, multiply, rotate
from unicon_core.models.touching import solid
from unicon_core.models.urdf_visuals import give_visuals
from unicon_core.robots import Robot

_FAINT = 0.05
"""Opacity below which a geom is there for contacts alone."""
_BACK = np.array((1.0, -1.0, -1.0, -1.0))
"""Times a unit quaternion: its inverse."""

_Reference = tuple[Float, Float, str]
"""Of a mesh: `refpos` [m], shape (3,), `refquat`, wxyz, shape (4,), and its `meshdir`."""


def dressed(path: Path, robot: Robot) -> tuple[LoadedModel, list[Link], str]:
    """Load a model; return it, its links with `looks`, and what is lacking, in one line, else "".

    Args:
        path: MJCF or URDF, as `find_model` found it.
        robot: as for `load_model` and `read_tree`.

    Raises:
        UniconError: the file is wrong, lacks a joint, or MuJoCo is not installed to read it.
    """
    references: dict[str, _Reference] = {}

    def note(spec: Any) -> None:
        for mesh in spec.meshes:
            folder = mesh.compiler.meshdir or spec.compiler.meshdir or spec.meshdir or ""
            name = mesh.name or Path(mesh.file).stem
            references[name] = np.array(mesh.refpos), np.array(mesh.refquat), folder

    loaded = load_model(path, robot, quiet=True, prepare=note)
    links = read_tree(loaded.model, robot)
    files = MeshFiles(_models(path, robot))
    own = (
        give_visuals(path, links, robot.base_frame, files)
        if path.suffix.lower() == ".urdf"
        else set()
    )
    for link in links:
        if link.name not in own:
            _dress(link, loaded.model, references, files)
    return loaded, links, "; ".join([*loaded.absent.values(), *files.told()])


def _models(path: Path, robot: Robot) -> dict[str, Path]:
    models = {"": path}
    for member in robot.members.keys() & robot.mounts.keys():
        with suppress(UniconError):
            models[member] = pick_model(robot.members[member])
    return models


def _dress(link: Link, model: Any, references: dict[str, _Reference], files: MeshFiles) -> None:
    kind = int(import_mujoco().mjtGeom.mjGEOM_MESH)
    meshes = [g for g in link.geoms if g.number >= 0 and int(model.geom_type[g.number]) == kind]
    meshes = [geom for geom in meshes if model.geom_group[geom.number] < 3]
    free = [geom.number for geom in meshes if not solid(model, geom.number)]
    worn = {
        geom.number: _mesh(geom, model, references, files)
        for geom in meshes
        if not free or geom.number in free
    }
    if any(each.uri for each in worn.values()):
        hidden = {geom.number for geom in meshes} - worn.keys()
        seen = [g for g in link.geoms if g.number not in hidden and g.rgba[3] >= _FAINT]
        link.looks = [worn.get(geom.number, geom) for geom in seen]


def _mesh(geom: Geom, model: Any, references: dict[str, _Reference], files: MeshFiles) -> Geom:
    """Return a geom as its file has it; MuJoCo shifts and turns meshes when it compiles them.

    MuJoCo's own vertices are R(quat)ᵀ (scale ∘ R(refquat)ᵀ (file − refpos) − pos).
    """
    mesh = int(model.geom_dataid[geom.number])
    start = int(model.mesh_pathadr[mesh])
    if start < 0:
        return geom
    file = model.paths[start : model.paths.index(b"\0", start)].decode("utf-8", "surrogateescape")
    name = model.mesh(mesh).name
    refpos, refquat, folder = references[name]
    refback = refquat / np.linalg.norm(refquat) * _BACK
    scale = np.array(model.mesh_scale[mesh])
    if abs(refback[0]) < 1.0 - 1e-9 and np.ptp(scale) > 1e-9:
        files.refuse(file, "turned by refquat and scaled unevenly, which URDF cannot say")
        return geom
    uri = files.opened(name, folder, file)
    if not uri:
        return geom
    quat = multiply(geom.quat, model.mesh_quat[mesh] * _BACK)
    centre = rotate(geom.quat, np.array(model.geom_aabb[geom.number, :3]))
    shift = rotate(refback, scale * refpos) + model.mesh_pos[mesh]
    position = geom.position - centre - rotate(quat, shift)
    quat = multiply(quat, refback)
    return Geom("mesh", tuple(scale), position, quat, geom.rgba, geom.number, uri)
