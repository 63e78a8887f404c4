"""What the model and a run show by themselves: it comes before any contract that would fit better.

A policy that falls is held up by many changes of its contract, by the right one and by others that
happen to calm it. What the model says without a run, its joints' own damping and the joints that
the policy neither moves nor sees, is no guess, so it is the culprit where undoing it is enough.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from unicon_core.check.gains import counted_twice
from unicon_core.check.result import PolicyResult
from unicon_core.check.subject import listed
from unicon_core.check.twin.measures import Measures
from unicon_core.check.twin.perturb import Change
from unicon_core.figures import figure, span
from unicon_core.policies import PolicyContract
from unicon_core.robots import Robot, joint_index

PRESSING = 0.2
"""Share of a walk that a joint stays at a limit. Right contracts of ten published policies keep to
0.15 (T1's hip roll, whose effort limit is 25 N·m), nine of them to 0.00."""
_NEAR = 0.1
"""A default pose within this of a position limit in [rad] is to be there."""


def evident_changes(
    contract: PolicyContract, robot: Robot, passive: NDArray[np.float64], platform: str
) -> Iterator[Change]:
    """Yield the changes of the model for which the model itself speaks.

    Args:
        contract: of the policy, as given.
        robot: the robot.
        passive: damping of the robot's joints themselves in [N·m·s/rad], shape (n,).
        platform: name of the simulator.
    """
    own = passive[joint_index(contract.joints, robot.joint_names)]
    twice = counted_twice(contract.damping, own)
    if twice.size:
        i = twice[0]
        yield Change(
            "passive damping removed",
            "passive damping of the model",
            contract,
            undamped=True,
            evidence=f"{twice.size} of {len(own)} joints damp themselves beside the policy's "
            f"damping, {contract.joints[i]} by {own[i]:g} and {contract.damping[i]:g} N·m·s/rad",
            remedy=f"let the policy's damping replace it (platforms: {{{platform}: {{passive: "
            "replace}}), or correct <joint damping> of the model",
        )
    unseen = tuple(name for name in robot.joint_names if name not in contract.joints)
    if unseen:
        yield Change(
            "the other joints welded",
            "joints of the model that the policy does not know",
            contract,
            locked=unseen,
            evidence=f"it neither moves nor sees {listed(unseen)}, {len(unseen)} of "
            f"{robot.num_joints} joints, which give way here",
            remedy="take the model that it was trained on, or hold these joints as stiffly",
        )


def find_pressing(policy: PolicyResult, robot: Robot, given: Measures) -> None:
    """Find joints that a run which stayed up kept at their limit of effort or position."""
    if given.saturated_share >= PRESSING:
        policy.find(
            "twin.saturated",
            f"effort of {given.saturated_joint}",
            f"the joint is at its effort limit for {given.saturated_share:.0%} of the time, and "
            f"targets change at {given.target_rate:.2f} rad/s: its motor does not follow",
            "compare stiffness, damping, period and action.scale with the training side, and the "
            "joint's effort limit with the motor's",
        )
    pose = dict(zip(policy.contract.joints, policy.contract.default_joint_pos))
    for joint, share in given.limit_hits.items():
        i = robot.joint_names.index(joint)
        rest = float(pose.get(joint, robot.default_joint_pos[i]))
        if share < PRESSING or not robot.lower[i] + _NEAR < rest < robot.upper[i] - _NEAR:
            continue
        policy.find(
            "twin.saturated",
            f"position of {joint}",
            f"the joint is at its position limit for {share:.0%} of the time "
            f"({span(robot.lower[i], robot.upper[i])} rad, default {figure(rest)})",
            "compare default pose, action.scale and the joint's limits with the training side",
        )
