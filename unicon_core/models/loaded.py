"""A compiled model: where a robot's joints are in it, which geoms may touch; for all who use one.

Joints are found by name; what turns them and the free joint above them by the model's numbers.
"""

from __future__ import annotations

import importlib
import logging
import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.lib.stride_tricks import as_strided

from unicon_base import MissingDependencyError, ModelError, RobotError, alternatives
from unicon_base.arrays import Array, Bool, Float64, Index
from unicon_core.robots import Robot, joint_index

_log = logging.getLogger(__name__)

_GL = "MUJOCO_GL"
# Where `GLContext` is, in newer versions of MuJoCo and in older ones.
_CONTEXTS = ("mujoco.rendering.classic.gl_context", "mujoco.gl_context")


def import_mujoco() -> Any:
    """Return the mujoco module.

    It comes without its window library, which takes a sixth of its import (glfw asks a process of
    its own for its version): what draws asks for that by itself, as `mujoco.Renderer` and
    `mujoco.viewer` do. A `MUJOCO_GL` that is set is left as it is.

    Raises:
        MissingDependencyError: it is not installed.
    """
    try:
        mujoco = sys.modules.get("mujoco") or _imported()
    except ModuleNotFoundError as error:
        raise MissingDependencyError(
            "platform 'mujoco'", "mujoco", "pip install 'unicon_ros[sim]'"
        ) from error
    if mujoco.get_mju_user_warning() is None:  # else MuJoCo writes MUJOCO_LOG.TXT where we stand
        mujoco.set_mju_user_warning(_log.info)
    return mujoco


def _imported() -> Any:
    if os.environ.get(_GL):
        return importlib.import_module("mujoco")
    os.environ[_GL] = "disabled"
    try:
        mujoco: Any = importlib.import_module("mujoco")
    finally:
        del os.environ[_GL]
    context: Any = next((sys.modules[name] for name in _CONTEXTS if name in sys.modules), None)
    if context is not None:

        def late(name: str) -> Any:
            """Return what drawing asks for, as `import mujoco` would have left it."""
            if name != "GLContext":
                raise AttributeError(f"mujoco has no attribute {name!r} here")
            found: Any = vars(importlib.reload(context))[name]
            del context.__getattr__, mujoco.__getattr__
            mujoco.GLContext = found
            return found

        context.__getattr__ = mujoco.__getattr__ = late
    return mujoco


@dataclass
class LoadedModel:
    """A compiled model and how it was found.

    Attributes:
        model: the `MjModel`.
        path: its file.
        joints: joint id of each robot joint, in the robot's order, length n.
        notes: what was changed or left out, one line each.
        welded: joints of the robot that the model lacks and that stand still.
        absent: file of the model, or of a member's, to a line that says what was left out of it
            since mesh files are absent.
        absent_shapes: body to the mesh files, absent, of its geoms that may collide.
        imu_position: where the robot's IMU is, from the base's origin along its axes in [m], shape
            (3,); 0 where the robot file does not say.
    """

    model: Any
    path: Path
    joints: list[int]
    notes: list[str] = field(default_factory=list)
    welded: tuple[str, ...] = ()
    absent: Mapping[Path, str] = field(default_factory=dict)
    absent_shapes: Mapping[str, list[str]] = field(default_factory=dict)
    imu_position: Float64 = field(default_factory=lambda: np.zeros(3))

    @property
    def base(self) -> int | None:
        """Id of the free joint that carries the robot, None for a fixed base."""
        return free_joint(self.model, self.joints[0])

    @property
    def addresses(self) -> Index:
        """Where each robot joint stands in `qpos`, shape (n,)."""
        return np.array(self.model.jnt_qposadr[self.joints], np.intp)

    @property
    def dofs(self) -> Index:
        """Where each robot joint stands in `qvel`, shape (n,)."""
        return np.array(self.model.jnt_dofadr[self.joints], np.intp)

    def key_poses(self) -> dict[str, Float64]:
        """Return key frame to joint positions in the robot's order, [rad] or [m], shape (n,)."""
        model = self.model
        return {model.key(i).name: model.key_qpos[i][self.addresses] for i in range(model.nkey)}


def find_joints(model: Any, robot: Robot, path: Path) -> list[int]:
    """Return the id of each robot joint in a model, in the robot's order, by name.

    A namespace and the ending `_joint` may differ. Free and ball joints are none of a robot's.

    Args:
        model: the `MjModel`.
        robot: whose joints must all be there.
        path: the model's file, for the message.

    Raises:
        ModelError: a joint is not there, or two would fit.
    """
    ids = simple_joints(model)
    names = list(ids)
    try:
        return [ids[names[i]] for i in joint_index(robot.joint_names, names, loose=True)]
    except RobotError as error:
        raise ModelError(
            f"model {path}: {error}; rename it in the model, or choose the model of this robot "
            "(scene: {model: PATH})"
        ) from error


