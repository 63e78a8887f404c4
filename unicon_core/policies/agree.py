"""Do two sources of one policy say the same? Policy and configuration must not drift apart."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from unicon_core.figures import figure
from unicon_core.policies.facts import Facts, dig, says
from unicon_core.robots.joint_index import plain_name

_VECTORS = ("default_joint_pos", "stiffness", "damping", "action.scale")


def check_agreement(facts: Facts, other: Facts, given: Mapping[str, Any]) -> None:
    """Compare what a file says with the metadata of the network that it names, joint by joint.

    Args:
        facts: what is going to be used.
        other: what the network's metadata say.
        given: what the user says settles it; a note tells the difference.

    Raises:
        PolicyError: a joint's number differs by more than the rounding of both sources.
    """
    joints, names = facts.values.get("joints"), other.values.get("joints")
    if not isinstance(joints, list) or not isinstance(names, list):
        return
    mine_of = {plain_name(str(name)): name for name in joints}  # a robot's names, with _joint
    names = [mine_of.get(plain_name(str(name)), name) for name in names]
    unknown = [name for name in joints if name not in names]
    if unknown:
        raise facts.error(
            ("joints",),
            f"joint {unknown[0]!r} is not in the metadata of {other.path.name}, which has "
            f"{', '.join(map(str, names))}; contract and network do not belong together",
        )
    relative, absolute = map(max, facts.tolerance, other.tolerance)
    for key in _VECTORS:
        mine, theirs = _by_joint(facts.values, key, joints), _by_joint(other.values, key, names)
        if mine is None or theirs is None:
            continue
        for joint in joints:
            a, b = mine.get(joint), theirs.get(joint)
            if a is None or b is None:
                continue
            if np.isclose(a, b, rtol=relative, atol=absolute):
                continue
            differs = (
                f"{key} of {joint} is {figure(a)} here and {figure(b)} in the metadata of "
                f"{other.path.name}"
            )
            if not says(given, key):
                raise facts.error(
                    tuple(key.split(".")),
                    f"{differs}; correct one of them, or export both again",
                )
            facts.notes.append(f"{facts.path.name}: {differs}; what is given counts")
            break


def _by_joint(values: Mapping[str, Any], key: str, joints: list[str]) -> dict[str, float] | None:
    value, moved = dig(values, *key.split(".")), dig(values, "action", "joints")
    if key == "action.scale" and isinstance(moved, list):
        joints = moved
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return dict.fromkeys(joints, float(value))
    if isinstance(value, (list, tuple)) and len(value) == len(joints):
        try:
            return {joint: float(v) for joint, v in zip(joints, value)}
        except (TypeError, ValueError):
            return None
    return None
