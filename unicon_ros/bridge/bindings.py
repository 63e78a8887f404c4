"""Bindings: what a message map may name of a program, for the bridge and the recorder."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from unicon_core.errors import UniconError
from unicon_core.robots import Robot
from unicon_core.workflow.program_data import ProgramData


def arrays_of(program: ProgramData) -> dict[str, NDArray[Any]]:
    """Return the states' views by name; of the first robot where there are many."""
    states = program.states
    if states.num_robots is None:
        return {name: states[name] for name in states}
    return {name: states[name][0, ...] for name in states}


def names_of(program: ProgramData) -> dict[str, tuple[str, ...]]:
    """Return the element names of the states that have some."""
    specs = program.states.layout.specs
    return {name: spec.names for name, spec in specs.items() if spec.names}


def variables_of(program: ProgramData, frame_prefix: str = "") -> dict[str, object]:
    """Return what a map may call `$name`; `frame_prefix` stands before the names of frames."""
    return robot_variables(program.robot, frame_prefix)


def robot_variables(robot: Robot, frame_prefix: str = "") -> dict[str, object]:
    """Return the same of a robot alone."""
    return {
        "joint_names": list(robot.joint_names),
        "robot": robot.name,
        "base_frame": frame_prefix + (robot.base_frame or "base_link"),
        "odom_frame": frame_prefix + "odom",
        "imu_frame": frame_prefix + (robot.imu.frame if robot.imu is not None else "imu_link"),
        "feet": list(robot.feet),
    }


def checked_prefix(prefix: str) -> str:
    """Return a prefix of frame names as it is.

    Raises:
        UniconError: tf2 would refuse such names.
    """
    if prefix.startswith("/") or any(sign.isspace() for sign in prefix):
        right = "".join(prefix.split()).lstrip("/")
        raise UniconError(
            f"frame prefix {prefix!r}: tf2 takes no frames with a leading slash or spaces; "
            f"write {right!r}"
        )
    return prefix


def told_states(program: ProgramData) -> frozenset[str]:
    """Return the states that somebody tells: the platform, or a block, one of the wind-down too.

    A topic amends these, and writes all others.
    """
    blocks = {state for block in program.blocks for state in (*block.writes, *block.amends)}
    return frozenset({*blocks, *program.platform.facts.writes})
