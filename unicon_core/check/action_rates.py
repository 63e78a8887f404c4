"""Velocities and torques of a policy: whether they reach the motors, and what limits them."""

from __future__ import annotations

from itertools import compress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.blocks.safety.limits import EffortLimits
from unicon_core.blocks.safety.speeds import VelocityLimits
from unicon_core.check.result import CheckResult, PolicyResult
from unicon_core.check.safety import has_limits
from unicon_core.check.subject import Subject, listed
from unicon_core.flow import Stage

_STATES = {
    "position": "joint_pos_target",
    "velocity": "joint_vel_target",
    "torque": "joint_effort_ff",
}


def check_rates(subject: Subject, policy: PolicyResult, outside: NDArray[np.bool_]) -> None:
    """Add findings for actions that are not all positions.

    Args:
        subject: of the check.
        policy: its contract has kinds of actions.
        outside: joints whose targets reach beyond the limits, shape (m,).
    """
    action = policy.contract.action
    if subject.program.has_platform:
        _sent(subject, policy)
    for kind, limits, block in (
        ("velocity", "velocity", VelocityLimits),
        ("torque", "effort", EffortLimits),
    ):
        far = outside & np.array([each == kind for each in action.kinds])
        if not far.any():
            continue
        names = listed(compress(action.joints, far))
        text = f"actions within the table reach beyond the {limits} limits of {names}"
        if has_limits(subject, block):
            policy.note("action.reach", "", f"{text}; {limits}_limits cuts them off")
            continue
        policy.result.find(
            "action.reach",
            f"policy {policy.key!r}",
            f"{text}, and no {limits}_limits is in safety:",
            f"add {limits}_limits to safety",
            subject.document.where("safety"),
        )


def check_fed(subject: Subject, result: CheckResult) -> None:
    """Find blocks whose torques a platform leaves out, such as `gravity`: the arms would sag."""
    platform, state = subject.program.platform, _STATES["torque"]
    if not subject.program.has_platform or state in platform.facts.reads:
        return
    for block in subject.blocks:
        if block.stage is Stage.FLOW and state in block.amends:
            result.find(
                "action.unsent",
                f"block {block.name!r}",
                f"it adds torques, and platform {platform.facts.name!r} does not send {state}",
                f"leave {block.name!r} out, or choose a map or platform that sends it",
                block.where,
            )


def _sent(subject: Subject, policy: PolicyResult) -> None:
    """A platform or map that leaves out what the policy commands: a joint would stand still."""
    platform: Any = subject.program.platform
    for kind, state in _STATES.items():
        moved = [
            name
            for name, each in zip(policy.contract.action.joints, policy.contract.action.kinds)
            if each == kind
        ]
        if moved and state not in platform.facts.reads:
            policy.result.find(
                "action.unsent",
                f"policy {policy.key!r}",
                f"it gives {listed(moved)} a {kind}, and platform {platform.facts.name!r} does not "
                f"send {state}",
                "choose a map or platform that sends it, or a policy that gives something else",
                subject.document.where("platform"),
            )
