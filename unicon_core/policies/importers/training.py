"""What the training configurations share: period, command ranges, joints and values by pattern.

A value by pattern stands as Isaac Lab writes it: a number, or {pattern: number}. Joints are chosen
as its `SceneEntityCfg` does: by `joint_names`, which are patterns, in the articulation's order
unless `preserve_order` is set, else by `joint_ids`.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping, Sequence
from typing import Any

from unicon_base.errors import alternatives
from unicon_base.located_yaml import Tagged
from unicon_core.policies.facts import Facts, value_of

# A command's name in legged_gym and holosoma -> its name in a contract.
RENAMED_RANGES = {"ang_vel_yaw": "ang_vel_z"}
_ALL = "slice(None, None, None)"  # as Isaac Lab dumps it


def say_period(facts: Facts, document: Any, step: str, decimation: str) -> None:
    """Note the control period, the simulation's step times the decimation, where both are there.

    Args:
        facts: changed in place.
        document: the source.
        step: where the time of a step in [s] stands.
        decimation: where the steps for one action stand.
    """
    dt, steps = value_of(document, step), value_of(document, decimation)
    if isinstance(dt, (int, float)) and isinstance(steps, int):
        facts.say("period", dt * steps, f"{step} · {decimation}")


def say_ranges(facts: Facts, document: Any, key: str) -> None:
    """Note the command's ranges that stand under a key, if any do."""
    ranges = command_ranges(value_of(document, key))
    if ranges:
        facts.say("command_ranges", ranges)


def command_ranges(ranges: Any) -> dict[str, list[Any]]:
    """Return the name of a command to [lowest, highest]; what is not a pair is left out."""
    items: Mapping[str, Any] = ranges if isinstance(ranges, Mapping) else {}
    return {
        RENAMED_RANGES.get(name, name): list(pair)
        for name, pair in items.items()
        if isinstance(pair, (list, tuple)) and len(pair) == 2
    }


def clip_before_scale(pair: Sequence[float], scale: Sequence[float]) -> list[list[float]]:
    """Return the bounds before scaling of a term that is scaled first, then clipped.

    `clip(scale · x) = scale · clip(x)` with the bounds divided by the scale; where that is 0, any
    bounds do.

    Args:
        pair: lowest and highest after scaling.
        scale: factors, shape (d,).

    Returns:
        All the lowest, all the highest.
    """
    sides = [sorted(bound / s for bound in pair) if s else list(pair) for s in scale]
    return [list(side) for side in zip(*sides)]


def _matches(pattern: object, joint: str) -> bool:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", FutureWarning)  # about brackets; the result is the same
            return re.fullmatch(str(pattern), joint) is not None
    except re.error:
        return False


def matching(patterns: Sequence[object], joints: Sequence[str]) -> list[str]:
    """Return the joints whose whole name matches one of the patterns, in joint order."""
    return [joint for joint in joints if any(_matches(p, joint) for p in patterns)]


def stated_order(chosen: Any) -> list[str] | None:
    """Return the joints where they are named one by one in an order that is kept, else None.

    Args:
        chosen: holds `joint_names` and `preserve_order`.
    """
    names = _names(chosen)
    said = bool(names) and all(re.fullmatch(r"[\w/-]+", name) for name in names)
    kept = isinstance(chosen, Mapping) and chosen.get("preserve_order") is True
    return list(dict.fromkeys(names)) if said and (kept or len(names) == 1) else None


def chosen_joints(chosen: Any, joints: Sequence[str]) -> list[str] | None:
    """Return the joints that `joint_names` and `preserve_order` choose; None: it has no names.

    Args:
        chosen: holds them.
        joints: all joints, in the articulation's order.

    Raises:
        ValueError: a name or pattern is none of the joints.
    """
    names = _names(chosen)
    for name in names:
        if not matching([name], joints):
            raise ValueError(
                f"joint_names has {name!r}, which is none of the joints; "
                f"{alternatives(name, joints)}"
            )
    if not names:
        return None
    if chosen.get("preserve_order") is True:
        return list(dict.fromkeys(joint for name in names for joint in matching([name], joints)))
    return matching(names, joints)


def chosen_ids(joint_ids: Any) -> list[int] | None:
    """Return the places that `joint_ids` chooses; None: all.

    Raises:
        ValueError: it is something else.
    """
    if joint_ids is None or joint_ids == _ALL or isinstance(joint_ids, Tagged):
        return None
    if not isinstance(joint_ids, list) or not all(isinstance(i, int) for i in joint_ids):
        raise ValueError(f"joint_ids is {joint_ids!r}; give places, or null")
    return joint_ids


def _names(chosen: Any) -> list[str]:
    names = chosen.get("joint_names") if isinstance(chosen, Mapping) else None
    return (
        list(map(str, names)) if isinstance(names, list) else [] if names is None else [str(names)]
    )


def values_by_pattern(
    value: Any, joints: Sequence[str], *, default: float | None = None, whole: bool = True
) -> list[float] | None:
    """Return one value for each joint, or None where a joint gets none.

    Args:
        value: a number, a list in joint order, or a mapping from a pattern to a number.
        joints: joint names.
        default: value of a joint that no pattern matches.
        whole: whether a pattern must match the whole name (Isaac Lab), or a part (legged_gym).
    """
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        return [float(value)] * len(joints)
    if isinstance(value, (list, tuple)) and len(value) == len(joints):
        numbers = [float(v) for v in value if isinstance(v, (int, float))]
        return numbers if len(numbers) == len(joints) else None
    if not isinstance(value, Mapping):
        return None
    result: list[float] = []
    for joint in joints:
        found = default
        for pattern, number in value.items():
            matches = _matches(pattern, joint) if whole else str(pattern) in joint
            if matches and isinstance(number, (int, float)):
                found = float(number)
                break
        if found is None:
            return None
        result.append(found)
    return result
