"""Finds and reads robot files, for the workflow compiler, the commands and the tests.

A robot may be made of robots, a body and its hands as one, where a workflow names several:

    robot: {body: g1_29dof, left_hand: inspire_rh56_left, right_hand: inspire_rh56_right}

The first member has the base: its IMU, feet, frames and command ranges are those of the whole. The
joints stand in the members' order, one member behind the other.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np

from unicon_base import AnyDict, RobotError, WorkflowError, alternatives
from unicon_base.arrays import Float32, Float64
from unicon_base.located_yaml import Located, other_kind, read_yaml
from unicon_base.resources import find_config, list_config
from unicon_base.schema.read import read, refuse
from unicon_base.schema.records import record_of
from unicon_base.schema.types import Mistakes
from unicon_core.bounds import POSITION, within
from unicon_core.robots.file import Figures, Overlay, RobotFile
from unicon_core.robots.robot import JOINT_FIELDS, Imu, Place, Robot


def robot_poses(robot: Robot) -> dict[str, Float32]:
    """Return word to pose of a robot file in [rad], shape (n,), NaN where it does not say it."""
    standing, lying = robot.default_joint_pos, robot.rest_joint_pos
    return {"default": standing, "stand": standing, "rest": lying, "lie": lying}


def joints_like(pattern: str, robot: Robot, remedy: str = "") -> list[int]:
    """Return the joints whose names match a pattern with `*` and `?`, never empty.

    Args:
        pattern: of names.
        robot: whose joints.
        remedy: where the caller knows more of one than the names.

    Raises:
        WorkflowError: none does.
    """
    found = [i for i, name in enumerate(robot.joint_names) if fnmatchcase(name, pattern)]
    if not found:
        raise WorkflowError(
            f"robot {robot.name} has no joint like {pattern!r}; "
            f"{alternatives(pattern, robot.joint_names)}{f'; {remedy}' if remedy else ''}"
        )
    return found


def named_pose(to: str | Mapping[str, float], robot: Robot, what: str) -> tuple[Float32, Float32]:
    """Return a pose [rad] and which joints it says (1 or 0), each shape (n,).

    Args:
        robot: whose pose.
        what: asks for it, for the message.
        to: `stand` or `default`, `rest` or `lie`, or joint names and patterns to [rad].

    Raises:
        RobotError: the robot file does not say that pose.
        WorkflowError: no such pose or joint, or a position beyond the joint's limits.
    """
    if isinstance(to, str):
        poses = robot_poses(robot)
        if to not in poses:
            raise WorkflowError(f"no pose {to!r}; {alternatives(to, poses)}; or joints to [rad]")
        if np.isnan(poses[to]).any():
            key = "default" if poses[to] is robot.default_joint_pos else "rest"
            first, *more = np.flatnonzero(np.isnan(poses[to])).tolist()
            joint = robot.joint_names[first]
            also = f" and {len(more)} more joint{'s' * (len(more) > 1)}" if more else ""
            raise RobotError(
                f"{what}: robot {robot.name} does not say `{key}` (the {to} pose) of {joint}"
                f"{also}; give it in {robot.file_of(joint)}, or give joints and positions"
            )
        return poses[to].astype(np.float32), np.ones(robot.num_joints, np.float32)
    pose = np.zeros(robot.num_joints, np.float32)
    said = np.zeros(robot.num_joints, np.float32)
    for pattern, position in to.items():
        within(position, f"position of {pattern!r}", "rad", POSITION, -POSITION, above=False)
        for i in joints_like(pattern, robot):
            lower, upper = robot.lower[i], robot.upper[i]
            if position < lower - 1e-6 or position > upper + 1e-6:  # false for an unknown limit
                raise WorkflowError(
                    f"{position} rad is beyond the limits of joint {robot.joint_names[i]}: "
                    f"{lower:.6g} to {upper:.6g} rad; correct the pose"
                )
            pose[i], said[i] = position, 1.0
    return pose, said


JOINT_PHYSICS = {name: field.type.unit for name, field in record_of(Figures).fields.items()}  # type: ignore[attr-defined]
"""Word to unit."""

Said = Mapping[str, Mapping[str, float]]


@dataclass(frozen=True, eq=False)
class JointPhysics:
    """What is said of each joint: float64, shape (n,), NaN where the model's own value stays."""

    strength: Float64
    friction: Float64
    armature: Float64
    delay: Float64

    @property
    def words(self) -> list[str]:
        """What is said of any joint, in the order of `JOINT_PHYSICS`."""
        return [word for word in JOINT_PHYSICS if not np.isnan(getattr(self, word)).all()]


def joint_physics(robot: Robot, said: Said) -> JointPhysics:
    """Return what is said of a robot's joints: what the robot file says, then `said` over it.

    Args:
        robot: the robot.
        said: joint names and patterns to word and figure; of two that meet the later one counts.

    Raises:
        WorkflowError: no such joint.
    """
    arrays = {word: np.full(robot.num_joints, np.nan) for word in JOINT_PHYSICS}
    for each in (robot.simulated, said):
        for pattern, figures in each.items():
            joints = joints_like(pattern, robot)
            for word, figure in figures.items():
                arrays[word][joints] = figure
    return JointPhysics(**arrays)


