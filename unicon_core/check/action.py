"""The action: reachable targets against limits, torque of one unit, period, command ranges."""

from __future__ import annotations

from typing import Any

import numpy as np

from unicon_core.check.mirror import check_mirrored
from unicon_core.check.result import CheckResult
from unicon_core.check.safety import limits_targets
from unicon_core.check.subject import Subject, listed
from unicon_core.platforms.platform import info_of
from unicon_core.policies import PolicyContract
from unicon_core.robots import joint_index

__all__ = ["check_action", "check_timing"]

PLAUSIBLE_ACTION = 1.0
"""Action that a trained policy reaches in every walk; used where the contract has no clip."""
UNIT_TORQUE = 2.0
"""Stiffness · scale over the effort limit: 0.25 in BeyondMimic's rule, 0.74 for the Go1 policy.
More is worth a look and may be right: a wrist of 5 N·m has 8 with a scale of 1."""
LARGEST_SCALE = 1.0
"""In [rad] for one unit of action: actions in radians have 1, published ones 0.07 to 1."""
_AXES = ("lin_vel_x", "lin_vel_y", "ang_vel_z")


def check_action(subject: Subject, result: CheckResult) -> None:
    """Add one table of reachable targets for each policy, and findings."""
    for key, contract in subject.policies.items():
        _action(subject, result, key, contract)
        culprit, action = (key, "action.scale"), contract.action
        check_mirrored(
            result, "action.symmetry", culprit, contract, action.joints, np.abs(action.scale)
        )


def _action(subject: Subject, result: CheckResult, key: str, contract: PolicyContract) -> None:
    robot, action = subject.robot, contract.action
    bound = np.tile([[-PLAUSIBLE_ACTION], [PLAUSIBLE_ACTION]], (1, len(action.joints)))
    clip = bound if action.clip is None else action.clip.astype(np.float64)
    wide = np.abs(clip).max(axis=0) > 10.0  # a clip that only guards against blow-ups
    clip = np.where(wide, bound, clip)
    reach = np.sort(action.offset + action.scale * clip, axis=0)
    rows, outside, offsets, idle, jumps, torques = [], [], [], [], [], []
    beyond = False
    from_robot = joint_index(action.joints, robot.joint_names)
    from_policy = joint_index(action.joints, contract.joints)
    for i, (name, j, k) in enumerate(zip(action.joints, from_robot, from_policy)):
        lower, upper = float(robot.lower[j]), float(robot.upper[j])
        offset, scale = float(action.offset[i]), float(action.scale[i])
        low, high = reach[:, i]
        effort = float(robot.effort_limit[j])
        share = abs(scale) * float(contract.stiffness[k]) / effort
        if low < lower - 1e-4 or high > upper + 1e-4:
            outside.append(name)
        if offset < lower - 1e-4 or offset > upper + 1e-4:
            offsets.append((name, offset, lower, upper))
        if scale == 0.0:
            idle.append(name)
        if abs(scale) > upper - lower:
            jumps.append((name, scale, upper - lower))
            beyond |= abs(scale) > LARGEST_SCALE + 1e-6
        if share > UNIT_TORQUE:
            torques.append((name, contract.stiffness[k], scale, effort))
        rows.append(
            [
                name,
                f"{offset:g}",
                f"{scale:g}",
                f"{clip[0, i]:g} … {clip[1, i]:g}",
                f"{low:.4g} … {high:.4g}",
                f"{lower:.4g} … {upper:.4g}",
                f"{share:.2f}" if np.isfinite(share) else "?",
                "outside" if name in outside else "",
            ]
        )
    columns = ["joint", "offset", "scale", "action", "reach [rad]", "limits [rad]", "torque/unit"]
    assumed = action.clip is None or bool(wide.any())
    lines = [f"target = offset + scale · action; last action is the {action.feedback} one"]
    if assumed:
        lines.append(f"no clip that binds: shown is an action of ±{PLAUSIBLE_ACTION:g}")
    lines.append("torque/unit: stiffness · scale as a share of the effort limit")
    result.table(f"Action of policy {key}", [*columns, ""], rows, lines)
    where = contract.path
    if len(idle) == len(action.joints):
        result.find(
            "action.scale",
            f"policy {key!r}, action.scale",
            "it is 0: no joint could move",
            "give the scale that it was trained with, in [rad]",
            where,
        )
    elif idle:
        result.note(
            "action.scale",
            f"policy {key!r}, action.scale",
            f"0 at {listed(idle)}: they stay at their offset",
        )
    if jumps:
        name, scale, span = jumps[0]
        # An action in radians (scale 1) may well span more than a narrow joint's range.
        result.find(
            "action.scale",
            f"policy {key!r}, action.scale",
            f"one unit of action moves {name} by {scale:g} rad, and its whole range is {span:.4g} "
            f"({len(jumps)} joints)",
            "give the scale that it was trained with, in [rad]",
            where,
            error=beyond,
        )
    if torques:
        name, stiffness, scale, effort = torques[0]
        result.note(
            "action.torque",
            f"policy {key!r}, action.scale and stiffness",
            f"one unit of action asks {name} for {stiffness:g} · {scale:g} = "
            f"{stiffness * scale:.3g} N·m, and its effort limit is {effort:g} "
            f"({len(torques)} joints)",
        )
    if offsets:
        name, offset, lower, upper = offsets[0]
        result.find(
            "action.offset",
            f"policy {key!r}, action.offset",
            f"action 0 puts {name} at {offset:g} rad, its limits are [{lower:.4g}, {upper:.4g}]",
            "correct the offset (the default pose) or the robot's limits",
            where,
        )
    if outside:
        limited = limits_targets(subject)
        text = f"actions within the table reach beyond the limits of {listed(outside)}"
        if limited:
            result.note("action.reach", f"policy {key!r}", f"{text}; joint_limits cuts them off")
        else:
            result.find(
                "action.reach",
                f"policy {key!r}",
                f"{text}, and no joint_limits is in safety:",
                "add joint_limits to safety",
                subject.document.where("safety"),
            )


