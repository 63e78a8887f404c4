"""Orders of joints: mirror images told from names, and which order a contract's figures fit."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from itertools import chain, combinations

import numpy as np

from unicon_base.arrays import Float32, Index
from unicon_core.check.model_facts import joint_depths
from unicon_core.check.result import CheckResult, PolicyResult
from unicon_core.check.subject import Subject, listed
from unicon_core.models.loaded import LoadedModel
from unicon_core.robots import Robot, joint_index
from unicon_core.text_table import figure

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
    joints: Sequence[str], values: Float32, tolerance: float | None = None
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
    values: Float32,
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


POSE_TOLERANCE = 0.02
"""In [rad] or [m]: by how much a pose may differ between sides."""

Figures = dict[str, Float32]


def other_order(depths: Sequence[int]) -> Index:
    """Return the breadth-first order of joints given depth-first, and the inverse otherwise.

    Isaac Sim lists joints breadth-first (all hips, then all knees), MuJoCo and the vendors
    depth-first (leg by leg).

    Args:
        depths: in the kinematic tree, in the given order, shape (n,).
    """
    order = np.argsort(np.asarray(depths), kind="stable")
    if (np.diff(depths) >= 0).all():  # breadth-first already: back to a limb at a time
        count = max(1, int((np.asarray(depths) == depths[0]).sum()))
        order = np.concatenate([np.arange(limb, len(depths), count) for limb in range(count)])
    return order.astype(np.intp)


def joint_orders(
    joints: Sequence[str], robot: Robot, depths: Sequence[int]
) -> dict[str, list[str]]:
    """Return orders in which the same joints may have been meant, the likeliest first.

    Some may be the given one.

    Args:
        joints: in the given order.
        robot: gives an order.
        depths: of the joints in the kinematic tree, shape (n,).
    """
    limb_by_limb = [name for name in robot.joint_names if name in joints]
    by_depth, other = dict(zip(joints, depths)), other_order(depths)
    return {
        "the joint order of the other kind of simulator": [joints[i] for i in other],
        "that order undone": [joints[i] for i in np.argsort(other)],
        "the robot's joint order": limb_by_limb,
        "a breadth-first joint order": sorted(limb_by_limb, key=lambda name: by_depth[name]),
        "the reversed joint order": list(joints[::-1]),
    }


def check_order(subject: Subject, result: CheckResult) -> None:
    """Find contracts whose names stand in another order than all their figures.

    Each figure by itself would be told as not symmetric; that one order makes all of them so tells
    what happened.
    """
    model = subject.model
    if model is None:
        return
    for policy in subject.policy_results(result):
        _order(subject.robot, model, policy)


def _order(robot: Robot, model: LoadedModel, policy: PolicyResult) -> None:
    contract = policy.contract
    joints, action = contract.joints, contract.action
    figures: Figures = {
        "default_joint_pos": contract.default_joint_pos,
        "stiffness": contract.stiffness,
        "damping": contract.damping,
    }
    if action.joints == joints:
        figures["action.scale"] = action.scale
    # Gains may have an order of their own (that of motors): the others tell.
    odd = [name for name in figures if _odd(joints, {name: figures[name]})]
    if "default_joint_pos" not in odd:
        return
    told = {name: figures[name] for name in odd}
    pose, verb = contract.default_joint_pos, "is" if len(odd) == 1 else "are"

    def fits(order: Sequence[str]) -> bool:
        index = joint_index(order, robot.joint_names)
        outside = (pose < robot.lower[index] - 1e-4) | (pose > robot.upper[index] + 1e-4)
        return not outside.any() and not _odd(order, told)

    def find(evidence: str, remedy: str) -> None:
        culprit = f"joints (or {listed(odd)})"
        what = f"{listed(odd)} {verb} not the same on both sides; {evidence}"
        policy.find("joints.order", culprit, what, remedy)

    swaps = [swap for swap in _exchanges(joints, told) if fits(swap)]
    if swaps:  # several may fit: the robot's own pose tells which
        usual = robot.default_joint_pos

        def apart(order: list[str]) -> float:
            return float(np.abs(pose - usual[joint_index(order, robot.joint_names)]).sum())

        best = min(swaps, key=apart)
        both = " and ".join(old for old, new in zip(joints, best) if old != new)
        find(
            f"with {both} exchanged all of it is",
            f"exchange {both} in joints, or their figures",
        )
        return
    for name, order in joint_orders(joints, robot, joint_depths(model, robot, joints)).items():
        if fits(order):
            moved = [f"{new} for {old}" for old, new in zip(joints, order) if old != new]
            find(
                f"in {name} ({listed(moved)}) all of it is",
                "write joints in the order of the figures, or the figures in that of joints",
            )
            return


def _exchanges(joints: Sequence[str], figures: Figures) -> Iterator[list[str]]:
    """Yield the joints with two exchanged, of those that differ between the sides."""
    odd = [name for pair in _odd(joints, figures) for name in pair]
    for a, b in combinations(dict.fromkeys(odd), 2):
        yield [{a: b, b: a}.get(name, name) for name in joints]


def _odd(joints: Sequence[str], figures: Figures) -> list[tuple[str, str]]:
    """Return the pairs (left, right) of which a figure differs."""
    limits = {"default_joint_pos": POSE_TOLERANCE}
    found = (odd_pairs(joints, values, limits.get(what)) for what, values in figures.items())
    return list(chain(*found))
