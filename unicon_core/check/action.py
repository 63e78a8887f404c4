"""The action: reachable targets against limits, torque of one unit, period, commands."""

from __future__ import annotations

from itertools import compress
from typing import Any

import numpy as np

from unicon_core.check.action_rates import check_rates
from unicon_core.check.clock import check_clock
from unicon_core.check.mirror import check_mirrored
from unicon_core.check.result import CheckResult, PolicyResult
from unicon_core.check.safety import limits_targets
from unicon_core.check.subject import Subject, listed
from unicon_core.figures import figure, span
from unicon_core.platforms.platform import info_of
from unicon_core.robots import joint_index

PLAUSIBLE_ACTION = 1.0
"""Action that a trained policy reaches in every walk; used where the contract has no clip."""
UNIT_TORQUE = 2.0
"""Stiffness · scale over the effort limit: 0.25 in BeyondMimic's rule, 0.74 for the Go1 policy.
More is worth a look and may be right: a wrist of 5 N·m has 8 with a scale of 1."""
LARGEST_SCALE = 1.0
"""In [rad] for one unit of action: actions in radians have 1, published ones 0.07 to 1."""
ROUNDING = 1e-4
"""In [rad]: by how much a figure may be beyond a limit, which is often the same one rounded."""
_AXES = ("lin_vel_x", "lin_vel_y", "ang_vel_z")


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
        gain[at].astype(np.float64) for gain in (contract.stiffness, contract.damping)
    )
    unit = np.where(position, stiffness, np.where(velocity, damping, 1.0))
    share = np.abs(scale) * unit / effort
    outside = (low < lower - ROUNDING) | (high > upper + ROUNDING)
    rows = [
        [
            name,
            figure(offset[i]),
            figure(scale[i]),
            span(clip[0, i], clip[1, i]),
            span(low[i], high[i], form=".4g"),
            span(lower[i], upper[i], form=".4g"),
            figure(share[i], ".2f") if np.isfinite(share[i]) else "?",
            "outside" if outside[i] else "",
        ]
        for i, name in enumerate(joints)
    ]
    columns = ["joint", "offset", "scale", "action", "reach [rad]", "limits [rad]", "torque/unit"]
    if action.kinds:
        rows = [[row[0], kind, *row[1:]] for row, kind in zip(rows, action.kinds)]
        columns = ["joint", "target", *columns[1:4], "reach", "limits", "torque/unit"]
    lines = [f"target = offset + scale · action; last action is the {action.feedback} one"]
    if action.clip is None or wide.any():
        lines.append(f"no clip that binds: shown is an action of ±{PLAUSIBLE_ACTION:g}")
    if action.kinds:
        lines.append("position in [rad], velocity in [rad/s], torque in [N·m]")
        lines.append("torque/unit: scale · stiffness (velocity: · damping), of the effort limit")
    else:
        lines.append("torque/unit: stiffness · scale as a share of the effort limit")
    policy.result.table(f"Action of policy {policy.key}", [*columns, ""], rows, lines)
    idle = scale == 0.0
    if idle.all():
        policy.find(
            "action.scale",
            "action.scale",
            "it is 0: no joint could move",
            "give the scale that it was trained with, in [rad]",
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
            "give action.kind velocity or torque there, or the stiffness that it was trained with",
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
            "give the scale that it was trained with, in [rad]",
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
            "correct the offset (the default pose) or the robot's limits",
        )
    if action.kinds:
        check_rates(subject, policy, outside)
    outside &= position
    if outside.any():
        far = listed(compress(joints, outside))
        text = f"actions within the table reach beyond the limits of {far}"
        if limits_targets(subject):
            policy.note("action.reach", "", f"{text}; joint_limits cuts them off")
        else:
            policy.result.find(
                "action.reach",
                f"policy {policy.key!r}",
                f"{text}, and no joint_limits is in safety:",
                "add joint_limits to safety",
                subject.document.where("safety"),
            )


def check_timing(subject: Subject, result: CheckResult) -> None:
    """Add the table of rates; an implausible period or command is a finding."""
    program = subject.program
    rows = [["workflow", f"{program.period:g}", f"{1.0 / program.period:g}", "each tick"]]
    policies = subject.policy_results(result)
    for policy in policies:
        key, period = policy.key, policy.contract.period
        n = round(period / program.period)
        often = "each tick" if n == 1 else f"every {n} ticks"
        rows.append([f"policy {key}", f"{period:g}", f"{1.0 / period:g}", often])
        if not 0.002 <= period <= 0.1:
            policy.find(
                "timing.period",
                "period",
                f"{period:g} s ({1.0 / period:g} Hz)",
                "give the control period in seconds: 0.02 for 50 Hz",
            )
        check_clock(policy)
    info = info_of(program.platform)
    if "physics_step_s" in info:
        step, often = float(info["physics_step_s"]), f"{info['physics_steps_per_tick']} a tick"
        rows.append(["physics", f"{step:g}", f"{1.0 / step:g}", often])
    result.table("Timing", ["who", "period [s]", "rate [Hz]", "runs"], rows)
    platform = subject.platform
    told = subject.live  # by the runner
    if program.pacing.trigger == "state" and not subject.waits and not told:
        result.find(
            "timing.trigger",
            f"platform {platform.name!r}",
            "it cannot tell when its data arrive",
            "set pacing.trigger: deadline",
            subject.document.where("pacing", "trigger"),
        )
    catching_up = subject.document.get("pacing", {}).get("overrun") == "catch_up"
    if catching_up and not platform.simulated and not told:
        result.find(
            "timing.catch_up",
            f"platform {platform.name!r}",
            "catch_up would send old commands in one go to a robot",
            "set pacing.overrun: skip",
            subject.document.where("pacing", "overrun"),
        )
    for policy in policies:
        _commands(subject, policy)


def check_commands(subject: Subject, result: CheckResult) -> None:
    """Note what is commanded without a bound of its own: cautious ones hold then."""
    open_ended = [each for each in subject.program.command_bounds if not each.given]
    if open_ended:
        held = ", ".join(f"{b.axis} to {span(b.low, b.high, '…')} {b.unit}" for b in open_ended)
        result.note(
            "command.bounds",
            "velocity_command",
            f"neither policy nor robot file says how much may be commanded: bounded are {held}",
            "give command_ranges in policy.yaml (lin_vel_x, lin_vel_y, ang_vel_z), or in the robot "
            "file (vx, vy, wz)",
            subject.robot.path,
        )


def _commands(subject: Subject, policy: PolicyResult) -> None:
    document = subject.document
    for i, item in enumerate(document.get("commands", [])):
        options = item.get("velocity_command") if isinstance(item, dict) else None
        for vector in _vectors(options):
            for axis, value in zip(_AXES, vector):
                low, high = policy.contract.command_ranges.get(axis, (-np.inf, np.inf))
                if not low - 1e-6 <= value <= high + 1e-6:
                    policy.result.find(
                        "command.range",
                        "velocity_command",
                        f"{axis} {figure(value)} is outside [{span(low, high, ', ')}], for which "
                        f"policy {policy.key!r} was trained",
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
