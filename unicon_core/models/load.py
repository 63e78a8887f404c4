"""Loads a model file (MJCF or URDF) whatever it lacks: meshes, a floor, a floating base, motors.

What ROS reads over in public URDF files and MuJoCo refuses is repaired, a walking robot gets a
floor, which gets the name by which `<pair>` elements call it, and joints that no policy moves may
be absent.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from unicon_base import ModelError, RobotError, one_line
from unicon_base.arrays import Array, Float64
from unicon_core.models.absent import drop_absent_meshes, drop_absent_textures, repaired_urdf
from unicon_core.models.bounded import refuse_endless, refuse_not_finite
from unicon_core.models.find import attach_members, pick_model
from unicon_core.models.loaded import LoadedModel, drives, find_joints, import_mujoco, simple_joints
from unicon_core.robots import Robot, joint_index


def actuator_kind(model: Any, i: int) -> str:
    """Return what an actuator is: `motor`, `position`, `velocity` or `general`."""
    mujoco = import_mujoco()
    bias = model.actuator_biastype[i]
    if model.actuator_gaintype[i] != int(mujoco.mjtGain.mjGAIN_FIXED):
        return "general"
    if bias == int(mujoco.mjtBias.mjBIAS_NONE):
        return "motor"
    if bias != int(mujoco.mjtBias.mjBIAS_AFFINE):
        return "general"
    if model.actuator_biasprm[i, 1] != 0.0:
        return "position"
    return "velocity" if model.actuator_biasprm[i, 2] != 0.0 else "motor"


def effort_ranges(loaded: LoadedModel, limit: Array) -> tuple[Float64, Float64]:
    """Return the torques in [N·m] between which each joint's motor stays, infinite for no limit.

    They are the tightest of the robot file's, and in the model of the control range of a motor, the
    actuator's force range and the joint's.

    Args:
        loaded: the model, its actuators as the file has them.
        limit: the largest torques that the robot file says, NaN for none, shape (n,).

    Returns:
        Lower and upper, shape (n,) each.
    """
    model = loaded.model
    driven = drives(loaded.model)
    lower, upper = np.full((2, len(loaded.joints)), np.inf)
    lower *= -1.0
    for k, (joint, effort) in enumerate(zip(loaded.joints, limit)):
        actuator = driven[joint][0]
        gear = float(model.actuator_gear[actuator, 0])
        ends = []
        if np.isfinite(effort):
            ends.append((-float(effort), float(effort)))
        if model.actuator_ctrllimited[actuator] and actuator_kind(model, actuator) == "motor":
            gain = model.actuator_gainprm[actuator, 0]
            ends.append(model.actuator_ctrlrange[actuator] * gain * gear)
        if model.actuator_forcelimited[actuator]:
            ends.append(model.actuator_forcerange[actuator] * gear)
        if model.jnt_actfrclimited[joint]:
            ends.append(model.jnt_actfrcrange[joint])
        if ends:
            lower[k], upper[k] = np.min(ends, axis=1).max(), np.max(ends, axis=1).min()
    return lower, upper


def mend_actuators(
    spec: Any, model: Any, joints: Sequence[int], names: Sequence[str], notes: list[str]
) -> bool:
    """Give each joint a motor without dynamics of its own; return whether the spec was changed."""
    mujoco = import_mujoco()
    driven = drives(model)
    changed = False
    added: list[str] = []
    for name, joint in zip(names, joints):
        if joint not in driven:
            actuator = spec.add_actuator(
                name=f"unicon_{name}",
                target=model.joint(joint).name,
                trntype=mujoco.mjtTrn.mjTRN_JOINT,
            )
            actuator.set_to_motor()
            added.append(name)
            changed = True
        elif model.actuator_dyntype[driven[joint][0]] != int(mujoco.mjtDyn.mjDYN_NONE):
            actuator = spec.actuators[driven[joint][0]]
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
    there = []
    absent = []
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
        body.mass = _MASS
        body.inertia = [_INERTIA] * 3
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