def is_simple(model: Any, joint: int) -> bool:
    """Return whether a joint has one axis, about which it turns or along which it slides."""
    kinds = import_mujoco().mjtJoint
    return model.jnt_type[joint] in (int(kinds.mjJNT_HINGE), int(kinds.mjJNT_SLIDE))


def simple_joints(model: Any) -> dict[str, int]:
    """Return name to number of the joints with one axis, in the model's order."""
    simple = (i for i in range(model.njnt) if is_simple(model, i))
    return {name: i for i in simple if (name := model.joint(i).name)}


def bodies_above(model: Any, body: int) -> Iterator[int]:
    """Yield a body, then those that carry it, without the world."""
    while body:
        yield body
        body = int(model.body_parentid[body])


def dofs_above(model: Any, body: int) -> list[int]:
    """Return the degrees of freedom between the world and a body, the nearest to it first."""
    found: list[int] = []
    for each in bodies_above(model, body):
        first = int(model.body_dofadr[each])
        found += reversed(range(first, first + int(model.body_dofnum[each])))
    return found


def free_joint(model: Any, joint: int) -> int | None:
    """Return the id of the free joint that carries a joint's body, None for a fixed base."""
    free = int(import_mujoco().mjtJoint.mjJNT_FREE)
    for body in bodies_above(model, int(model.jnt_bodyid[joint])):
        first = int(model.body_jntadr[body])
        if first >= 0 and model.jnt_type[first] == free:
            return first
    return None


def body_in(spec: Any, name: str, what: str, path: Path) -> Any:
    """Return a body of an `MjSpec` by its name.

    Args:
        spec: the model.
        name: of the body.
        what: names it, for the message.
        path: the model's file, likewise.

    Raises:
        ModelError: the model has no such body.
    """
    body = spec.body(name)
    if body is None:
        known = [each.name for each in spec.bodies if each.name]
        raise ModelError(f"{what}: no body {name!r} in {path}; {alternatives(name, known)}")
    return body


def drives(model: Any) -> dict[int, list[int]]:
    """Return joint id to the ids of the actuators that turn it, in the model's order."""
    kinds = import_mujoco().mjtTrn  # its members do not equal the model's numbers: compare as int
    turning = int(kinds.mjTRN_JOINT), int(kinds.mjTRN_JOINTINPARENT)
    found: dict[int, list[int]] = {}
    for i in range(model.nu):
        if model.actuator_trntype[i] in turning:
            found.setdefault(int(model.actuator_trnid[i, 0]), []).append(i)
    return found


def position_gains(model: Any, actuator: int) -> tuple[float, float] | None:
    """Return stiffness [N·m/rad] and damping [N·m·s/rad] of a position actuator at its joint.

    Args:
        model: the `MjModel`.
        actuator: its number.

    Returns:
        None for an actuator of another kind, such as a motor.
    """
    gear = float(model.actuator_gear[actuator, 0])
    bias = model.actuator_biasprm[actuator]
    return (-bias[1] * gear**2, -bias[2] * gear**2) if bias[1] < 0.0 else None


def index_of(positions: Sequence[int]) -> slice | Index:
    """Return positions as a slice where they are consecutive (a copy is then 3x cheaper)."""
    first = positions[0]
    if list(positions) == list(range(first, first + len(positions))):
        return slice(first, first + len(positions))
    return np.array(positions, np.intp)


def rows_of(source: Array, index: Index) -> tuple[Array, Callable[[], object] | None]:
    """Return rows of an array, and what brings them up to date; None where they are a view of it.

    Legs that are alike have regular numbers in a model: 0.9 µs less for each such array.

    Args:
        source: of any shape; the rows are those of its first axis.
        index: numbers of rows, one or two axes; negative ones stand for any row.
    """
    axes = list(enumerate(index.shape))
    steps = [int(np.diff(index, axis=axis).flat[0]) if n > 1 else 0 for axis, n in axes]
    first = int(index.flat[0])
    grid = first + sum(step * i for step, i in zip(steps, np.indices(index.shape)))
    if (index == grid).all() and index.min() >= 0:
        strides = [step * source.strides[0] for step in steps]
        shape = index.shape + source.shape[1:]
        return as_strided(source[first:], shape, (*strides, *source.strides[1:])), None
    rows = np.empty(index.shape + source.shape[1:], source.dtype)
    return rows, partial(np.take, source, index, 0, rows, "clip")


