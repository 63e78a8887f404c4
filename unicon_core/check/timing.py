"""Rates: control periods, gait clocks, the platform's pacing, and what is commanded."""

from __future__ import annotations

from typing import Any

import numpy as np

from unicon_core.check.result import CheckResult, PolicyResult
from unicon_core.check.subject import Subject
from unicon_core.platforms.platform import info_of
from unicon_core.text_table import figure, span

TURN = 2.0 * np.pi + 1e-3
"""In [rad]: phases beyond it are in degrees."""
GAIT = (0.1, 10.0)
"""Shortest and longest period of a gait in [s]; published ones have 0.4 to 1.5."""

_AXES = ("lin_vel_x", "lin_vel_y", "ang_vel_z")


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
            where=subject.document.where("pacing", "trigger"),
        )
    catching_up = subject.document.get("pacing", {}).get("overrun") == "catch_up"
    if catching_up and not platform.simulated and not told:
        result.find(
            "timing.catch_up",
            f"platform {platform.name!r}",
            "catch_up would send old commands in one go to a robot",
            where=subject.document.where("pacing", "overrun"),
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
                        where=document.where("commands", i),
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


def check_clock(policy: PolicyResult) -> None:
    """Find phases in degrees and periods in milliseconds or in [Hz]."""
    phase = policy.contract.phase
    if phase is None:
        return
    stand = phase.stand if isinstance(phase.stand, float) else 0.0
    for part, values in (("phase.offsets", phase.offsets), ("phase.stand", (stand,))):
        most = max(values, key=abs)
        if abs(most) > TURN:
            policy.find(
                "timing.clock",
                part,
                f"{most:g} rad is more than a turn",
                f"give it in [rad]: {np.radians(most):.4g} if these were degrees",
            )
    if not GAIT[0] <= phase.period <= GAIT[1]:
        policy.find(
            "timing.clock",
            "phase.period",
            f"a gait of {phase.period:g} s; plausible are {GAIT[0]:g} to {GAIT[1]:g}",
        )
