"""Gazebo (gz sim) as a platform: gz_ros2_control behind topics; see docs/howto/gazebo.md."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from unicon_core.platforms.platform import Binding, Facts
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_ros.bridge.map_fit import examine_platform
from unicon_ros.bridge.ros_platform import RosPlatform, maker


def examine(
    states: States,
    robot: Robot,
    period: float,
    *,
    map: str = "gazebo",
    relative_to: Path | None = None,
    **others: Any,
) -> Binding:
    """Return what platform `gazebo` would read and write; takes what its factory takes.

    Raises:
        PlatformError: the map does not fit the states or the robot.
    """
    bound = examine_platform(states, robot, period, map=map, relative_to=relative_to)
    facts = bound.facts
    notes = (*facts.notes, *_servo_notes(facts.reads, period))
    return replace(bound, facts=replace(facts, name="gazebo", notes=notes))


def _servo_notes(reads: Sequence[str], period: float) -> tuple[str, ...]:
    """Return where the servo is, which over topics is not at each physics step."""
    if "joint_stiffness" in reads:
        return (
            f"the servo runs here, {1.0 / period:.4g} times a second, not at each physics step of "
            "Gazebo; a controller in gz is stiffer: map gazebo, docs/howto/gazebo.md",
        )
    return (
        "joint_stiffness, joint_damping and joint_effort_ff do not reach Gazebo: its "
        "pid_controller has gains of its own, docs/howto/gazebo.md",
    )


class GazeboPlatform(RosPlatform):
    """A robot in Gazebo, which keeps its own time; build it with `make`."""

    facts = Facts("gazebo", examine=examine)
    remedy = "start Gazebo with its controllers and bridge (docs/howto/gazebo.md)"

    notes = staticmethod(_servo_notes)


make = maker(GazeboPlatform, "gazebo", 20.0)
