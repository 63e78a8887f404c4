"""Blocks of the fault runs: a command that moves in every tick, and blocks that misbehave."""

from __future__ import annotations

import math
import os
import signal
import time
from pathlib import Path

from faults.command_log import FAULT, OPEN, CommandLog
from unicon_core.blocks.controls.device import declares_controls
from unicon_core.flow import Amends, Reads, Tick, Writes
from unicon_core.robots import Robot


def swing(tick: float) -> float:
    """Return where `wobble` has all joints in a tick, beside the default pose in [rad]."""
    return 0.02 * math.sin(0.3 * tick)


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
        joint_pos_target[...] = pose + swing(float(tick))
        joint_pos_target[...] += 0.0 * joint_pos
        joint_vel_target[...] = 0.0
        joint_effort_ff[...] = 0.0
        joint_stiffness[...] = robot.joint_stiffness
        joint_damping[...] = robot.joint_damping
        return False

    return step


def broken(
    joint_pos_target: Amends,
    joint_vel_target: Amends,
    joint_effort_ff: Amends,
    joint_stiffness: Amends,
    joint_damping: Amends,
    tick: Reads,
    *,
    at: int = 25,
    value: float = math.nan,
    state: str = "joint_pos_target",
    hang: float = 0.0,
) -> Tick:
    """Command a value for the first joint that nobody would want.

    Args:
        at: from this tick on.
        value: NaN unless told.
        state: which command gets it; `jump` adds it to all targets, with another sign each tick.
        hang: time in [s] for which it does not return, once, instead.
    """
    view = {
        "joint_vel_target": joint_vel_target,
        "joint_effort_ff": joint_effort_ff,
        "joint_stiffness": joint_stiffness,
        "joint_damping": joint_damping,
    }.get(state, joint_pos_target)

    def step() -> bool:
        if tick < at:
            return False
        if hang:
            if tick == at:
                time.sleep(hang)
        elif state == "jump":
            joint_pos_target[...] += value if int(tick) % 2 else -value
        else:
            view[0] = value
        return False

    return step


def pressed(buttons: Writes, tick: Reads, *, at: int = 25) -> Tick:
    """Hold all buttons of the robot's remote.

    Args:
        at: from this tick on.
    """

    def step() -> bool:
        buttons[...] = tick >= at
        return False

    return step


setattr(pressed, "declares", declares_controls)  # noqa: B010  a function has none to mypy


def nothing() -> Tick:
    """Do nothing, beside something else."""
    return lambda: False


def slow_build(joint_pos_target: Reads, *, log: str, signals: str, seconds: float = 1.0) -> Tick:
    """Take long to be built, after a signal has come.

    Args:
        log: file of the command log.
        signals: name of the signal.
        seconds: in [s].
    """
    written = CommandLog(Path(log))
    if written.of(OPEN).size:  # `check` builds blocks too, before a platform is opened
        written.add(FAULT)
        os.kill(os.getpid(), signal.Signals[signals])
        time.sleep(seconds)
    return lambda: False
