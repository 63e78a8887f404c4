"""Finds the model file that a workflow or a robot file names, and attaches the members' models."""

from __future__ import annotations

import os
import pkgutil
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any, Protocol, runtime_checkable

import numpy as np

from unicon_base import (
    AnyDict,
    MissingDependencyError,
    ModelError,
    alternatives,
    imported,
    one_line,
)
from unicon_base.resources import find_resource
from unicon_core.models.loaded import import_mujoco
from unicon_core.robots import Robot
from unicon_core.robots.robot import MODEL_FORMATS, plain_name
from unicon_core.terrain.words import Terrain

_PREFIX = "robot_descriptions:"
_PACKAGE = "robot_descriptions"


@runtime_checkable
class Modelled(Protocol):
    """A platform that simulates a model file: frames, cameras, feet and checks read the same one.

    Attributes:
        model_path: MJCF or URDF, as `find_model` found it.
    """

    model_path: Path


def model_of(platform: object, robot: Robot) -> Path:
    """Return the file that a platform simulates; of a platform without one the robot's own MJCF.

    Raises:
        ModelError: there is none.
    """
    return platform.model_path if isinstance(platform, Modelled) else pick_model(robot)


def terrain_of(platform: object) -> Terrain | None:
    """Return the ground that a platform simulates; None for flat, and where it tells none."""
    found = getattr(platform, "terrain", None)
    return found if isinstance(found, Terrain) else None


def pick_model(
    robot: Robot, given: str | Path | None = None, relative_to: Path | None = None
) -> Path:
    """Return the model file for a robot: the one given, else the best one of its robot file.

    Args:
        robot: says its own.
        given: as for `find_model`; None for the robot's own.
        relative_to: folder of the file that gives it.

    Raises:
        ModelError: there is none.
    """
    if given is not None:
        return find_model(given, relative_to)
    if robot.members:
        base, *others = robot.members
        loose = [member for member in others if member not in robot.mounts]
        if loose:
            places = ", ".join(f"{member}: …" for member in robot.members)
            raise ModelError(
                f"robot {robot.name} is made of members, and nothing says where {loose[0]} sits on "
                f"{robot.members[base].name}; let the workflow say it: scene: {{mounts: "
                f"{{{loose[0]}: {{body: …}}}}}}, name a model of the whole: scene: {{model: "
                f"PATH}}, or give each member a platform: platform: {{{places}}}"
            )
        return pick_model(robot.members[base])
    found = next((robot.models[kind] for kind in MODEL_FORMATS if kind in robot.models), None)
    if found is None:
        raise ModelError(
            f"robot {robot.name} names no model ({' or '.join(MODEL_FORMATS)}); put one beside "
            f"{robot.path} and add models: {{mjcf: FILE}} ({{urdf: FILE}} for a URDF), or let the "
            "workflow name one anywhere: scene: {model: PATH}"
        )
    return find_model(found, robot.path.parent)


def find_model(reference: str | Path, relative_to: Path | None = None) -> Path:
    """Return the MJCF or URDF file that a reference means.

    Args:
        reference: a path, `assets:PATH`, `package://PACKAGE/PATH`, or `robot_descriptions:NAME`
            for a description of that package (robot-descriptions/robot_descriptions.py: a module
            for each, with `MJCF_PATH` or `URDF_PATH`), which it downloads when it is used for the
            first time.
        relative_to: folder of the file that names it, for a relative path.

    Raises:
        ModelError: nothing there, or it could not be downloaded.
        MissingDependencyError: robot_descriptions is asked for and not installed.
    """
    text = str(reference)
    if not text.startswith(_PREFIX):
        return find_resource(text, "model", error=ModelError, relative_to=relative_to)
    name = text.removeprefix(_PREFIX)
    if not name.isidentifier():
        raise ModelError(f"model {text!r} is not a description; write {_PREFIX}go2_mj_description")
    module = _description(name, f"model {text!r}")
    for key in ("MJCF_PATH", "URDF_PATH"):
        path = Path(str(getattr(module, key, "")))
        if os.path.isfile(path):
            return path.resolve()
    raise ModelError(
        f"model {text!r}: the description has no MJCF or URDF file; choose one that has, such as "
        "go2_mj_description"
    )


