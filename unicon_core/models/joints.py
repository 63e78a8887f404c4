"""Finds a robot's joints in a model by name, what turns them and the free joint above them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from unicon_core.errors import ModelError, alternatives

__all__ = ["drives", "find_joints", "free_joint", "joint_names"]


def _plain(name: str) -> str:
    """Return a joint name without namespace and without the ending `_joint`."""
    return name.rsplit("/", 1)[-1].removesuffix("_joint")


def find_joints(model_names: Sequence[str], wanted: Sequence[str], path: Path) -> list[int]:
    """Return the position of each wanted joint in the model's list.

    The exact name wins; else the one joint whose name is equal but for a namespace (`g1/…`) and
    the ending `_joint`.

    Args:
        model_names: names of the model's joints, "" for those that cannot be meant.
        wanted: names of the robot's joints.
        path: the model's file, for the message.

    Raises:
        ModelError: a joint is not there, or two would fit.
    """
    exact = {name: i for i, name in enumerate(model_names) if name}
    plain: dict[str, list[int]] = {}
    for name, i in exact.items():
        plain.setdefault(_plain(name), []).append(i)
    found: list[int] = []
    for name in wanted:
        fits = [exact[name]] if name in exact else plain.get(_plain(name), [])
        if not fits:
            raise ModelError(
                f"model {path} has no joint {name!r}; {alternatives(name, exact)}; "
                "rename it in the model, or choose the model of this robot (model: PATH)"
            )
        if len(fits) > 1:
            both = ", ".join(model_names[i] for i in fits)
            raise ModelError(
                f"model {path}: joint {name!r} could be any of {both}; "
                "give exactly one of them that name"
            )
        found.append(fits[0])
    return found


def joint_names(mujoco: Any, model: Any) -> list[str]:
    """Return the names of a model's joints, "" for free and ball joints, which no motor turns."""
    kinds = mujoco.mjtJoint
    others = int(kinds.mjJNT_FREE), int(kinds.mjJNT_BALL)
    return [
        "" if int(model.jnt_type[i]) in others else model.joint(i).name for i in range(model.njnt)
    ]


def free_joint(mujoco: Any, model: Any, joint: int) -> int | None:
    """Return the id of the free joint that carries a joint's body, None for a fixed base."""
    body = int(model.jnt_bodyid[joint])
    while body:
        first = int(model.body_jntadr[body])
        if first >= 0 and int(model.jnt_type[first]) == int(mujoco.mjtJoint.mjJNT_FREE):
            return first
        body = int(model.body_parentid[body])
    return None


def drives(mujoco: Any, model: Any) -> dict[int, list[int]]:
    """Return joint id to the ids of the actuators that turn it, in the model's order."""
    kinds = mujoco.mjtTrn  # its members do not equal the model's numbers: compare as int
    turning = int(kinds.mjTRN_JOINT), int(kinds.mjTRN_JOINTINPARENT)
    found: dict[int, list[int]] = {}
    for i in range(model.nu):
        if int(model.actuator_trntype[i]) in turning:
            found.setdefault(int(model.actuator_trnid[i, 0]), []).append(i)
    return found
