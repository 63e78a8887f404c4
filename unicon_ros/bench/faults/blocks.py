"""Blocks of the fault runs: a command that moves in every tick, and blocks that misbehave."""

from __future__ import annotations

import math
import os
import signal
import time
from pathlib import Path

from unicon_core.flow import Amends, Reads, Tick, Writes
from unicon_core.robots import Robot
from unicon_ros.bench.faults.command_log import FAULT, CommandLog

__all__ = ["broken", "slow_build", "wobble"]


def wobble(
    joint_pos_target: Writes,
    joint_vel_target: Writes,
    joint_effort_ff: Writes,
    joint_stiffness: Writes,
    joint_damping: Writes,
    tick: Reads,
    joint_pos: Reads,
    *,
    robot: Robot,
) -> Tick:
    """Move all joints a little about the default pose, another target in every tick.

    Args:
        joint_pos: in [rad]; read as a controller does, so that its time-out counts.
    """
    pose = robot.default_joint_pos

    def step() -> bool:
        joint_pos_target[...] = pose + 0.02 * math.sin(0.3 * float(tick))
        joint_pos_target[...] += 0.0 * joint_pos
        joint_vel_target[...] = 0.0
        joint_effort_ff[...] = 0.0
        joint_stiffness[...] = robot.joint_stiffness
        joint_damping[...] = robot.joint_damping
        return False

    return step


def broken(joint_pos_target: Amends, tick: Reads, *, at: int = 25, value: float = math.nan) -> Tick:
    """Command a value that is nowhere near a joint's range.

    Args:
        at: from this tick on.
        value: in [rad]; NaN unless told.
    """

    def step() -> bool:
        if tick >= at:
            joint_pos_target[0] = value
        return False

    return step


def slow_build(joint_pos_target: Reads, *, log: str, signals: str, seconds: float = 1.0) -> Tick:
    """Take long to be built, after a signal has come.

    Args:
        log: file of the command log.
        signals: name of the signal.
        seconds: in [s].
    """
    CommandLog(Path(log)).add(FAULT)
    os.kill(os.getpid(), signal.Signals[signals])
    time.sleep(seconds)
    return lambda: False
