"""Loads a model file (MJCF or URDF) whatever it lacks: meshes, a floor, a floating base, motors.

What ROS reads over in public URDF files and MuJoCo refuses is repaired, a walking robot gets a
floor, which gets the name by which `<pair>` elements call it, and joints that no policy moves may
be absent.
"""

from __future__ import annotations

import logging
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from unicon_base.errors import ModelError, RobotError, one_line
from unicon_core.models.absent import drop_absent_meshes, drop_absent_textures
from unicon_core.models.actuators import mend_actuators
from unicon_core.models.attach import attach_members
from unicon_core.models.bounded import refuse_endless, refuse_not_finite
from unicon_core.models.find import pick_model
from unicon_core.models.loaded import LoadedModel, find_joints, import_mujoco, simple_joints
from unicon_core.robots import Robot, joint_index

_log = logging.getLogger(__name__)

_URDF_TIMESTEP = 0.002  # [s]; MuJoCo's own default, said here since a URDF cannot say it


def load_model(
    path: Path,
    robot: Robot,
    timestep: float | None = None,
    *,
    quiet: bool = False,
    prepare: Callable[[Any], None] | None = None,
) -> LoadedModel:
    """Read and compile a model for a robot.

    Visual and collision meshes whose files are absent are left out, which `absent` tells; mistakes
    of public URDF files that ROS reads over are mended. A URDF of a robot that walks gets a free
    joint; a walking robot without surroundings gets a floor, by the name that its pairs give it; a
    robot joint without a motor gets one. Joints that the robot calls weldable may be absent: they
    stand still. Of a robot made of members the models of those that have a mount, and whose joints
    the file lacks, are attached to it.

    Args:
        path: MJCF or URDF file.
        robot: whose joints must all be there, found by name.
        timestep: physics step in [s], None for the model's own.
        quiet: log nothing: somebody else has loaded it and told.
        prepare: changes the `MjSpec`, mended, before it is compiled.

    Raises:
        ModelError: the file is wrong, or lacks a joint of the robot.
    """
    notes: list[str] = []
    absent: dict[Path, str] = {}
    shapes: dict[str, list[str]] = {}

    def read(path: Path, notes: list[str], floats: bool) -> Any:
        spec = _read(path, notes)
        lacking = drop_absent_meshes(spec, path, floats, shapes)
        for note in lacking:
            absent[path] = note
            if not quiet:
                _log.info("model %s: %s", path, note)
        notes += [*lacking, *drop_absent_textures(spec, path)]
        return spec

    spec = read(path, notes, robot.floats)
    if path.suffix.lower() == ".urdf":
        spec.option.timestep = _URDF_TIMESTEP
        # A URDF has no armature: with Euler's step the vendor's damping blows an A1 up.
        spec.option.integrator = import_mujoco().mjtIntegrator.mjINT_IMPLICITFAST
        if robot.floats:
            _add_free_joint(spec, notes)
    if timestep is not None:
        spec.option.timestep = float(timestep)
    if robot.floats:
        mend_floor(spec, notes)
    if robot.mounts and robot.members:

        def member(own: Robot, told: list[str]) -> Any:
            return read(pick_model(own), told, floats=False)

        with _told(path):
            attach_members(spec, robot, path, member, notes)
    if prepare is not None:
        prepare(spec)
    model = _compiled(spec, path)
    welded = weld_absent(spec, model, robot, notes) if robot.weldable else ()
    if welded:
        model = _compiled(spec, path)
    joints = find_joints(model, robot, path)
    if mend_actuators(spec, model, joints, robot.joint_names, notes):
        model = _compiled(spec, path)
    refuse_not_finite(path, model)
    arm = np.zeros(3)
    if robot.imu is not None:
        arm[...] = np.nan_to_num(robot.imu.position)
    return LoadedModel(model, path, joints, notes, welded, absent, shapes, arm)


def _read(path: Path, notes: list[str]) -> Any:
    mujoco = import_mujoco()
    refuse_endless(path)
    is_urdf = path.suffix.lower() == ".urdf"
    text = repaired_urdf(path, notes) if is_urdf else None
    with _told(path):
        if text is None:
            spec = mujoco.MjSpec.from_file(str(path))
        else:
            spec = mujoco.MjSpec.from_string(text)
            spec.modelfiledir = f"{path.parent}/"  # a text has no folder to look for meshes in
    if is_urdf:
        spec.compiler.fusestatic = False  # fixed links keep their names: feet and sensor frames
    return spec


