"""Values by joint-name pattern, as Isaac Lab writes them: a number, or {pattern: number}."""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping, Sequence
from typing import Any

__all__ = ["matching", "values_by_pattern"]


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
    if isinstance(value, list) and len(value) == len(joints):
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
