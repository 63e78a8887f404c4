"""What a robot would be sent first: where the flow begins, and how far its commands are off."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from unicon_core.blocks.approach import Target
from unicon_core.errors import Fault, UniconError
from unicon_core.gates.beginning import beginning, first_command
from unicon_core.preflight.result import PreflightResult
from unicon_core.workflow import Program

Float = NDArray[np.float32]


def tell_first_command(program: Program, result: PreflightResult) -> None:
    """Add where the flow begins and what it would send first; nothing is sent.

    Args:
        program: whose platform has been received from.
        result: is added to.
    """
    measured = np.array(program.states["joint_pos"])
    try:
        begins, first = beginning(program), first_command(program)
        entry = _entered(program, begins)
    except Exception as error:  # of a block, which may raise anything
        kind = "" if isinstance(error, (UniconError, Fault)) else f"{type(error).__name__}: "
        result.add("first command", False, f"{kind}{error}; nothing would be sent")
        return
    way, joint = _farthest(program, begins, measured)
    approach = f"{begins.source}, {way:.2f} rad away ({joint})"
    speed = program.start.approach
    if not program.platform.facts.simulated and way > 0.0:
        approach += f": an approach of {way / speed:.1f} s at {speed:g} rad/s"
    result.add("begins at", None, approach)
    result.first_command = _distances(program, first, measured)
    result.first_step = _distances(program, entry, begins.joint_pos)
    size, joint = _farthest(program, first, measured)
    gain = first.stiffness[program.robot.joint_names.index(joint)]
    told = f"of the flow from here: {size:.2f} rad away ({joint}) at {gain:g} N·m/rad"
    if way > 0.0:
        size, joint = _farthest(program, entry, begins.joint_pos)
        told += f"; from where it begins: {size:.2f} rad ({joint})"
    finite = all(np.isfinite(command.joint_pos).all() for command in (first, entry))
    result.add("first command", finite, told + ("" if finite else "; mend the flow"))


def _entered(program: Program, at: Target) -> Target:
    """Return the first command as it is where the approach has ended, at rest there."""
    states = program.states
    before = states.snapshot()
    try:
        states["joint_pos"][...] = at.joint_pos
        states["joint_vel"][...] = 0.0
        return first_command(program)
    finally:
        states.restore(before)


def _distances(program: Program, target: Target, origin: Float) -> dict[str, float]:
    away = np.round(np.abs(target.joint_pos - origin).astype(float), 6).tolist()
    return dict(zip(program.robot.joint_names, away))


def _farthest(program: Program, target: Target, origin: Float) -> tuple[float, str]:
    """Return the largest distance in [rad] and its joint; one that is not finite is the largest."""
    away = np.abs(target.joint_pos - origin)
    worst = int(np.argmax(np.nan_to_num(away, nan=np.inf)))
    return float(away[worst]), program.robot.joint_names[worst]
