"""Which capsules of a robot must not meet: those that moved joints move against each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.ik.chain import CAPSULE, Chain, Pair, load_reaching
from unicon_core.models.joints import bodies_above
from unicon_core.models.loaded import LoadedModel, import_mujoco
from unicon_core.robots import Robot

_FAR = 1e2
"""Margin in [m] within which all of a robot is."""
_BY_SHAPE = 1e-3
"""In [m]: pairs this much nearer than wanted at the default pose are so by their shape."""


@dataclass(frozen=True)
class Reaching:
    """A model whose pairs of capsules are those that are kept apart.

    Attributes:
        loaded: by `load_reaching`.
        pairs: of capsules, in the order of the model's.
        left_out: pairs that are nearer than wanted at the default pose, and how near in [m].
    """

    loaded: LoadedModel
    pairs: tuple[Pair, ...] = ()
    left_out: tuple[tuple[str, str, float], ...] = field(default=())


def load_apart(
    path: Path, robot: Robot, effectors: Sequence[str], moved: NDArray[np.intp], apart: float
) -> Reaching:
    """Load a robot's model with the pairs of capsules that its moved joints may bring together.

    Left out are capsules of one body, of a body and the next one above it that has capsules, those
    that no moved joint moves against each other, and those that are nearer than wanted at the
    robot's default pose.

    Args:
        path: MJCF or URDF file.
        robot: whose joints are in it.
        effectors: names of its `end_effectors`.
        moved: places of the moved joints in the robot's order, shape (k,).
        apart: distance that is wanted in [m]; 0 for no pairs.

    Raises:
        RobotError: the model lacks a body that the robot file names.
        ModelError: the file is wrong, or lacks a joint.
        WorkflowError: no moved joint carries an end effector.
    """
    if not apart or not robot.capsules:
        bare = replace(robot, capsules={})
        return Reaching(load_reaching(path, bare, effectors))
    loaded = load_reaching(path, robot, effectors)
    chain = Chain(loaded, robot, effectors, moved)
    pairs: list[Pair] = []
    left_out = []
    for one, other, distance in _distances(chain, robot):
        if not _meet(chain, one, other):
            continue
        names = _name(loaded.model, one), _name(loaded.model, other)
        if distance < apart - _BY_SHAPE:
            left_out.append((*names, distance))
        else:
            pairs.append(names)
    kept = load_reaching(path, robot, effectors, pairs)
    return Reaching(kept, tuple(pairs), tuple(left_out))


def _distances(chain: Chain, robot: Robot) -> list[tuple[int, int, float]]:
    """Return the geoms of each pair and their distance at the default pose in [m]."""
    model, data = chain.loaded.model, chain.data
    model.pair_margin[:], model.pair_gap[:] = _FAR, 0.0
    pose = robot.default_joint_pos.astype(np.float64)
    chain.put(pose, pose[chain.moved])
    import_mujoco().mj_collision(model, data)
    found = {(int(one), int(other)): _FAR for one, other in zip(model.pair_geom1, model.pair_geom2)}
    for (one, other), distance in zip(data.contact.geom.tolist(), data.contact.dist.tolist()):
        pair = (one, other) if (one, other) in found else (other, one)
        found[pair] = min(found[pair], distance)
    return [(one, other, distance) for (one, other), distance in found.items()]


def _meet(chain: Chain, one: int, other: int) -> bool:
    """Whether moved joints move two geoms against each other, and they are not neighbours."""
    model = chain.loaded.model
    a, b = int(model.geom_bodyid[one]), int(model.geom_bodyid[other])
    if (chain.moved_by(a) == chain.moved_by(b)).all():
        return False
    carriers = {
        int(model.geom_bodyid[g])
        for g in range(model.ngeom)
        if model.geom(g).name.startswith(CAPSULE)
    }
    return _next_above(model, carriers, a) != b and _next_above(model, carriers, b) != a


def _next_above(model: Any, carriers: set[int], body: int) -> int:
    """Return the next body above another that carries a capsule."""
    above = bodies_above(model, int(model.body_parentid[body]))
    return next((each for each in above if each in carriers), 0)


def _name(model: Any, geom: int) -> str:
    return str(model.geom(geom).name).removeprefix(CAPSULE)
