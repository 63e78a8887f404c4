"""The command of a run that reaches an emulated robot, by its platform and options."""

from __future__ import annotations

import json
import os
import shlex

from unicon_core.errors import RobotError
from unicon_core.resources import find_config
from unicon_core.robots import Robot, robot_names
from unicon_core.workflow.hardware import refuse_incomplete
from unicon_ros.emulate.face import Face

WORKFLOW = "h1_stand"
"""Goes to the default pose; any robot does."""


def reaching(robot: Robot, face: Face) -> dict[str, str]:
    """Return `command`, which drives an emulated robot to its default pose in a shell.

    A robot whose file lacks what driving it needs has none, and `refused` says what is lacking.

    Args:
        robot: its file.
        face: its end of the protocol; without attributes `platform` and `reach` no command is
            known, and the text is empty.
    """
    platform, reach = getattr(face, "platform", ""), getattr(face, "reach", {})
    if not platform:
        return {"command": ""}
    try:
        refuse_incomplete(robot, platform)
    except RobotError as error:
        return {"command": "", "refused": str(error)}
    settings = {"robot": _named(robot), "platform": platform}
    settings |= {f"platforms.{platform}.{option}": value for option, value in reach.items()}
    words = ["unicon", "run", WORKFLOW]
    for path, value in settings.items():
        shown = value if isinstance(value, str) else json.dumps(value)
        words += ["--set", f"{path}={shown}"]
    domain = os.environ.get("ROS_DOMAIN_ID") if platform == "ros" else None
    domains = [f"ROS_DOMAIN_ID={domain}"] if domain else []
    return {"command": shlex.join([*domains, *words, "--yes"])}


def _named(robot: Robot) -> str:
    """Return what finds the robot's file from anywhere: its name, else its path."""
    if robot.name in robot_names():
        found = find_config("robots", robot.name, ".yaml", error=RobotError)
        if found.samefile(robot.path):
            return robot.name
    return str(robot.path.resolve())
