"""The damping command: what leaves last for the motors, for every platform that has some.

    damping_command(states, robot, sent)    # in `close`, whatever had happened before
    repeated(publish, period, DAMPING_TIME)

No safety block runs behind it, so that it keeps the limits by itself.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from unicon_core.robots import Robot
from unicon_core.states import States

__all__ = ["DAMPING_TIME", "damping_command", "repeated"]

DAMPING_TIME = 0.5
"""How long the damping command is repeated, [s]: one message may be lost, and a run that is asked
to end shall be gone within a second."""

ABSURD = 1.0
"""A measured position that is further outside its limits is no measurement, [rad] or [m]."""

ENDLESS = 1e3
"""Limit of joints whose limit is not known, [rad] or [m]: nothing is beyond it but nonsense."""

FASTEST = 0.002
"""Shortest time between two repetitions, [s]."""


def damping_command(
    states: States, robot: Robot, sent: NDArray[np.float32] | None, *, hold: bool = False
) -> None:
    """Write the command states: damping without stiffness, velocities and feed-forward zero.

    Targets are the measured positions, within the robot's limits. They matter where a motor looks
    at nothing else. A position that is not finite or absurd is none: the last target counts.

    Args:
        states: whose command states are written, all of them finite.
        robot: says limits and damping; what it does not say is no limit, and no damping.
        sent: the targets that were sent last in [rad], shape (..., n), or None before the first.
        hold: the motors get positions only: they keep those sent last, since the measured ones
            would be a step.
    """
    lower = np.nan_to_num(robot.lower, nan=-ENDLESS)
    upper = np.nan_to_num(robot.upper, nan=ENDLESS)
    pose = np.nan_to_num(robot.default_joint_pos)
    last = pose if sent is None else np.where(np.isfinite(sent), sent, pose)
    measured = states["joint_pos"]
    good = (measured >= lower - ABSURD) & (measured <= upper + ABSURD)  # false for NaN
    if hold and sent is not None:
        good[...] = False
    np.clip(np.where(good, measured, last), lower, upper, out=states["joint_pos_target"])
    states["joint_vel_target"][...] = 0.0
    states["joint_effort_ff"][...] = 0.0
    states["joint_stiffness"][...] = 0.0
    states["joint_damping"][...] = np.nan_to_num(robot.joint_damping, posinf=0.0, neginf=0.0)


def repeated(send: Callable[[], object], period: float, duration: float = DAMPING_TIME) -> None:
    """Send a command again and again: at the tick's rate, once at least.

    Args:
        send: sends it; an error of it stops nothing.
        period: of a tick in [s].
        duration: in [s].

    Raises:
        Exception: what `send` raised last, after the time is over.
    """
    period = max(period, FASTEST)
    error: Exception | None = None
    due = time.monotonic()
    end = due + duration
    while True:
        try:
            send()
        except Exception as raised:
            error = raised
        due += period
        if due > end:
            break
        time.sleep(max(0.0, due - time.monotonic()))
    if error is not None:
        raise error
