"""Bindings: what a message map may name of a workflow, for the bridge and the recorder."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from unicon_core.workflow import Workflow

__all__ = ["arrays_of", "names_of", "variables_of"]


def arrays_of(workflow: Workflow) -> dict[str, NDArray[Any]]:
    """Return the states' views by name; of the first robot where there are many."""
    states = workflow.states
    if states.num_robots is None:
        return {name: states[name] for name in states}
    return {name: states[name][0, ...] for name in states}


def names_of(workflow: Workflow) -> dict[str, tuple[str, ...]]:
    """Return the element names of the states that have some."""
    specs = workflow.states.layout.specs
    return {name: spec.names for name, spec in specs.items() if spec.names}


def variables_of(workflow: Workflow) -> dict[str, object]:
    """Return what a map may call `$name`."""
    robot = workflow.robot
    return {
        "joint_names": list(robot.joint_names),
        "robot": robot.name,
        "base_frame": robot.base_frame or "base_link",
        "odom_frame": "odom",
        "imu_frame": robot.imu.frame if robot.imu is not None else "imu_link",
        "feet": list(robot.feet),
    }
