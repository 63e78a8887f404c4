"""The model that inverse kinematics moves: end effectors as bodies, capsules as its only shapes."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from unicon_core.errors import RobotError, alternatives
from unicon_core.models.absent import delete
from unicon_core.models.load import load_model
from unicon_core.models.loaded import LoadedModel, import_mujoco
from unicon_core.robots import Robot

FRAME, CAPSULE = "unicon_frame_", "unicon_capsule_"
"""In front of the names of bodies and geoms that are added."""


Pair = tuple[str, str]
"""Names of two capsules."""


def load_reaching(
    path: Path, robot: Robot, effectors: Sequence[str], pairs: Sequence[Pair] | None = None
) -> LoadedModel:
    """Load a robot's model with its base at the origin, frames of end effectors and capsules.

    Each end effector's frame is a body, each capsule a geom. Of all shapes pairs of capsules alone
    are looked at.

    Args:
        path: MJCF or URDF file.
        robot: whose joints are in it.
        effectors: names of its `end_effectors`.
        pairs: of its capsules that are looked at; None for all of different bodies.

    Raises:
        RobotError: the model lacks a body that the robot file names.
        ModelError: the file is wrong, or lacks a joint.
        MissingDependencyError: MuJoCo is not installed.
    """

    def prepare(spec: Any) -> None:
        add_reaching(spec, robot, effectors, path)
        for one, other in _pairs(robot) if pairs is None else pairs:
            spec.add_pair(geomname1=CAPSULE + one, geomname2=CAPSULE + other, condim=1)

    loaded = load_model(path, robot, quiet=True, prepare=prepare)
    model = loaded.model
    model.opt.disableflags, model.opt.enableflags = 0, 0  # contacts are found, at our margins
    if loaded.base is not None:
        at = int(model.jnt_qposadr[loaded.base])
        model.qpos0[at : at + 7] = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
    else:
        _put_base(model, loaded.joints[0], robot.base_frame)
    return loaded


def _put_base(model: Any, joint: int, base_frame: str) -> None:
    """Put a base that is fixed at the origin: the body of its name, or else the model's world."""
    mujoco = import_mujoco()
    base = int(mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, base_frame))
    if base <= 0:
        return
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    root = int(model.body_rootid[model.jnt_bodyid[joint]])
    place, turn, back, away = np.zeros(3), np.zeros(4), np.zeros(3), np.zeros(4)
    mujoco.mju_negPose(back, away, data.xpos[base], data.xquat[base])
    mujoco.mju_mulPose(place, turn, back, away, data.xpos[root], data.xquat[root])
    model.body_pos[root], model.body_quat[root] = place, turn


def _pairs(robot: Robot) -> list[Pair]:
    each = combinations(robot.capsules, 2)
    return [(a, b) for a, b in each if robot.capsules[a].body != robot.capsules[b].body]


def add_reaching(spec: Any, robot: Robot, effectors: Sequence[str], path: Path) -> None:
    """Add end effectors and capsules to a model; of what it has itself nothing touches anything.

    Args:
        spec: the `MjSpec`, changed.
        robot: says where they are.
        effectors: names of its `end_effectors`.
        path: of the model, for messages.

    Raises:
        RobotError: the model lacks a body that the robot file names.
    """
    for effector in effectors:
        place = robot.end_effectors[effector]
        body = _body(spec, place.body, f"end effector {effector!r}", robot, path)
        body.add_body(name=FRAME + effector, pos=place.position, quat=place.quat)
    kinds = import_mujoco().mjtGeom
    for pair in list(spec.pairs):
        delete(spec, pair)
    for geom in spec.geoms:
        geom.contype = geom.conaffinity = 0
    for name, capsule in robot.capsules.items():
        body = _body(spec, capsule.body, f"capsule {name!r}", robot, path)
        sphere = capsule.start == capsule.end
        geom = body.add_geom(
            name=CAPSULE + name,
            type=kinds.mjGEOM_SPHERE if sphere else kinds.mjGEOM_CAPSULE,
            size=[capsule.radius, 0.0, 0.0],
            contype=0,
            conaffinity=0,
            density=0.0,
        )
        if sphere:
            geom.pos = capsule.start
        else:
            geom.fromto = [*capsule.start, *capsule.end]


def _body(spec: Any, name: str, what: str, robot: Robot, path: Path) -> Any:
    body = spec.body(name)
    if body is None:
        ours = ("", "world", *(FRAME + effector for effector in robot.end_effectors))
        known = [each.name for each in spec.bodies if each.name not in ours]
        raise RobotError(
            f"robot {robot.name}: {what} is on body {name!r}, which model {path} lacks; "
            f"{alternatives(name, known)}; correct {robot.path}"
        )
    return body
