"""The action: reachable targets against limits, torque of one unit, and what reaches the motors."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import compress

import numpy as np

from unicon_base.arrays import Bool
from unicon_core.blocks.safety.limits import EffortLimits, JointLimits, VelocityLimits
from unicon_core.check.order import check_mirrored
from unicon_core.check.result import CheckResult, PolicyResult
from unicon_core.check.safety import has_limits
from unicon_core.check.subject import Subject, listed
from unicon_core.flow import Stage
from unicon_core.policies.contract import ActionKind
from unicon_core.robots import joint_index
from unicon_core.text_table import figure, figures, span, spans

PLAUSIBLE_ACTION = 1.0
"""Action that a trained policy reaches in every walk; used where the contract has no clip."""
UNIT_TORQUE = 2.0
"""Stiffness · scale over the effort limit: 0.25 in BeyondMimic's rule, 0.74 for the Go1 policy.
More is worth a look and may be right: a wrist of 5 N·m has 8 with a scale of 1."""
LARGEST_SCALE = 1.0
"""In [rad] for one unit of action: actions in radians have 1, published ones 0.07 to 1."""
ROUNDING = 1e-4
"""In [rad]: by how much a figure may be beyond a limit, which is often the same one rounded."""


def check_action(subject: Subject, result: CheckResult) -> None:
    """Add one table of reachable targets for each policy, and findings."""
    for policy in subject.policy_results(result):
        _action(subject, policy)
        action = policy.contract.action
        scale = np.abs(action.scale)
        check_mirrored(policy, "action.symmetry", "action.scale", action.joints, scale)


def _action(subject: Subject, policy: PolicyResult) -> None:
    robot, contract = subject.robot, policy.contract
    action = contract.action
    joints = action.joints
    offset, scale = action.offset.astype(np.float64), action.scale.astype(np.float64)
    bound = np.tile([[-PLAUSIBLE_ACTION], [PLAUSIBLE_ACTION]], (1, len(joints)))
    clip = bound if action.clip is None else action.clip.astype(np.float64)
    wide = np.abs(clip).max(axis=0) > 10.0  # a clip that only guards against blow-ups
    clip = np.where(wide, bound, clip)
    low, high = np.sort(offset + scale * clip, axis=0)
    own = joint_index(joints, robot.joint_names)
    speed, effort = (
        values[own].astype(np.float64) for values in (robot.velocity_limit, robot.effort_limit)
    )
    position, velocity = action.of_kind("position"), action.of_kind("velocity")
    most = np.where(velocity, speed, effort)
    lower = np.where(position, robot.lower[own].astype(np.float64), -most)
    upper = np.where(position, robot.upper[own].astype(np.float64), most)
    room = upper - lower
    at = joint_index(joints, contract.joints)
    stiffness, damping = (
        gains[at].astype(np.float64) for gains in (contract.stiffness, contract.damping)
    )
    gain = np.where(position, stiffness, np.where(velocity, damping, 1.0))
    share = np.abs(scale) * gain / effort
    outside = (low < lower - ROUNDING) | (high > upper + ROUNDING)
    unit = "" if action.kinds else " [rad]"
    columns: dict[str, Sequence[str]] = {"joint": joints}
    if action.kinds:
        columns["target"] = action.kinds
    columns |= {
        "offset": figures(offset),
        "scale": figures(scale),
        "action": spans(*clip),
        f"reach{unit}": spans(low, high, ".4g"),
        f"limits{unit}": spans(lower, upper, ".4g"),
        "torque/unit": [figure(each, ".2f") if np.isfinite(each) else "?" for each in share],
        "": ["outside" if each else "" for each in outside],
    }
    lines = [f"target = offset + scale · action; last action is the {action.feedback} one"]
    if action.clip is None or wide.any():
        lines.append(f"no clip that binds: shown is an action of ±{PLAUSIBLE_ACTION:g}")
    if action.kinds:
        lines.append("position in [rad], velocity in [rad/s], torque in [N·m]")
        lines.append("torque/unit: scale · stiffness (velocity: · damping), of the effort limit")
    else:
        lines.append("torque/unit: stiffness · scale as a share of the effort limit")
    policy.result.columns(f"Action of policy {policy.key}", columns, lines)
    idle = scale == 0.0
    if idle.all():
        policy.find(
            "action.scale",
            "action.scale",
            "it is 0: no joint could move",
        )
    elif idle.any():
        evidence = f"0 at {listed(compress(joints, idle))}: they stay at their offset"
        policy.note("action.scale", "action.scale", evidence)
    limp = np.flatnonzero(position & (stiffness == 0.0) & (scale != 0.0))
    if limp.size:
        i = limp[0]
        policy.find(
            "action.limp",
            "action.kind",
            f"{joints[i]} is given positions and its stiffness is 0: it does not go there "
            f"({limp.size} joints)",
        )
    jumps = np.flatnonzero(position & (np.abs(scale) > room))
    if jumps.size:
        i = jumps[0]
        # An action in radians (scale 1) may well span more than a narrow joint's range.
        policy.find(
            "action.scale",
            "action.scale",
            f"one unit of action moves {joints[i]} by {scale[i]:g} rad, and its whole range is "
            f"{room[i]:.4g} ({jumps.size} joints)",
            error=bool((np.abs(scale[jumps]) > LARGEST_SCALE + 1e-6).any()),
        )
    strong = np.flatnonzero(position & (share > UNIT_TORQUE))
    if strong.size:
        i = strong[0]
        policy.note(
            "action.torque",
            "action.scale and stiffness",
            f"one unit of action asks {joints[i]} for {stiffness[i]:g} · {scale[i]:g} = "
            f"{stiffness[i] * scale[i]:.3g} N·m, and its effort limit is {effort[i]:g} "
            f"({strong.size} joints)",
        )
    strange = (offset < lower - ROUNDING) | (offset > upper + ROUNDING)
    beyond = np.flatnonzero(position & strange)
    if beyond.size:
        i = beyond[0]
        policy.find(
            "action.offset",
            "action.offset",
            f"action 0 puts {joints[i]} at {figure(offset[i])} rad, its limits are "
            f"[{span(lower[i], upper[i], ', ', '.4g')}]",
        )
    _reach(subject, policy, outside)


# Of a target: its state, and the block that limits it, NAME_limits.
_KINDS: tuple[tuple[ActionKind, str, str, type], ...] = (
    ("position", "joint_pos_target", "joint", JointLimits),
    ("velocity", "joint_vel_target", "velocity", VelocityLimits),
    ("torque", "joint_effort_ff", "effort", EffortLimits),
)


def _reach(subject: Subject, policy: PolicyResult, outside: Bool) -> None:
    """Find targets that are not sent (a joint would stand still), and those that nothing limits."""
    action, program, where = policy.contract.action, subject.program, subject.document.where
    for kind, state, limits, block in _KINDS:
        own = action.of_kind(kind)
        sent = not program.has_platform or state in program.platform.facts.reads
        if action.kinds and own.any() and not sent:
            policy.find(
                "action.unsent",
                "",
                f"it gives {listed(compress(action.joints, own))} a {kind}, and platform "
                f"{program.platform.facts.name!r} does not send {state}",
                where=where("platform"),
            )
        far = outside & own
        if not far.any():
            continue
        text = (
            f"actions within the table reach beyond the {limits} limits of "
            f"{listed(compress(action.joints, far))}"
        )
        if has_limits(subject, block):
            policy.note("action.reach", "", f"{text}; {limits}_limits cuts them off")
            continue
        policy.find(
            "action.reach",
            "",
            f"{text}, and no {limits}_limits is in safety:",
            f"add {limits}_limits to safety",
            where("safety"),
        )


def check_fed(subject: Subject, result: CheckResult) -> None:
    """Find blocks whose torques a platform leaves out, such as `gravity`: the arms would sag."""
    platform, state = subject.program.platform, "joint_effort_ff"
    if not subject.program.has_platform or state in platform.facts.reads:
        return
    for block in subject.blocks:
        if block.stage is Stage.FLOW and state in block.amends:
            result.find(
                "action.unsent",
                f"block {block.name!r}",
                f"it adds torques, and platform {platform.facts.name!r} does not send {state}",
                where=block.where,
            )
