"""Finds a robot's joints in a model by name, for the MuJoCo loader."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from unicon_core.errors import ModelError, alternatives

__all__ = ["find_joints", "joint_transmissions"]


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


def joint_transmissions(mujoco: Any) -> tuple[int, int]:
    """Return the transmission types by which an actuator turns a joint."""
    kinds = mujoco.mjtTrn  # its members do not equal the model's numbers: compare as int
    return int(kinds.mjTRN_JOINT), int(kinds.mjTRN_JOINTINPARENT)
