"""Finds and reads robot files, for the workflow compiler, the commands and the tests."""

from __future__ import annotations

from dataclasses import replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.errors import RobotError, WorkflowError
from unicon_core.file_kinds import other_kind
from unicon_core.located_yaml import Located, read_yaml
from unicon_core.resources import find_config, list_config
from unicon_core.robots.capsules import capsules_of
from unicon_core.robots.hand import hand_of
from unicon_core.robots.places import places_of
from unicon_core.robots.poses import joints_like
from unicon_core.robots.robot import JOINT_FIELDS, Imu, Robot
from unicon_core.robots.validate import is_overlay, refuse, validate, validate_overlay


def robot_names() -> list[str]:
    """Return the names of the robots that `load_robot` finds, sorted."""
    return list_config("robots", ".yaml")


def load_robot(name_or_path: str | Path) -> Robot:
    """Read and check a robot file.

    Args:
        name_or_path: a name (`go2`), or a path to a robot file.

    Raises:
        RobotError: no such robot, or the file is wrong: file, line, culprit and remedy; a
            `RobotFileError` where it has several mistakes, with a line for each.
    """
    path = find_config("robots", name_or_path, ".yaml", error=RobotError)
    located = read_yaml(path, RobotError)
    other = other_kind(located.value, "robot")
    if other:
        raise located.error(("schema",), other)
    return _extended(located) if is_overlay(located) else _robot(located)


def _robot(located: Located) -> Robot:
    validate(located)
    document: dict[str, Any] = located.value
    joints = document["joints"]
    imu = document["imu"]
    names = tuple(joint["name"] for joint in joints)
    arrays: dict[str, Any] = {
        field: _array([joint[key] for joint in joints]) for key, field in JOINT_FIELDS.items()
    }
    return Robot(
        name=document["name"],
        description=document["description"],
        manufacturer=document["manufacturer"],
        kind=document["kind"],
        path=located.path,
        models=document["models"],
        base_frame=document["base_frame"],
        joint_names=names,
        **arrays,
        imu=imu
        and Imu(
            imu["frame"], _array(imu["position"] or [None] * 3), _array(imu["quat"] or [None] * 4)
        ),
        feet=tuple(document.get("feet") or document.get("fingertips") or ()),
        transport=document["transport"],
        sources=document["sources"],
        unknown=tuple(document.get("unknown") or ()),
        command_ranges={
            axis: (float(low), float(high))
            for axis, (low, high) in (document.get("command_ranges") or {}).items()
        },
        simulated=document.get("simulated") or {},
        groups={
            group: tuple(name for name in names if any(fnmatchcase(name, p) for p in patterns))
            for group, patterns in (document.get("groups") or {}).items()
        },
        mounts=places_of(document.get("mounts") or {}),
        end_effectors=places_of(document.get("end_effectors") or {}),
        capsules=capsules_of(document.get("capsules") or {}),
        hand=hand_of(document.get("hand")),
    )


def _extended(located: Located) -> Robot:
    """Return the robot that an overlay extends, with what the overlay says of its simulation."""
    validate_overlay(located)
    base, simulated = located.value["extends"], located.value["simulated"]
    folder = located.path.parent
    path = find_config("robots", base, ".yaml", error=RobotError, relative_to=folder)
    extended = read_yaml(path, RobotError)
    if is_overlay(extended):
        named = extended.value["extends"]
        raise located.error(
            ("extends",), f"extends names {path}, an overlay itself (of {named!r}); extend a robot"
        )
    robot = _robot(extended)
    absent = []
    for pattern in simulated:
        try:
            joints_like(pattern, robot)
        except WorkflowError as error:
            absent.append(located.error(("simulated", pattern), str(error)))
    refuse(located, absent)
    both = dict(robot.simulated) | simulated
    return replace(robot, simulated=both, overlay=located.path)


def _array(values: list[float | None]) -> NDArray[np.float32]:
    array = np.array([np.nan if value is None else value for value in values], dtype=np.float32)
    array.setflags(write=False)
    return array
