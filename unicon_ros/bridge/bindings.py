"""Bindings: what a message map may name of a program, for the bridge and the recorder."""

from __future__ import annotations

import time

import numpy as np

from unicon_base import UniconError
from unicon_base.arrays import Array
from unicon_core.robots import Robot
from unicon_core.workflow.program_data import ProgramData


def arrays_of(program: ProgramData) -> dict[str, Array]:
    """Return the states' views by name; of the first robot where there are many."""
    states = program.states
    if states.num_robots is None:
        return {name: states[name] for name in states}
    return {name: states[name][0, ...] for name in states}


def names_of(program: ProgramData) -> dict[str, tuple[str, ...]]:
    """Return the element names of the states that have some."""
    specs = program.states.layout.specs
    return {name: spec.names for name, spec in specs.items() if spec.names}


def robot_variables(robot: Robot, frame_prefix: str = "") -> dict[str, object]:
    """Return what a map may call `$name`; `frame_prefix` stands before the names of frames."""
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


WINDOW_NS = 5_000_000_000
"""Length of a window of the filter; a clock adjustment is followed within two of them."""


class WallStamp:
    """A robot's stamps on the wall clock.

    Args:
        source: `stamp_ns` of the robot in [ns], int64 scalar; None where the platform has none.

    Attributes:
        out: the stamp on the wall clock in [ns], int64 scalar, written by each call.
    """

    name = "ros time"

    def __init__(self, source: Array | None) -> None:
        self.out = np.zeros((), np.int64)
        self.reads = () if source is None else ("stamp_ns",)
        self._source = source
        self._ends_ns = 0
        self._present = self._previous = 1 << 62

    def __call__(self) -> None:
        wall = time.time_ns()
        if self._source is None:
            self.out[...] = wall
            return
        stamp = int(self._source)
        difference = wall - stamp
        if wall > self._ends_ns or wall < self._ends_ns - 2 * WINDOW_NS:
            self._previous = self._present if self._ends_ns else difference
            self._present = difference
            self._ends_ns = wall + WINDOW_NS
        elif difference < self._present:
            self._present = difference
        self.out[...] = stamp + min(self._present, self._previous)