def _description(name: str, what: str) -> ModuleType:
    package = imported(_PACKAGE, what)
    try:
        return import_module(f"{_PACKAGE}.{name}")
    except ModuleNotFoundError as error:
        if error.name != f"{_PACKAGE}.{name}":
            missing = str(error.name)
            raise MissingDependencyError(what, missing, f"pip install {missing}") from error
        found = [module.name for module in pkgutil.iter_modules(package.__path__)]
        known = [each for each in found if each.endswith("_description")]
        raise ModelError(f"{what}: no such description; {alternatives(name, known)}") from error
    except Exception as error:  # whatever its download raises: git, the network, the disk
        raise ModelError(
            f"{what}: robot_descriptions could not fetch it: {one_line(error)[:200]}; "
            "connect to the network, or give a file by path"
        ) from error


# [kg·m²]; 0.01 s of the servo's 1 N·m·s/rad: it does not show in how a hand moves.
_ROTOR = 0.01

# Name of a key frame, and joint to its part of `qpos`.
_Key = tuple[str, AnyDict]


def lacking_members(spec: Any, robot: Robot) -> list[str]:
    """Return the members with a mount of whose joints a model has none.

    Args:
        spec: the `MjSpec` of the body, or of the whole.
        robot: made of members.
    """
    there = {plain_name(joint.name) for joint in spec.joints}
    return [
        member
        for member in robot.mounts
        if member in robot.members
        and there.isdisjoint(map(plain_name, robot.joint_names[robot.joints_of(member)]))
    ]


def attach_members(
    spec: Any, robot: Robot, path: Path, read: Callable[[Robot, list[str]], Any], notes: list[str]
) -> None:
    """Attach the models of those members whose joints the body's model lacks.

    Masses, inertias, shapes, mimic joints and other constraints of a member's model are kept; its
    motors are left out, since the robot's commands turn its joints. Names stay as they are in the
    member's file, with `MEMBER_` in front of those that are taken already; joints are called as the
    robot calls them. Nothing of a member touches the body that carries it. Key frames keep the
    body's joints and have 0 for the member's.

    Args:
        spec: the `MjSpec` of the body, changed.
        robot: the whole.
        path: of the body's model, for messages.
        read: reads the model of a member, adding to the notes it is given.
        notes: what was done is added.

    Raises:
        ModelError: the body has no such part, or a member's model is missing or wrong.
    """
    members = lacking_members(spec, robot)
    if not members:
        return
    keys = _taken_keys(spec)
    for member in members:
        mount = robot.mounts[member]
        carrier = spec.body(mount.body)
        if carrier is None or mount.body == "world":
            known = [body.name for body in spec.bodies if body.name not in ("", "world")]
            raise ModelError(
                f"mounts.{member}: no body {mount.body!r} in {path}; "
                f"{alternatives(mount.body, known)}"
            )
        own: list[str] = []
        child = read(robot.members[member], own)
        notes += [f"{member}: {note}" for note in own]
        _attach_one(spec, robot, member, carrier, child)
        notes.append(f"{member}: {robot.members[member].name} attached to {mount.body}")
        if robot.members[member].position_controlled:
            _give_rotors(spec, robot, member, notes)
    if keys:
        _give_keys(spec, keys)


