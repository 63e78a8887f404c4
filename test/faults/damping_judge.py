"""Judges a series of commands: does any of them exceed the damping command? For every fault case.

What the damping command is says `unicon_core/platforms/kit/command.py`; this is written from the
other side, by what a motor may get, and shares only the declared figures with it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from unicon_core.bounds import DAMPING, STIFFNESS
from unicon_core.platforms.kit.command import BLEND
from unicon_core.robots import Robot

TOLERANCE = 1e-3
"""Of a target in [rad]: float32 on the way, and what a robot file rounds."""

Rows = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Commands:
    """Commands in the order in which they left, all of n joints.

    Attributes:
        time: when, in [s], shape (k,).
        target: in [rad], shape (k, n).
        speed: velocity target in [rad/s], shape (k, n).
        effort: feed-forward in [N·m], shape (k, n).
        stiffness: in [N·m/rad], shape (k, n).
        damping: in [N·m·s/rad], shape (k, n).
    """

    time: Rows
    target: Rows
    speed: Rows
    effort: Rows
    stiffness: Rows
    damping: Rows


def beyond_damping(sent: Commands, first: int, robot: Robot, *, slack: float) -> list[str]:
    """Return in words how commands exceed the damping command; empty where none does.

    Targets stand where they were sent last, within the limits; velocities and feed-forward are 0;
    stiffness is never negative, never rises, and is gone after `BLEND`; damping is bounded.

    Args:
        sent: all commands of a run.
        first: the first of them that is to damp; those before it tell what was sent last.
        robot: says the limits.
        slack: by how much `BLEND` may be missed in [s]: of a tick, and of a busy machine.
    """
    rows = slice(first, None)
    if first >= len(sent.time):
        return ["no damping command was sent"]
    target, stiffness, damping = sent.target[rows], sent.stiffness[rows], sent.damping[rows]
    before = max(first - 1, 0)
    stands = np.clip(
        np.where(np.isfinite(sent.target[before]), sent.target[before], target[0]),
        np.nan_to_num(robot.lower, nan=-np.inf),
        np.nan_to_num(robot.upper, nan=np.inf),
    )
    held = np.clip(np.nan_to_num(sent.stiffness[before]), 0.0, STIFFNESS)
    held = held if first else np.full_like(held, STIFFNESS)  # nothing was sent before
    rises = np.diff(np.vstack((held, stiffness)), axis=0) > 1e-4 * np.maximum(held, 1.0)
    late = sent.time[rows] - sent.time[first] > BLEND + slack
    # Each is asked so that NaN is wrong.
    asked = {
        "targets move": ~(np.abs(target - stands) <= TOLERANCE),
        "velocity targets are not 0": ~(sent.speed[rows] == 0.0),
        "feed-forward is not 0": ~(sent.effort[rows] == 0.0),
        "stiffness is not finite, or below 0": ~((stiffness >= 0.0) & (stiffness <= STIFFNESS)),
        "stiffness rises": rises,
        f"stiffness is not gone after {BLEND:g} s": late[:, None] & ~(stiffness == 0.0),
        "damping is out of bounds": ~((damping >= 0.0) & (damping <= DAMPING)),
    }
    return [
        f"{words} (damping command {int(np.argmax(wrong.any(axis=1))) + 1})"
        for words, wrong in asked.items()
        if wrong.any()
    ]
