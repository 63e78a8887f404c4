"""Scene: how a simulation begins and what disturbs it, the same on every simulator.

scene: {initial_pose: rest, noise: {joint_vel: 0.1}, push: {every: 2.0, velocity: 0.5}}
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Annotated

import numpy as np

from unicon_base import AnyMapping, PlatformError, alternatives
from unicon_base.arrays import Float32, Float64
from unicon_base.schema.marks import Like, NotAKey, Point, Unit, Within, Write, positive
from unicon_base.schema.read import check_made
from unicon_base.schema.records import record_of
from unicon_core.models.find import pick_model
from unicon_core.robots import Robot
from unicon_core.robots.file import Simulated
from unicon_core.robots.load import named_pose, robot_poses
from unicon_core.robots.robot import Places
from unicon_core.terrain.ground import refuse_endless_ground
from unicon_core.terrain.words import FLAT, Terrain, read_terrain

CONTACT = "contact_friction"
"""Word of `Facts.physics`: feet touch the ground."""

BODY_PHYSICS = ("payload", CONTACT)
"""Words of `Facts.physics` that are about bodies."""

HEAVIEST = 1000.0
"""Of a payload in [kg]."""

ROUGHEST = 20.0
"""Factor on friction: rubber on rubber has some 1.2, ice on steel 0.03 (about a fortieth)."""


@dataclass(frozen=True)
class Payload:
    """A point with mass that is fixed to a body.

    Attributes:
        mass: of the point.
        body: of the model; the base's unless given.
        position: in that body's frame; its centre of mass unless given.
    """

    mass: Annotated[float, Within(0.0, HEAVIEST, "kg")]
    body: str = ""
    position: Point = (0.0, 0.0, 0.0)


GANTRY = "gantry"
"""Word of `Facts.physics`: a base that is held."""

DISTURBANCES = ("seed", "noise", "delay", "push", "joints", "payload", "contact_friction")
"""What a simulator can be told and a robot cannot."""

KEYFRAME = "keyframe:"

TERRAIN = "terrain"
"""Word of `Facts.physics`: ground that is not flat."""

LONGEST_DELAY = 1000
"""In ticks."""


@dataclass(frozen=True)
class Push:
    """Random horizontal pushes of the base.

    Attributes:
        every: mean time between two.
        velocity: by which each changes the base's.
    """

    every: Annotated[float, positive(unit="s")]
    velocity: Annotated[float, positive(unit="m/s")]


@dataclass(frozen=True, eq=False)
class Scene:
    """What is meant for every simulator.

    Attributes:
        model: MJCF or URDF file, `assets:PATH` or `robot_descriptions:NAME`; None for the robot
            file's.
        initial_pose: `default` or `rest` of the robot file, `model` (as the model file has it),
            `keyframe:NAME` of the model, or joints to [rad] over the default pose. In a workflow
            also `policy:NAME`, its default pose.
        initial_height: of the base in [m]; None sets the robot on the floor.
        gantry: whether springs hold a base that can move where it begins, upright: nobody has to
            balance it.
        terrain: a kind of ground, or a kind to its figures, see `terrain/words.py`; a robot stands
            on the ground that is there.
        seed: of noise and pushes, and of ground that has none of its own; robot k of a batch draws
            from (seed, k), all stand on the same ground.
        delay: ticks by which commands come late.
        noise: state to standard deviation of white noise, in the state's unit.
        push: `every` in [s] and `velocity` in [m/s]: random horizontal pushes of the base.
        joints: joint names and patterns to `strength`, `friction`, `armature` and `delay` in place
            of the model's, see `robots/poses.py`; over those of the robot file.
        payload: `mass` [kg] of a point that is fixed to a `body` of the model (the base's unless
            told) at `position` [m] in that body's frame (its centre of mass unless told).
        contact_friction: factor on the friction of all contacts, with floor and things alike.
        mounts: member to `body`, `position` [m] and `quat` (wxyz) where its model sits on the first
            member's, over the robot file's; the builder gives them to the robot.
        folder: of the workflow, for a relative `model`; not a key of the file.
        pose: all joints in [rad], shape (n,), in place of `initial_pose`; not a key of the file.

    Raises:
        PlatformError: a value is wrong.
    """

    model: str | Path | None = None
    initial_pose: str | Mapping[str, Annotated[float, Unit("rad")]] = "default"
    initial_height: Annotated[float | None, Within(-100.0, 100.0, "m")] = None
    gantry: bool = False
    terrain: str | AnyMapping = FLAT
    seed: Annotated[int, Within(0)] = 0
    delay: Annotated[int, Within(0, LONGEST_DELAY, "ticks")] = 0
    noise: Mapping[str, Annotated[float, Within(0.0)]] = field(default_factory=dict)
    push: Annotated[Mapping[str, float], Like(Push), Write("{every: 2.0, velocity: 0.5}")] = field(
        default_factory=dict
    )
    joints: Simulated = field(default_factory=dict)
    payload: Annotated[AnyMapping, Like(Payload), Write("{mass: 3.0}")] = field(
        default_factory=dict
    )
    contact_friction: Annotated[float, Within(0.0, ROUGHEST)] = 1.0
    mounts: Places = field(default_factory=dict)
    folder: Annotated[Path | None, NotAKey()] = None
    pose: Annotated[Float32 | None, NotAKey()] = None

    def __post_init__(self) -> None:
        check_made(self, PlatformError, "scene")
        if self.uneven is not None:
            refuse_endless_ground(self.uneven)

    @property
    def posed_by_model(self) -> bool:
        """Whether the model file says the initial pose, and with it the height."""
        pose = self.initial_pose
        return (
            self.pose is None
            and isinstance(pose, str)
            and (pose == "model" or pose.startswith(KEYFRAME))
        )

    def begins_as(self, other: Scene) -> bool:
        """Return whether a robot begins where it does in another scene of the same model."""
        ours = self.pose
        theirs = other.pose
        return (
            (self.initial_pose, self.initial_height) == (other.initial_pose, other.initial_height)
            and (ours is None) == (theirs is None)
            and (ours is None or theirs is None or np.array_equal(ours, theirs))
        )

    @property
    def bodies(self) -> list[str]:
        """What is said of bodies, base and ground, in the words of a platform's facts."""
        said = {"payload": bool(self.payload), "contact_friction": self.contact_friction != 1.0}
        words = [word for word in BODY_PHYSICS if said[word]] + [GANTRY] * self.gantry
        return words if self.uneven is None else [*words, TERRAIN]

    @cached_property
    def uneven(self) -> Terrain | None:
        """The ground, None where it is flat."""
        return read_terrain(self.terrain, self.seed)

    @property
    def disturbed(self) -> bool:
        """Whether anything makes the simulation less perfect."""
        return bool(self.delay or self.noise or self.push)

    def model_path(self, robot: Robot) -> Path:
        """Return the model file: the scene's, else the robot file's.

        Raises:
            ModelError: neither names one, or it is not there.
        """
        return pick_model(robot, self.model, self.folder)

    def joint_pos(self, robot: Robot) -> Float64:
        """Return the initial joint positions in [rad], shape (n,); unknown ones stand, or are 0.

        Raises:
            PlatformError: no such pose, or only a model says it.
            WorkflowError: no such joint.
        """
        poses = robot_poses(robot)
        pose = self.initial_pose
        standing = np.nan_to_num(poses["default"].astype(np.float64))
        if self.pose is not None:
            return self.pose.astype(np.float64)
        if not isinstance(pose, str):
            said, which = named_pose(pose, robot, "scene.initial_pose")
            return np.where(which > 0.0, said, standing)
        if pose not in poses:
            known = alternatives(pose, (*poses, "model", f"{KEYFRAME}NAME", "policy:NAME"))
            raise PlatformError(f"scene.initial_pose is {pose!r}; {known}; or joints to [rad]")
        named = poses[pose].astype(np.float64)
        return np.where(np.isnan(named), standing, named)


SCENE_KEYS = tuple(record_of(Scene).keys)
