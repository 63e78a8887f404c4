"""Finds a robot's joints in a model by name, what turns them and the free joint above them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from unicon_core.errors import ModelError, RobotError, alternatives
from unicon_core.robots import Robot, joint_index


def find_joints(mujoco: Any, model: Any, robot: Robot, path: Path) -> list[int]:
    """Return the id of each robot joint in a model, in the robot's order, by name.

    A namespace and the ending `_joint` may differ. Free and ball joints are none of a robot's.

    Args:
        mujoco: the module.
        model: the `MjModel`.
        robot: whose joints must all be there.
        path: the model's file, for the message.

    Raises:
        ModelError: a joint is not there, or two would fit.
    """
    ids = simple_joints(mujoco, model)
    names = list(ids)
    try:
        return [ids[names[i]] for i in joint_index(robot.joint_names, names, loose=True)]
    except RobotError as error:
        raise ModelError(
            f"model {path}: {error}; rename it in the model, or choose the model of this robot "
            "(scene: {model: PATH})"
        ) from error


def is_simple(mujoco: Any, model: Any, joint: int) -> bool:
    """Return whether a joint has one axis, about which it turns or along which it slides."""
    kinds = mujoco.mjtJoint
    return model.jnt_type[joint] in (int(kinds.mjJNT_HINGE), int(kinds.mjJNT_SLIDE))


def simple_joints(mujoco: Any, model: Any) -> dict[str, int]:
    """Return name to number of the joints with one axis, in the model's order."""
    simple = (i for i in range(model.njnt) if is_simple(mujoco, model, i))
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


def free_joint(mujoco: Any, model: Any, joint: int) -> int | None:
    """Return the id of the free joint that carries a joint's body, None for a fixed base."""
    for body in bodies_above(model, int(model.jnt_bodyid[joint])):
        first = int(model.body_jntadr[body])
        if first >= 0 and model.jnt_type[first] == int(mujoco.mjtJoint.mjJNT_FREE):
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


def drives(mujoco: Any, model: Any) -> dict[int, list[int]]:
    """Return joint id to the ids of the actuators that turn it, in the model's order."""
    kinds = mujoco.mjtTrn  # its members do not equal the model's numbers: compare as int
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
    gear, bias = float(model.actuator_gear[actuator, 0]), model.actuator_biasprm[actuator]
    return (-bias[1] * gear**2, -bias[2] * gear**2) if bias[1] < 0.0 else None
