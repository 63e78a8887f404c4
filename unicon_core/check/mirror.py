"""Which joints are each other's mirror image, told from their names, and checks of symmetry."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from unicon_core.check.result import PolicyResult
from unicon_core.check.subject import listed
from unicon_core.figures import figure

ROUNDING = 0.02
"""Relative difference by which mirrored figures may differ (exports round to 3 decimals)."""

# Unitree, Fourier, AgiBot, Booster (left_…), quadrupeds (FL_…), short forms (l_…, …_l).
_SIDES = (
    (r"(^|_)left(?=_|$)", r"\g<1>right"),
    (r"(^|_)Left(?=_|$)", r"\g<1>Right"),
    (r"(^|_)LEFT(?=_|$)", r"\g<1>RIGHT"),
    (r"(^|_)([FRHM])L(?=_|$)", r"\g<1>\g<2>R"),
    (r"(^|_)L([FHMR])(?=_|$)", r"\g<1>R\g<2>"),
    (r"(^|_)l(?=_|$)", r"\g<1>r"),
    (r"(^|_)L(?=_|$)", r"\g<1>R"),
)


def mirror_pairs(names: Sequence[str]) -> list[tuple[str, str]]:
    """Return pairs (left, right) of joints, in the order of the left ones.

    Args:
        names: joint names in any order.
    """
    known = set(names)
    pairs = []
    for name in names:
        for pattern, other in _SIDES:
            right = re.sub(pattern, other, name, count=1)
            if right != name and right in known:
                pairs.append((name, right))
                break
    return pairs


def odd_pairs(
    joints: Sequence[str], values: NDArray[np.float32], tolerance: float | None = None
) -> list[tuple[str, str]]:
    """Return the pairs (left, right) whose values are not the same size; as `check_mirrored`."""
    sides = dict(zip(joints, map(float, values)))
    limits = (ROUNDING, 1e-6) if tolerance is None else (0.0, tolerance)
    return [
        (left, right)
        for left, right in mirror_pairs(joints)
        if not np.isclose(abs(sides[left]), abs(sides[right]), *limits)
    ]


def check_mirrored(
    policy: PolicyResult,
    code: str,
    what: str,
    joints: Sequence[str],
    values: NDArray[np.float32],
    tolerance: float | None = None,
) -> None:
    """Find values that are not the same size on both sides: they are in another order.

    Args:
        policy: is added to.
        code: of the finding.
        what: the values are in the contract.
        joints: whose values they are.
        values: one for each joint.
        tolerance: by which sides may differ; None for `ROUNDING` of the figure.
    """
    sides = dict(zip(joints, map(float, values)))
    odd = odd_pairs(joints, values, tolerance)
    if odd:
        left, right = odd[0]
        more = f" (and {len(odd) - 1} more pairs)" if len(odd) > 1 else ""
        policy.find(
            code,
            what,
            f"{left} has {figure(sides[left])} and {right} has {figure(sides[right])}{more}",
            f"bring {what} into the order of joints: {listed(joints, 3)}",
        )