def _attach_one(spec: Any, robot: Robot, member: str, carrier: Any, child: Any) -> None:
    mount = robot.mounts[member]
    for each in (*child.actuators, *child.keys):
        child.delete(each)
    plain = not list(child.tendons)  # a tendon names its joints in words that cannot be changed
    own = robot.members[member].joint_names
    whole = robot.joint_names[robot.joints_of(member)]
    called = {plain_name(name): composed for name, composed in zip(own, whole)}
    taken = {
        kind: {each.name for each in getattr(spec, kind)} for kind in ("bodies", "joints", "sites")
    }
    prefix = f"{member}/"
    roots = [body.name for body in child.worldbody.bodies]
    frame = carrier.add_frame(pos=mount.position, quat=mount.quat)
    for body in list(child.worldbody.bodies):
        frame.attach_body(body, prefix, "")
    if not roots:
        raise ModelError(f"mounts.{member}: the model of {robot.members[member].name} has no body")
    names = {}
    if plain:
        for kind in taken:
            for each in getattr(spec, kind):
                if not each.name.startswith(prefix):
                    continue
                name = each.name.removeprefix(prefix)
                if kind == "joints":
                    name = called.get(plain_name(name), name)
                while name in taken[kind]:
                    name = f"{member}_{name}"
                taken[kind].add(name)
                names[kind, each.name] = name
                each.name = name
        _rename(spec, names)
    for body in [b for b in spec.bodies if _below(b, carrier)]:
        spec.add_exclude(bodyname1=carrier.name, bodyname2=body.name)


def _give_rotors(spec: Any, robot: Robot, member: str, notes: list[str]) -> None:
    """Give the driven joints of a hand that takes positions the rotors that its file leaves out.

    A finger of 4 g under the servo's damping alone is so stiff that the constraint solver lets its
    mimic joints run ahead of it.
    """
    own = robot.joint_names[robot.joints_of(member)]
    bare = [j for j in spec.joints if j.name in own and not float(np.max(j.armature))]
    for joint in bare:
        joint.armature = _ROTOR
    if bare:
        notes.append(f"{member}: {len(bare)} joints got a rotor of {_ROTOR:g} kg·m²")


def _below(body: Any, carrier: Any) -> bool:
    while body is not None and body.name != "world":
        body = body.parent
        if body is not None and body.name == carrier.name:
            return True
    return False


def _rename(spec: Any, names: dict[tuple[str, str], str]) -> None:
    """Bring what refers to renamed parts in step: constraints, exclusions and sensors."""
    mujoco = import_mujoco()
    for each in spec.equalities:
        kind = "joints" if each.type == mujoco.mjtEq.mjEQ_JOINT else "bodies"
        each.name1 = names.get((kind, each.name1), each.name1)
        each.name2 = names.get((kind, each.name2), each.name2)
    for each in spec.excludes:
        each.bodyname1 = names.get(("bodies", each.bodyname1), each.bodyname1)
        each.bodyname2 = names.get(("bodies", each.bodyname2), each.bodyname2)
    kinds = {
        int(mujoco.mjtObj.mjOBJ_BODY): "bodies",
        int(mujoco.mjtObj.mjOBJ_XBODY): "bodies",
        int(mujoco.mjtObj.mjOBJ_JOINT): "joints",
        int(mujoco.mjtObj.mjOBJ_SITE): "sites",
    }
    for each in spec.sensors:
        kind = kinds.get(int(each.objtype), "")
        each.objname = names.get((kind, each.objname), each.objname)


def _taken_keys(spec: Any) -> list[_Key]:
    """Take key frames out, which would no longer fit; return each."""
    if not list(spec.keys):
        return []
    model = spec.compile()
    places = _places(model)
    keys = [
        (model.key(i).name, {name: model.key_qpos[i][at].copy() for name, at in places.items()})
        for i in range(model.nkey)
    ]
    for key in list(spec.keys):
        spec.delete(key)
    return keys


def _give_keys(spec: Any, keys: list[_Key]) -> None:
    model = spec.compile()
    places = _places(model)
    for name, values in keys:
        qpos = np.array(model.qpos0)
        for joint, value in values.items():
            qpos[places[joint]] = value
        spec.add_key(name=name, qpos=qpos)


def _places(model: Any) -> dict[str, slice]:
    """Return where each joint stands in `qpos`."""
    starts = [*map(int, model.jnt_qposadr), model.nq]
    return {model.joint(j).name: slice(starts[j], starts[j + 1]) for j in range(model.njnt)}