def _compiled(spec: Any, path: Path) -> Any:
    with _told(path):
        return spec.compile()


@contextmanager
def _told(path: Path) -> Iterator[None]:
    """Tell what MuJoCo finds wrong in a file as a ModelError."""
    try:
        yield
    except ValueError as error:
        raise ModelError(f"model {path}: {one_line(error)}; correct the file") from error
    except (RuntimeError, MemoryError) as error:  # of C++, which has no words for it
        raise ModelError(
            f"model {path}: MuJoCo gives it up, most likely for want of memory; make it smaller"
        ) from error


def _add_free_joint(spec: Any, notes: list[str]) -> None:
    root = spec.worldbody.first_body()
    if root is not None and not list(root.joints):
        root.add_freejoint(name="floating_base")
        root.pos = [0.0, 0.0, 1.0]
        notes.append(f"a URDF has no floating base: body {root.name!r} got a free joint")


FLOOR = "floor"


def mend_floor(spec: Any, notes: list[str]) -> None:
    """Add a floor where a model has no surroundings, and let pairs that name another one name it.

    A robot's file that its author includes into scenes may name the scene's floor, whatever that is
    called; without the scene MuJoCo would refuse the pair.

    Args:
        spec: the `MjSpec`.
        notes: what was changed is added.
    """
    kinds = import_mujoco().mjtGeom
    # MuJoCo lets bodies that stand still alone have planes and height fields.
    planes = [geom for geom in spec.geoms if geom.type == kinds.mjGEOM_PLANE]
    fields = [geom for geom in spec.geoms if geom.type == kinds.mjGEOM_HFIELD]
    names = {geom.name for geom in spec.geoms}
    ends = [(pair, key) for pair in spec.pairs for key in ("geomname1", "geomname2")]
    lost = [(pair, key) for pair, key in ends if getattr(pair, key) not in names]
    called = list(dict.fromkeys(getattr(pair, key) for pair, key in lost))
    if not (list(spec.worldbody.geoms) or planes or fields):
        name = called[0] if called else FLOOR
        while name in names:
            name += "_"
        floor = spec.worldbody.add_geom(name=name, type=kinds.mjGEOM_PLANE, size=[0.0, 0.0, 0.05])
        spec.worldbody.add_light(pos=[0.0, 0.0, 4.0])
        planes.append(floor)
        notes.append("the model has no surroundings: a floor was added")
    grounds = planes or fields
    # Two names that are not there in one pair are not a robot's foot on a floor: MuJoCo tells.
    alone = [
        (pair, key)
        for pair, key in lost
        if not {pair.geomname1, pair.geomname2} <= {*called} and len(grounds) == 1
    ]
    if not alone:
        return
    if not grounds[0].name:
        grounds[0].name = called[0]
    for pair, key in alone:
        setattr(pair, key, grounds[0].name)
    said = ", ".join(called)
    notes.append(f"{len(alone)} pairs name {said}, which is not in the model: taken as its floor")


_MASS, _INERTIA = 1e-6, 1e-9  # [kg], [kg·m²]: nothing that the robot feels
_ARMATURE, _DAMPING = 1e4, 1e6  # [kg·m²], [N·m·s/rad]: 100 N·m turn it by 1e-4 rad/s


def weld_absent(spec: Any, model: Any, robot: Robot, notes: list[str]) -> tuple[str, ...]:
    """Add a joint that stands still for each weldable joint that a model lacks; return those.

    Each carries a body of 1 mg at the robot's base, which collides with nothing. A model that has
    none of the robot's joints, or lacks one that a policy moves, is left as it is.

    Args:
        spec: the `MjSpec`, changed.
        model: compiled of it.
        robot: whose joints are looked for, `weldable` among them.
        notes: is added to.
    """
    ids = simple_joints(model)
    names = list(ids)
    there, absent = [], []
    for name in robot.joint_names:
        try:
            there.append(ids[names[joint_index([name], names, loose=True)[0]]])
        except RobotError:
            absent.append(name)
    if not absent or not there or not robot.weldable.issuperset(absent):
        return ()
    root = int(model.body_rootid[model.jnt_bodyid[there[0]]])
    base = spec.body(model.body(root).name)
    last = int(model.body_rootid[model.jnt_bodyid[model.njnt - 1]]) == root
    for name in absent:
        body = base.add_body(name=f"unicon_{name}")
        body.explicitinertial = True
        body.mass, body.inertia = _MASS, [_INERTIA] * 3
        body.add_joint(
            name=name,
            type=import_mujoco().mjtJoint.mjJNT_HINGE,
            armature=_ARMATURE,
            damping=_DAMPING,
        )
    for key in list(spec.keys):
        if last and len(key.qpos) == model.nq:  # the new joints come behind all others
            key.qpos = [*key.qpos, *[0.0] * len(absent)]
            key.qvel = []
        else:
            spec.delete(key)
    notes.append(f"the model lacks {', '.join(absent)}: taken as welded")
    return tuple(absent)