def robot_names() -> list[str]:
    """Return the names of the robots that `load_robot` finds, sorted."""
    return list_config("robots")


def load_robot(name_or_path: str | Path) -> Robot:
    """Read and check a robot file.

    Args:
        name_or_path: a name (`go2`), or a path to a robot file.

    Raises:
        RobotError: no such robot, or the file is wrong: file, line, culprit and remedy, with a
            line for each mistake.
    """
    path = find_config("robots", name_or_path, error=RobotError)
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
    arrays: AnyDict = {
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
        imu=None
        if imu is None
        else Imu(imu.frame, _array(imu.position or [None] * 3), _array(imu.quat or [None] * 4)),
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
    path = find_config("robots", overlay.extends, error=RobotError, relative_to=folder)
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


def _array(values: Iterable[float | None]) -> Float32:
    array = np.array([np.nan if value is None else value for value in values], np.float32)
    array.setflags(write=False)
    return array


# Keys of `transport` that are about the joints of one member.
_OF_A_MEMBER = ("motors", "command")


def compose(members: Mapping[str, Robot], mounts: Mapping[str, Place] | None = None) -> Robot:
    """Return the whole robot.

    A joint name that several members have is told apart by `MEMBER_` in front of it; the first
    member's joints keep their names, for which policies are made. Members whose vendor closes the
    position loop have no gains: 1 stands for "on", as everywhere.

    Args:
        members: name to robot, at least one.
        mounts: name of a member, or of its robot, to its place, over what the base's file says.

    Raises:
        RobotError: two joints would have the same name, or two members the same place.
    """
    base_name = next(iter(members))
    base = members[base_name]
    counted = Counter(name for robot in members.values() for name in robot.joint_names)
    names = tuple(
        f"{member}_{name}" if counted[name] > 1 and member != base_name else name
        for member, robot in members.items()
        for name in robot.joint_names
    )
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise RobotError(
            f"robot of {', '.join(members)}: two joints are called {twice!r}; name a member "
            "otherwise, or one of the joints in its file"
        )
    arrays: AnyDict = {
        field: _array(np.concatenate([_gains(robot, field) for robot in members.values()]))
        for field in JOINT_FIELDS.values()
    }
    simulated: dict[str, Mapping[str, float]] = {}
    at = 0
    for robot in members.values():
        for joint, figures in robot.simulated_joints().items():
            simulated[names[at + robot.joint_names.index(joint)]] = figures
        at += robot.num_joints
    others = [robot.name for member, robot in members.items() if member != base_name]
    return replace(
        base,
        name="_with_".join([base.name, *(["_and_".join(others)] if others else [])]),
        description="; ".join(robot.description for robot in members.values()),
        models={},
        joint_names=names,
        **arrays,
        transport={k: v for k, v in base.transport.items() if k not in _OF_A_MEMBER},
        unknown=tuple(f"{m}: {fact}" for m, robot in members.items() for fact in robot.unknown),
        simulated=simulated,
        mounts=_mounted(members, {**base.mounts, **(mounts or {})}),
        hand=None,
        overlay=None,
        members=dict(members),
        groups={group: joints for group, joints in base.groups.items() if group not in members},
    )


def _mounted(members: Mapping[str, Robot], said: Mapping[str, Place]) -> dict[str, Place]:
    """Return the place of each member that has one; its name goes before that of its robot."""
    found: dict[str, Place] = {}
    for member, robot in list(members.items())[1:]:
        mount = said.get(member) or said.get(robot.name)
        if mount is None:
            continue
        for other, its in found.items():
            if (its.body, its.position) == (mount.body, mount.position):
                raise RobotError(
                    f"robot of {', '.join(members)}: {other} and {member} are both mounted on "
                    f"{mount.body} at {list(mount.position)}; give one another place: "
                    f"scene: {{mounts: {{{member}: {{body: …, position: …}}}}}}"
                )
        found[member] = mount
    return found


def robot_files(robot: Robot) -> dict[str, Path]:
    """Return the files that a robot was read from: member to file, "" for one without members."""
    return {member: each.path for member, each in (robot.members or {"": robot}).items()}


def load_files(files: Mapping[str, str | Path], mounts: Mapping[str, Place] | None = None) -> Robot:
    """Return the robot of these files, as `robot_files` names them, with mounts as of `compose`."""
    robots = {member: load_robot(path) for member, path in files.items()}
    return compose(robots, mounts) if "" not in robots else robots[""]


def _gains(robot: Robot, field: str) -> Float32:
    values: Float32 = getattr(robot, field)
    if robot.position_controlled and field in ("joint_stiffness", "joint_damping"):
        return np.where(np.isnan(values), np.float32(1.0), values)
    return values
