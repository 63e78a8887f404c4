"""Chain: what of a robot moves when some of its joints do, with frames and Jacobians, for IK.

Everything is told in the robot's base frame. The model that is moved has end effectors as bodies,
and capsules as its only shapes. Kept apart are those that moved joints move against each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from unicon_base import RobotError, WorkflowError, alternatives
from unicon_base.arrays import Array, Bool, Float64, Index
from unicon_core.models.load import load_model
from unicon_core.models.loaded import LoadedModel, bodies_above, dofs_above, import_mujoco, index_of
from unicon_core.robots import Robot


class Chain:
    """Moved joints, k of them, and the frames of end effectors, E of them.

    Args:
        loaded: by `load_reaching`.
        robot: whose joints they are.
        effectors: names of end effectors, length E.
        moved: places of the moved joints in the robot's order, rising, shape (k,).

    Attributes:
        loaded: the model.
        data: its `MjData`, up to date after `put`.
        moved: as given.
        dofs: of the moved joints in the model, shape (k,).
        carries: which moved joints carry which end effector, shape (E, k).
        jacobian: of each end effector's position [m] and orientation [rad], by the moved joints, in
            axes of the base, shape (E, 6, k); after `differentiate`.

    Raises:
        WorkflowError: no moved joint carries an end effector.
    """

    def __init__(
        self, loaded: LoadedModel, robot: Robot, effectors: Sequence[str], moved: Index
    ) -> None:
        self._mujoco = mujoco = import_mujoco()
        model = self._model = loaded.model
        self.loaded, self.moved = loaded, moved
        self.data = mujoco.MjData(model)
        ids = [int(loaded.joints[i]) for i in moved]
        self.dofs = np.array(model.jnt_dofadr[ids], np.intp)
        self._qpos = self.data.qpos
        self._all = index_of(loaded.addresses.tolist())
        self._own = index_of(model.jnt_qposadr[ids].tolist())
        self._columns = index_of(self.dofs.tolist())
        bodies = [model.body(FRAME + each).id for each in effectors]
        self._bodies = bodies
        self.carries = np.array([self.moved_by(body) for body in bodies])
        for effector, row in zip(effectors, self.carries):
            if not row.any():
                joints = [robot.joint_names[i] for i in moved]
                raise WorkflowError(
                    f"none of the joints that it moves carries {effector!r}; name others under "
                    f"moves than {', '.join(joints[:4])}{' …' if len(joints) > 4 else ''}"
                )
        self._places = [self.data.xpos[body] for body in bodies]
        self._quats = [self.data.xquat[body] for body in bodies]
        self._whole = np.zeros((len(bodies), 6, model.nv))
        self._rows = [(each[:3], each[3:]) for each in self._whole]
        self.jacobian = self._whole[..., self._columns]

    def moved_by(self, body: int) -> Bool:
        """Return which of the moved joints move a body of the model, shape (k,)."""
        return np.isin(self.dofs, dofs_above(self._model, body))

    def put(self, joint_pos: Array, own: Float64) -> None:
        """Put the joints somewhere.

        Args:
            joint_pos: of all joints in the robot's order in [rad], shape (n,).
            own: of the moved ones, which those of `joint_pos` do not count for, shape (k,).
        """
        self._qpos[self._all] = joint_pos
        self.move(own)

    def move(self, own: Float64) -> None:
        """Put the moved joints somewhere, in [rad], shape (k,)."""
        self._qpos[self._own] = own
        self._mujoco.mj_kinematics(self._model, self.data)

    def frame(self, effector: int) -> tuple[list[float], list[float]]:
        """Return position [m] and quaternion wxyz of an end effector in the base frame."""
        return self._places[effector].tolist(), self._quats[effector].tolist()

    def differentiate(self) -> None:
        """Bring `jacobian` up to date with where the joints stand."""
        mujoco, model, data = self._mujoco, self._model, self.data
        mujoco.mj_comPos(model, data)
        for body, (position, turn) in zip(self._bodies, self._rows):
            mujoco.mj_jacBody(model, data, position, turn, body)
        if not isinstance(self._columns, slice):
            np.take(self._whole, self._columns, axis=2, out=self.jacobian)


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
        spec.delete(pair)
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


# Margin in [m] within which all of a robot is.
_FAR = 1e2
# In [m]: pairs this much nearer than wanted at the default pose are so by their shape.
_BY_SHAPE = 1e-3


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
    left_out: tuple[tuple[str, str, float], ...] = ()


def load_apart(
    path: Path, robot: Robot, effectors: Sequence[str], moved: Index, apart: float
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