class Contact(NamedTuple):
    """What MuJoCo makes of two geoms that touch."""

    dimensions: int
    friction: Float64
    """Of sliding, turning and rolling, shape (3,)."""


def solid(model: Any, geom: int) -> bool:
    """Return whether a geom may touch anything at all.

    Args:
        model: an `MjModel`.
        geom: its number.
    """
    if model.geom_contype[geom] or model.geom_conaffinity[geom]:
        return True
    return bool((model.pair_geom1 == geom).any() or (model.pair_geom2 == geom).any())


def may_touch(model: Any, one: int, other: int) -> bool:
    """Return whether two geoms may touch each other; see `solid`."""
    if (
        model.geom_contype[one] & model.geom_conaffinity[other]
        or model.geom_contype[other] & model.geom_conaffinity[one]
    ):
        return True
    firsts = model.pair_geom1
    seconds = model.pair_geom2
    named = ((firsts == one) & (seconds == other)) | ((firsts == other) & (seconds == one))
    return bool(np.any(named))


def contact_of(model: Any, one: int, other: int) -> Contact:
    """Return the contact of two geoms: a `<pair>`'s, else that of the higher priority, else both's.

    https://mujoco.readthedocs.io/en/stable/modeling.html#contact-parameters
    """
    for pair in range(model.npair):
        if {model.pair_geom1[pair], model.pair_geom2[pair]} == {one, other}:
            sliding, _, turning, rolling, _ = model.pair_friction[pair]
            return Contact(int(model.pair_dim[pair]), np.array((sliding, turning, rolling)))
    both = [one, other]
    ranks = model.geom_priority[both]
    dims = model.geom_condim[both]
    friction = model.geom_friction[both]
    if ranks[0] != ranks[1]:
        first = int(np.argmax(ranks))
        return Contact(int(dims[first]), np.array(friction[first]))
    return Contact(int(dims.max()), friction.max(axis=0))


def still(model: Any) -> list[int]:
    """Return the geoms of the world and of the bodies that are fixed to it."""
    return np.flatnonzero(model.body_weldid[model.geom_bodyid] == 0).tolist()


def floors(model: Any) -> list[int]:
    """Return the planes that stand still."""
    plane = int(import_mujoco().mjtGeom.mjGEOM_PLANE)
    return [i for i in still(model) if model.geom_type[i] == plane]


def around(loaded: LoadedModel) -> list[int]:
    """Return what a robot may touch around it and is no floor: solid geoms that stand still."""
    model = loaded.model
    ours = _ours(loaded)
    planes = floors(model)
    others = (geom for geom in still(model) if geom not in planes and not ours[geom])
    return [geom for geom in others if solid(model, geom)]


def on_floor(loaded: LoadedModel) -> list[int]:
    """Return the robot's geoms that may touch a floor."""
    model = loaded.model
    planes = floors(model)
    own = (geom for geom in np.flatnonzero(_ours(loaded)).tolist() if geom not in planes)
    return [geom for geom in own if any(may_touch(model, floor, geom) for floor in planes)]


def _ours(loaded: LoadedModel) -> Bool:
    """Return which geoms are the robot's, shape (ngeom,)."""
    model = loaded.model
    root = model.body_rootid[model.jnt_bodyid[loaded.joints[0]]]
    ours: Bool = model.body_rootid[model.geom_bodyid] == root
    return ours


def multiply(a: Float64, b: Float64) -> Float64:
    """Return the product of two quaternions wxyz, shape (…, 4)."""
    aw, av, bw, bv = a[..., :1], a[..., 1:], b[..., :1], b[..., 1:]
    real = aw * bw - (av * bv).sum(axis=-1, keepdims=True)
    return np.concatenate((real, aw * bv + bw * av + np.cross(av, bv)), axis=-1)


def rotate(quat: Float64, vector: Float64) -> Float64:
    """Return a vector turned by a unit quaternion wxyz, shape (3,)."""
    w, u = quat[0], quat[1:]
    return vector + 2.0 * np.cross(u, np.cross(u, vector) + w * vector)


def about(axis: Float64, angle: float) -> Float64:
    """Return the unit quaternion wxyz of a turn by an angle [rad] about a unit vector."""
    return np.concatenate(([np.cos(0.5 * angle)], np.sin(0.5 * angle) * axis))
