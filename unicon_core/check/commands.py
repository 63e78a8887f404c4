"""Bounds of the velocity command: who says them, for `unicon check`."""

from __future__ import annotations

from unicon_core.check.result import CheckResult
from unicon_core.check.subject import Subject

__all__ = ["check_commands"]


def check_commands(subject: Subject, result: CheckResult) -> None:
    """Note what is commanded without a bound of its own: cautious ones hold then."""
    open_ended = [each for each in subject.program.command_bounds if not each.given]
    if open_ended:
        held = ", ".join(f"{b.axis} to {b.low:g}…{b.high:g} {b.unit}" for b in open_ended)
        result.note(
            "command.bounds",
            "velocity_command",
            f"neither policy nor robot file says how much may be commanded: bounded are {held}",
            "give command_ranges in policy.yaml (lin_vel_x, lin_vel_y, ang_vel_z), or in the robot "
            "file (vx, vy, wz)",
            subject.robot.path,
        )