_ONCE = ("origin", "geometry", "material", "inertial", "mass", "inertia")
_TERMS = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")


def repaired_urdf(path: Path, notes: list[str]) -> str | None:
    """Return the text of a URDF with its mistakes mended, None where there are none.

    Mended are elements that stand twice (two materials in the visuals of Unitree's Go2), inertias
    that no body can have (Robotera's XHand repeats one figure six times; of a camera of ANYbotics'
    ANYmal C two principal moments sum to less than the third), and shapes without an extent.

    Args:
        path: the file.
        notes: gets one line for each kind of mistake.

    Raises:
        ModelError: the file is not XML, or declares entities: no robot needs any, and they may grow
            without end or name other files.
    """
    try:
        raw = path.read_bytes()
        if b"\0" in raw:  # else entities could hide in another encoding, which MuJoCo cannot read
            raise ModelError(f"model {path}: it is not UTF-8; save it as that")
        text = raw.decode("utf-8-sig", "replace")
        if "<!ENTITY" in text or "<!DOCTYPE" in text:
            raise ModelError(f"model {path}: it has a DOCTYPE or entities; take them out")
        root = ET.fromstring(text)  # whatever encoding it declares: MuJoCo reads UTF-8
    except (ET.ParseError, OSError, ValueError, LookupError) as error:
        raise ModelError(f"model {path}: {error}; correct the file") from error
    twice = _drop_repeated(root)
    bodies = _mend_inertias(root)
    flat = _drop_flat(root)
    if twice:
        notes.append(f"{len(twice)} elements stand twice in the URDF (first: {twice[0]})")
    if bodies:
        notes.append(
            f"the inertia of {', '.join(bodies)} is none that a body can have: "
            "its largest figure stands for all axes"
        )
    if flat:
        notes.append(f"shapes without an extent are left out: {', '.join(flat)}")
    try:
        return ET.tostring(root, encoding="unicode") if twice or bodies or flat else None
    except RecursionError as error:
        raise ModelError(f"model {path}: its elements are nested too deep") from error


def _drop_repeated(root: ET.Element) -> list[str]:
    dropped = []
    for parent in root.iter():
        if parent.tag not in ("visual", "collision", "inertial", "link"):
            continue
        seen: set[str] = set()
        for child in list(parent):
            if child.tag in _ONCE and child.tag in seen:
                parent.remove(child)
                dropped.append(f"{child.tag} of a {parent.tag}")
            seen.add(child.tag)
    return dropped


def _mend_inertias(root: ET.Element) -> list[str]:
    mended = []
    for link in root.findall("link"):
        inertia = link.find("inertial/inertia")
        if inertia is None:
            continue
        try:
            xx, yy, zz, xy, xz, yz = (float(inertia.get(term, "0")) for term in _TERMS)
        except ValueError:
            continue  # MuJoCo names the line
        matrix = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        if not np.isfinite(matrix).all():
            continue  # MuJoCo refuses it
        if not matrix.any():
            continue  # MuJoCo takes it from mass and shapes, or says so
        small, middle, large = np.linalg.eigvalsh(matrix)
        if small > 1e-9 * abs(matrix).max() and small + middle >= large:
            continue
        for term in _TERMS:
            inertia.set(term, repr(float(abs(matrix).max())) if term[1] == term[2] else "0")
        mended.append(str(link.get("name")))
    return mended


def _drop_flat(root: ET.Element) -> list[str]:
    """Take shapes with a radius, length or edge of 0 out; return what was dropped."""
    dropped = []
    for link in root.findall("link"):
        for element in (*link.findall("visual"), *link.findall("collision")):
            shape = element.find("geometry/*")
            sizes = () if shape is None else map(shape.get, ("radius", "length", "size"))
            try:
                flat = any(0.0 in map(float, size.split()) for size in sizes if size)
            except ValueError:
                continue  # MuJoCo names the line
            if shape is not None and flat:
                link.remove(element)
                dropped.append(f"{shape.tag} in a {element.tag} of {link.get('name')}")
    return dropped
