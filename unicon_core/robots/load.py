"""Finds and reads robot files, for the workflow compiler, the commands and the tests."""

from __future__ import annotations

from collections.abc import Sequence
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
from unicon_core.robots.file import ImuFacts, Overlay, RobotFile
from unicon_core.robots.poses import joints_like
from unicon_core.robots.robot import JOINT_FIELDS, Imu, Robot
from unicon_core.schema.read import read, refuse
from unicon_core.schema.types import Mistakes


def robot_names() -> list[str]:
    """Return the names of the robots that `load_robot` finds, sorted."""
    return list_config("robots", ".yaml")


def load_robot(name_or_path: str | Path) -> Robot:
    """Read and check a robot file.

    Args:
        name_or_path: a name (`go2`), or a path to a robot file.

    Raises:
        RobotError: no such robot, or the file is wrong: file, line, culprit and remedy, with a
            line for each mistake.
    """
    path = find_config("robots", name_or_path, ".yaml", error=RobotError)
    located = read_yaml(path, RobotError)
    other = other_kind(located.value, "robot")
    if other:
        raise located.error(("schema",), other)
    return _extended(located) if is_overlay(located) else _robot(located)


def is_overlay(located: Located) -> bool:
    """Return whether a file says only what another robot file does not: it `extends` it."""
    return isinstance(located.value, dict) and "extends" in located.value


def read_robot_file(located: Located) -> RobotFile:
    """Return what a robot file says.

    Raises:
        RobotError: it is wrong; with a line for each mistake.
    """

    def named_like_the_file(mistakes: Mistakes) -> None:
        name, stem = located.value.get("name"), located.path.stem
        if isinstance(name, str) and name.strip() and name != stem:
            text = f"differs from the file's name; write `name: {stem}` or rename the file"
            mistakes.value(("name",), f"is {name!r}, which {text}")

    return read(RobotFile, located, "robot file", named_like_the_file)


def _robot(located: Located) -> Robot:
    said = read_robot_file(located)
    names = tuple(joint.name for joint in said.joints)
    arrays: dict[str, Any] = {
        field: _array([getattr(joint, key) for joint in said.joints])
        for key, field in JOINT_FIELDS.items()
    }
    imu = said.imu
    return Robot(
        name=said.name,
        description=said.description,
        manufacturer=said.manufacturer or "",
        kind=said.kind,
        path=located.path,
        models=said.models,
        base_frame=said.base_frame,
        joint_names=names,
        **arrays,
        imu=None if imu is None else _imu(imu),
        feet=tuple(said.feet or said.fingertips),
        transport=said.transport or {"protocol": None},
        sources=said.sources,
        unknown=tuple(said.unknown or ()),
        command_ranges={str(axis): pair for axis, pair in (said.command_ranges or {}).items()},
        simulated=said.simulated or {},
        groups={
            group: tuple(name for name in names if any(fnmatchcase(name, p) for p in patterns))
            for group, patterns in (said.groups or {}).items()
        },
        mounts=said.mounts or {},
        end_effectors=said.end_effectors or {},
        capsules=said.capsules or {},
        hand=said.hand,
    )


def _extended(located: Located) -> Robot:
    """Return the robot that an overlay extends, with what the overlay says of its simulation."""
    overlay = read(Overlay, located, "robot file")
    folder = located.path.parent
    path = find_config("robots", overlay.extends, ".yaml", error=RobotError, relative_to=folder)
    extended = read_yaml(path, RobotError)
    if is_overlay(extended):
        named = extended.value["extends"]
        raise located.error(
            ("extends",), f"extends names {path}, an overlay itself (of {named!r}); extend a robot"
        )
    robot = _robot(extended)
    mistakes = Mistakes(located.value)
    for pattern in overlay.simulated:
        try:
            joints_like(pattern, robot)
        except WorkflowError as error:
            mistakes.note((), str(error), "simulated", pattern)
    refuse(mistakes, located.error, f"robot file {located.path}")
    both = {**robot.simulated, **overlay.simulated}
    return replace(robot, simulated=both, overlay=located.path)


def _imu(said: ImuFacts) -> Imu:
    return Imu(said.frame, _array(said.position or [None] * 3), _array(said.quat or [None] * 4))


def _array(values: Sequence[float | None]) -> NDArray[np.float32]:
    array = np.array([np.nan if value is None else value for value in values], dtype=np.float32)
    array.setflags(write=False)
    return array
