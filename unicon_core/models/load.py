"""Loads a model file (MJCF or URDF) whatever it lacks: meshes, a floor, a floating base, motors."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from unicon_core.errors import MissingDependencyError, ModelError
from unicon_core.models.joints import find_joints, joint_transmissions
from unicon_core.models.urdf_repair import repaired_urdf
from unicon_core.robots import Robot

__all__ = ["LoadedModel", "import_mujoco", "load_model"]

_log = logging.getLogger(__name__)

_FLOATING = ("quadruped", "humanoid")
_MESHES = (".stl", ".obj", ".msh")  # what MuJoCo reads; COLLADA counts as absent
_URDF_TIMESTEP = 0.002  # [s]; MuJoCo's own default, said here since a URDF cannot say it


@dataclass
class LoadedModel:
    """A compiled model and how it was found.

    Attributes:
        model: the `MjModel`.
        path: its file.
        joints: joint id of each robot joint, in the robot's order, length n.
        notes: what was changed or left out, one line each.
    """

    model: Any
    path: Path
    joints: list[int]
    notes: list[str] = field(default_factory=list)


def import_mujoco() -> Any:
    """Return the mujoco module.

    Raises:
        MissingDependencyError: it is not installed.
    """
    try:
        import mujoco
    except ImportError as error:
        raise MissingDependencyError(
            "platform 'mujoco'", "mujoco", "pip install 'unicon_ros[sim]'"
        ) from error
    if mujoco.get_mju_user_warning() is None:  # else MuJoCo writes MUJOCO_LOG.TXT where we stand
        mujoco.set_mju_user_warning(_log.info)
    return mujoco


def load_model(path: Path, robot: Robot, timestep: float | None = None) -> LoadedModel:
    """Read and compile a model for a robot.

    Visual and collision meshes whose files are absent are dropped with one warning; mistakes of
    public URDF files that ROS reads over are mended. A URDF of a robot that walks gets a free
    joint; a walking robot without surroundings gets a floor; a robot joint without a motor gets
    one.

    Args:
        path: MJCF or URDF file.
        robot: whose joints must all be there, found by name.
        timestep: physics step in [s], None for the model's own.

    Raises:
        ModelError: the file is wrong, or lacks a joint of the robot.
    """
    mujoco = import_mujoco()
    notes: list[str] = []
    is_urdf = path.suffix.lower() == ".urdf"
    spec = _read(mujoco, path, repaired_urdf(path, notes) if is_urdf else None)
    _drop_absent_meshes(spec, path, robot.kind in _FLOATING, notes)
    _drop_absent_textures(spec, path, notes)
    if is_urdf:
        spec.compiler.fusestatic = False  # fixed links keep their names: feet and sensor frames
        spec.option.timestep = _URDF_TIMESTEP
        # A URDF has no armature: with Euler's step the vendor's damping blows an A1 up.
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        if robot.kind in _FLOATING:
            _add_free_joint(mujoco, spec, notes)
    if timestep is not None:
        spec.option.timestep = float(timestep)
    if robot.kind in _FLOATING and not list(spec.worldbody.geoms):
        spec.worldbody.add_geom(
            name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0.0, 0.0, 0.05]
        )
        spec.worldbody.add_light(pos=[0.0, 0.0, 4.0])
        notes.append("the model has no surroundings: a floor was added")
    model = _compile(spec, path)
    joints = find_joints(_joint_names(mujoco, model), robot.joint_names, path)
    if _mend_actuators(mujoco, spec, model, joints, robot.joint_names, notes):
        model = _compile(spec, path)
    return LoadedModel(model, path, joints, notes)


def _read(mujoco: Any, path: Path, text: str | None) -> Any:
    try:
        if text is None:
            return mujoco.MjSpec.from_file(str(path))
        spec = mujoco.MjSpec.from_string(text)
    except ValueError as error:
        raise ModelError(f"model {path}: {_one_line(error)}; correct the file") from error
    spec.modelfiledir = f"{path.parent}/"  # a text has no folder to look for meshes in
    return spec


def _joint_names(mujoco: Any, model: Any) -> list[str]:
    kind = mujoco.mjtObj.mjOBJ_JOINT
    free = int(mujoco.mjtJoint.mjJNT_FREE), int(mujoco.mjtJoint.mjJNT_BALL)
    return [
        "" if model.jnt_type[i] in free else mujoco.mj_id2name(model, kind, i) or ""
        for i in range(model.njnt)
    ]


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())


def _compile(spec: Any, path: Path) -> Any:
    try:
        return spec.compile()
    except ValueError as error:
        raise ModelError(f"model {path}: {_one_line(error)}; correct the file") from error


def _mesh_places(path: Path, folder: Path, file: str) -> Iterator[Path]:
    """Yield where a mesh may be: in meshdir, beside the model, in the ROS package it names."""
    name = file.removeprefix("package://")
    yield folder / name
    yield path.parent / name
    yield folder / Path(name).name
    if name != file:
        package, _, rest = name.partition("/")
        for above in path.parents:
            yield above / name
            if above.name == package:
                yield above / rest


def _drop_absent_meshes(spec: Any, path: Path, floats: bool, notes: list[str]) -> None:
    folder = path.parent / (spec.compiler.meshdir or spec.meshdir or "")
    absent: dict[str, Any] = {}
    for mesh in spec.meshes:
        if not mesh.file or mesh.file in spec.assets:
            continue
        readable = Path(mesh.file).suffix.lower() in _MESHES
        there = (place for place in _mesh_places(path, folder, mesh.file) if place.is_file())
        found = next(there, None) if readable else None
        if found is None:
            absent[mesh.name or Path(mesh.file).stem] = mesh
        elif mesh.file.startswith("package://"):
            mesh.file = str(found.resolve())
    if not absent:
        return
    dropped = colliding = 0
    for geom in list(spec.geoms):
        if geom.meshname in absent:
            dropped += 1
            colliding += bool(geom.contype or geom.conaffinity)
            _delete(spec, geom)
    for mesh in absent.values():
        _delete(spec, mesh)
    note = (
        f"{len(absent)} mesh files are absent (first: {next(iter(absent.values())).file}): "
        f"{dropped} geoms left out, {colliding} of them may collide"
    )
    own = (g for g in spec.geoms if g.parent != spec.worldbody)
    if floats and not any(geom.contype or geom.conaffinity for geom in own):
        note += "; nothing else of it does, so it falls through the floor: add the files"
    notes.append(note)
    warnings.warn(f"model {path}: {note}", stacklevel=4)


def _drop_absent_textures(spec: Any, path: Path, notes: list[str]) -> None:
    folder = path.parent / (spec.compiler.texturedir or spec.texturedir or "")
    absent = [
        texture
        for texture in spec.textures
        for file in (texture.file, *texture.cubefiles)
        if file and not (folder / file).is_file()
    ]
    names = {texture.name or Path(texture.file).stem for texture in absent}
    if not absent:
        return
    for material in spec.materials:
        material.textures = ["" if name in names else name for name in material.textures]
    notes.append(f"{len(names)} textures are absent ({', '.join(sorted(names))}): left out")
    for texture in {id(texture): texture for texture in absent}.values():
        _delete(spec, texture)


def _delete(spec: Any, element: Any) -> None:
    if hasattr(spec, "delete"):
        spec.delete(element)
    else:  # mujoco < 3.3.3
        element.delete()


def _add_free_joint(mujoco: Any, spec: Any, notes: list[str]) -> None:
    root = spec.worldbody.first_body()
    if root is not None and not list(root.joints):
        root.add_freejoint(name="floating_base")
        root.pos = [0.0, 0.0, 1.0]
        notes.append(f"a URDF has no floating base: body {root.name!r} got a free joint")


def _mend_actuators(
    mujoco: Any,
    spec: Any,
    model: Any,
    joints: Sequence[int],
    names: Sequence[str],
    notes: list[str],
) -> bool:
    """Give each joint a motor without dynamics of its own; return whether the spec was changed."""
    changed = False
    driven = {
        int(model.actuator_trnid[i, 0]): i
        for i in reversed(range(model.nu))
        if model.actuator_trntype[i] in joint_transmissions(mujoco)
    }
    added: list[str] = []
    for name, joint in zip(names, joints):
        target = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, joint)
        if joint not in driven:
            actuator = spec.add_actuator(
                name=f"unicon_{name}", target=target, trntype=mujoco.mjtTrn.mjTRN_JOINT
            )
            actuator.set_to_motor()
            added.append(name)
            changed = True
        elif model.actuator_dyntype[driven[joint]] != int(mujoco.mjtDyn.mjDYN_NONE):
            actuator = spec.actuators[driven[joint]]
            actuator.dyntype = mujoco.mjtDyn.mjDYN_NONE
            actuator.actdim = 0
            actuator.actlimited = mujoco.mjtLimited.mjLIMITED_FALSE
            actuator.actrange = [0.0, 0.0]
            notes.append(f"the actuator of {name} has dynamics of its own: they were left out")
            changed = True
    if added:
        notes.append(f"motors were added to {len(added)} joints without one: {', '.join(added)}")
    if changed:
        for key in spec.keys:  # their controls and activations no longer fit
            key.ctrl = []
            key.act = []
    return changed