def check_timing(subject: Subject, result: CheckResult) -> None:
    """Add the table of rates; an implausible period or command is a finding."""
    program = subject.program
    rows = [["workflow", f"{program.period:g}", f"{1.0 / program.period:g}", "each tick"]]
    for key, contract in subject.policies.items():
        n = round(contract.period / program.period)
        often = "each tick" if n == 1 else f"every {n} ticks"
        rows.append([f"policy {key}", f"{contract.period:g}", f"{1.0 / contract.period:g}", often])
        if not 0.002 <= contract.period <= 0.1:
            result.find(
                "timing.period",
                f"policy {key!r}, period",
                f"{contract.period:g} s ({1.0 / contract.period:g} Hz)",
                "give the control period in seconds: 0.02 for 50 Hz",
                contract.path,
            )
    info = info_of(program.platform)
    if "physics_step_s" in info:
        step = float(info["physics_step_s"])
        rows.append(
            ["physics", f"{step:g}", f"{1.0 / step:g}", f"{info['physics_steps_per_tick']} a tick"]
        )
    result.table("Timing", ["who", "period [s]", "rate [Hz]", "runs"], rows)
    platform = subject.platform
    if (
        subject.program.pacing.trigger == "state" and not subject.waits and not subject.live
    ):  # the runner tells it
        result.find(
            "timing.trigger",
            f"platform {platform.name!r}",
            "it cannot tell when its data arrive",
            "set pacing.trigger: deadline",
            subject.document.where("pacing", "trigger"),
        )
    catching_up = subject.document.get("pacing", dict, {}).get("overrun") == "catch_up"
    if catching_up and not platform.simulated and not subject.live:
        result.find(
            "timing.catch_up",
            f"platform {platform.name!r}",
            "catch_up would send old commands in one go to a robot",
            "set pacing.overrun: skip",
            subject.document.where("pacing", "overrun"),
        )
    for key, contract in subject.policies.items():
        _commands(subject, result, key, contract)


def _commands(subject: Subject, result: CheckResult, key: str, contract: PolicyContract) -> None:
    document = subject.document
    for i, item in enumerate(document.get("commands", list, [])):
        options = item.get("velocity_command") if isinstance(item, dict) else None
        for vector in _vectors(options):
            for axis, value in zip(_AXES, vector):
                low, high = contract.command_ranges.get(axis, (-np.inf, np.inf))
                if not low - 1e-6 <= value <= high + 1e-6:
                    result.find(
                        "command.range",
                        "velocity_command",
                        f"{axis} {value:g} is outside [{low:g}, {high:g}], for which policy "
                        f"{key!r} was trained",
                        "command less",
                        document.where("commands", i),
                    )


def _vectors(options: Any) -> list[list[float]]:
    """Return all commands that a `velocity_command` block is going to give."""
    if not isinstance(options, dict):
        return []
    constant, schedule = options.get("constant"), options.get("schedule")
    found = [constant] if isinstance(constant, list) else []
    if isinstance(schedule, list):
        found += [row[1:] for row in schedule if isinstance(row, list)]
    return [[float(v) for v in vector] for vector in found]
