"""A robot as the rest of unicon sees it: arrays in the vendor's motor order, places and capsules.

mounts:
  dex3_left: {body: left_wrist_yaw_link, position: [0.0415, 0.003, 0.0], quat: [1, 0, 0, 0]}
end_effectors:
  left_hand: {body: left_wrist_yaw_link, position: [0.12, 0.0, 0.0]}
capsules:
  left_forearm: {body: left_elbow_link, from: [0.02, 0.0, 0.0], to: [0.18, 0.0, 0.0], radius: 0.05}
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Annotated, Literal, get_args

import numpy as np

from unicon_base import AnyMapping, RobotError, alternatives
from unicon_base.arrays import Bool, Float32, Index
from unicon_base.schema.marks import Key, Matches, NotEmpty, Point, Quat, Text, Write, positive


@dataclass(frozen=True)
class Place:
    """A frame that is fixed to a body of the robot's model.

    Attributes:
        body: body of the model that carries it.
        position: in the frame of that body in [m].
        quat: rotation of the frame to that body, unit quaternion wxyz.
    """

    body: Text
    position: Point = (0.0, 0.0, 0.0)
    quat: Quat = (1.0, 0.0, 0.0, 0.0)


Places = Annotated[
    dict[str, Place],
    Write("{left_hand: {body: left_wrist_yaw_link, position: [x, y, z], quat: [w, x, y, z]}}"),
]
"""Name to place."""


@dataclass(frozen=True)
class Capsule:
    """All points within a radius of a segment; one of length 0 is a sphere.

    Attributes:
        body: body of the model that carries it.
        start: of the segment, in the frame of that body in [m].
        radius: in [m].
        end: likewise; `start` where it is left out.
    """

    body: Text
    start: Annotated[Point, Key("from")]
    radius: Annotated[float, positive(1.0, "m")]
    end: Annotated[Point, Key("to")] = ()  # type: ignore[assignment]

    def __post_init__(self) -> None:
        object.__setattr__(self, "end", self.end or self.start)


Capsules = Annotated[
    dict[str, Capsule],
    Write("{left_forearm: {body: left_elbow_link, from: [x, y, z], to: [x, y, z], radius: 0.05}}"),
]
"""Name to capsule."""

Finger = Literal["thumb", "index", "middle", "ring", "pinky"]
"""As of the joints of a human hand in WebXR; a robot may have fewer."""

FINGERS: tuple[Finger, ...] = get_args(Finger)
SIDES = ("left", "right")


@dataclass(frozen=True)
class Hand:
    """Which part of a robot's hand is which of a human's.

    Attributes:
        palm: frame of the palm: x to the fingers, z out of the back of the hand, y to the left of
            both.
        fingers: finger, in the order of `FINGERS`, to the place of its tip.
        side: left or right; left out where the file is of both: its places are the left's then.
    """

    palm: Place
    fingers: Annotated[Mapping[Finger, Place], NotEmpty, Write("{thumb: {body: …}, index: …}")]
    side: Annotated[str, Matches("left|right", "left or right, and nothing for both")] = ""

    def __post_init__(self) -> None:
        ordered = {finger: self.fingers[finger] for finger in FINGERS if finger in self.fingers}
        object.__setattr__(self, "fingers", ordered)

    def of(self, side: str) -> Hand:
        """Return the hand of a side; where the file is of both, y is mirrored for the right one."""
        if self.side or side != "right":
            return self
        fingers = {finger: _mirrored(place) for finger, place in self.fingers.items()}
        return Hand(_mirrored(self.palm), fingers, side)


def _mirrored(place: Place) -> Place:
    (x, y, z), (qw, qx, qy, qz) = place.position, place.quat
    return Place(place.body, (x, -y, z), (qw, -qx, qy, -qz))


MODEL_FORMATS = ("mjcf", "urdf")


# Key of a joint in a robot file -> field of `Robot`.
JOINT_FIELDS = {
    "lower": "lower",
    "upper": "upper",
    "velocity": "velocity_limit",
    "effort": "effort_limit",
    "default": "default_joint_pos",
    "rest": "rest_joint_pos",
    "stiffness": "joint_stiffness",
    "damping": "joint_damping",
}

JOINT_ORDER = "order `joints:` as the robot does and take joint_order out of `unknown`"
"""How the fact `joint_order` is given, which is no key of a robot file."""

_NEEDED = ("lower", "upper", "default")
# What a servo needs besides whose loop is closed by us; a hand that takes positions has its own.
_NEEDED_FOR_TORQUE = ("velocity", "effort", "stiffness", "damping")
# Keys of `transport` without whose figure drivers and gates do the rest, or refuse by name.
_MAY_LACK = ("current_scale", "mode_machine", "motors", "rate_hz", "stop_buttons")


@dataclass(frozen=True, eq=False)
class Imu:
    """The inertial sensor and its pose in the robot's base frame.

    Attributes:
        frame: name of the sensor's frame.
        position: in the base frame in [m], shape (3,), NaN where unknown.
        quat: rotation sensor to base, unit quaternion wxyz, shape (4,), NaN where unknown.
    """

    frame: str
    position: Float32
    quat: Float32


@dataclass(frozen=True, eq=False)
class Robot:
    """A robot file, read and checked. Arrays are float32, shape (n,), read-only, NaN = unknown.

    Attributes:
        kind: quadruped, humanoid, wheeled, hand or arm.
        path: the file that it was read from.
        models: format (`mjcf`, `urdf`) to model: relative to a configuration root, or
            `assets:PATH`.
        base_frame: frame of the base, in which the IMU's pose is given.
        joint_names: the joints in the vendor's motor order; every array here is in this order.
        lower: smallest allowed position in [rad] ([m] for sliding joints); -inf of a wheel.
        upper: largest allowed position in [rad]; inf of a wheel.
        velocity_limit: largest allowed speed in [rad/s].
        effort_limit: largest allowed torque in [N·m].
        default_joint_pos: standing pose in [rad].
        rest_joint_pos: lying or powered-off pose in [rad].
        joint_stiffness: default proportional gain in [N·m/rad].
        joint_damping: default derivative gain in [N·m·s/rad].
        feet: bodies, sites or geoms of the model that touch the ground; the fingertips of a hand.
        transport: `protocol` names the platform adapter; the rest are its facts.
        sources: where each group of facts was taken from.
        unknown: dotted facts that were not found, such as `joints.velocity`.
        command_ranges: `vx`, `vy` in [m/s] and `wz` in [rad/s] to the lowest and highest allowed
            command.
        simulated: what simulators alone are told: joint or pattern to figures, see `joint_physics`.
        overlay: the file that `extends` it, where it was read through one.
        members: name to robot, of a robot made of robots, in the order of the joints; see
            `compose`.
        groups: name to joints in the robot's order, such as `legs`; groups may overlap.
        mounts: where its model carries others: name of a member, or of the robot there, to the
            place; of a robot made of members, each one's.
        end_effectors: name to the frame that is brought to a target, such as `left_hand`; of a
            robot made of members, those of its first one.
        capsules: name to the capsule that stands for a link, or a part of one, where links are kept
            apart.
        hand: of a hand: its side, its palm and its fingers; of a robot made of members each says
            its.
        weldable: joints that no policy of the workflow moves: a simulated model may lack them.
    """

    name: str
    description: str
    manufacturer: str
    kind: str
    path: Path
    models: Mapping[str, str]
    base_frame: str
    joint_names: tuple[str, ...]
    lower: Float32
    upper: Float32
    velocity_limit: Float32
    effort_limit: Float32
    default_joint_pos: Float32
    rest_joint_pos: Float32
    joint_stiffness: Float32
    joint_damping: Float32
    imu: Imu | None
    feet: tuple[str, ...]
    transport: AnyMapping
    sources: Mapping[str, str]
    unknown: tuple[str, ...]
    command_ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    simulated: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    overlay: Path | None = None
    members: Mapping[str, Robot] = field(default_factory=dict)
    groups: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    mounts: Mapping[str, Place] = field(default_factory=dict)
    end_effectors: Mapping[str, Place] = field(default_factory=dict)
    capsules: Mapping[str, Capsule] = field(default_factory=dict)
    hand: Hand | None = None
    weldable: frozenset[str] = frozenset()

    @property
    def num_joints(self) -> int:
        """Number of joints, n."""
        return len(self.joint_names)

    @property
    def walks(self) -> bool:
        """Whether it has feet and a base that floats."""
        return self.kind in ("quadruped", "humanoid")

    @property
    def floats(self) -> bool:
        """Whether its base moves about: it walks, or has wheels."""
        return self.walks or self.kind == "wheeled"

    @property
    def endless(self) -> Bool:
        """Joints that turn without end, such as wheels, shape (n,)."""
        return np.isinf(self.lower) & np.isinf(self.upper)

    def limits(self, unknown: float = np.inf) -> tuple[Float32, Float32]:
        """Return the smallest and largest positions, each shape (n,); ∓`unknown` for unknown."""
        lower = np.nan_to_num(self.lower, nan=-unknown)
        return lower, np.nan_to_num(self.upper, nan=unknown)

    @property
    def position_controlled(self) -> bool:
        """Whether the vendor closes the loop: positions are sent, there are no gains to give."""
        return self.transport.get("command") == "position"

    @property
    def by_position(self) -> Bool:
        """Joints whose vendor closes the position loop, shape (n,); they stop at what they grip."""
        robots = self.members.values() or (self,)
        return np.repeat(
            [robot.position_controlled for robot in robots], [robot.num_joints for robot in robots]
        )

    def joints_of(self, member: str) -> slice:
        """Return where the joints of a member stand in every array; `member` is in `members`."""
        start = 0
        for name, robot in self.members.items():
            if name == member:
                return slice(start, start + robot.num_joints)
            start += robot.num_joints
        raise KeyError(member)

    def group(self, words: Sequence[str]) -> Index:
        """Return the places of joints in the robot's order, each once, shape (k,).

        Args:
            words: groups, members, and names or patterns (`*`, `?`) of joints.

        Raises:
            RobotError: a word means no joint.
        """
        found: set[str] = set()
        for word in words:
            if word in self.groups:
                joints: Sequence[str] = self.groups[word]
            elif word in self.members:
                joints = self.joint_names[self.joints_of(word)]
            else:
                joints = [name for name in self.joint_names if fnmatchcase(name, str(word))]
            if not joints:
                known = [*self.groups, *self.members, *self.joint_names]
                raise RobotError(
                    f"robot {self.name} has no group or joint {word!r}; "
                    f"{alternatives(str(word), known)}"
                )
            found.update(joints)
        places = [i for i, name in enumerate(self.joint_names) if name in found]
        return np.array(places, np.intp)

    def file_of(self, joint: str) -> Path:
        """Return the file that says the facts of a joint."""
        for member, robot in self.members.items():
            if joint in self.joint_names[self.joints_of(member)]:
                return robot.path
        return self.path

    def simulated_joints(self) -> dict[str, Mapping[str, float]]:
        """Return `simulated` joint by joint, patterns resolved."""
        said: dict[str, dict[str, float]] = {}
        for pattern, figures in self.simulated.items():
            for name in self.joint_names:
                if fnmatchcase(name, pattern):
                    said.setdefault(name, {}).update(figures)
        return dict(said)

    def joint_fact(self, field: str) -> Float32:
        """Return the array behind a key of a joint in the robot file, shape (n,).

        Args:
            field: `lower`, `upper`, `velocity`, `effort`, `default`, `rest`, `stiffness` or
                `damping`.
        """
        array: Float32 = getattr(self, JOINT_FIELDS[field])
        return array

    def missing_facts(self) -> list[str]:
        """Return the facts that are still missing for driving the real robot, in the file's words.

        Needed are the motor order, the position limits, the standing pose, the protocol and, unless
        the vendor closes the position loop, the speed and torque limits and the gains; of a robot
        that walks also how the IMU is turned; and whatever else of `transport` the file leaves
        null, but for what a driver can do without.
        An empty list means that it can be driven. `check`, `robots` and every start ask here.
        """
        if self.members:
            each = ((m, robot.missing_facts()) for m, robot in self.members.items())
            return [f"{fact} of {member}" for member, facts in each for fact in facts]
        needed = _NEEDED if self.position_controlled else _NEEDED + _NEEDED_FOR_TORQUE
        missing = ["joint_order"] if "joint_order" in self.unknown else []
        missing += [f"joints.{key}" for key in needed if np.isnan(self.joint_fact(key)).any()]
        if self.walks:
            if self.imu is None:
                missing.append("imu")
            elif np.isnan(self.imu.quat).any():
                missing.append("imu.quat")
        transport = {"protocol": None, **self.transport}
        lacking = (key for key, value in transport.items() if value is None)
        return missing + [f"transport.{key}" for key in lacking if key not in _MAY_LACK]


def joint_index(to: Sequence[str], from_: Sequence[str], *, loose: bool = False) -> Index:
    """Return the index that brings an array from one joint order into another.

    `x_from[joint_index(to, from_)]` is in the order of `to`: the result is a `to_from_from_`,
    such as `policy_from_robot = joint_index(policy.joint_names, robot.joint_names)`.

    Args:
        to: the joint names wanted, in their order; a subset of `from_`.
        from_: the joint names at hand, in their order.
        loose: where the exact name is not there, the one is meant that is equal but for a namespace
            (`g1/…`) and the ending `_joint`: models of others.

    Returns:
        Indices into `from_`, shape (len(to),).

    Raises:
        RobotError: a joint of `to` is not in `from_`, or could be two of it; a list names a joint
            twice.
    """
    for which, names in (("wanted", to), ("given", from_)):
        twice = sorted({name for name in names if list(names).count(name) > 1})
        if twice:
            raise RobotError(
                f"joint {twice[0]!r} stands twice in the {which} joint order; name each joint once"
            )
    position = {name: i for i, name in enumerate(from_)}
    alike: dict[str, list[str]] = {}
    for name in from_ if loose else ():
        alike.setdefault(plain_name(name), []).append(name)
    found: list[int] = []
    for name in to:
        fits = [name] if name in position else alike.get(plain_name(name), [])
        if not fits:
            raise RobotError(f"no joint {name!r}; {alternatives(name, from_)}")
        if len(fits) > 1:
            raise RobotError(f"joint {name!r} could be any of {', '.join(fits)}")
        if position[fits[0]] in found:
            raise RobotError(f"joint {name!r} and another one are both {fits[0]!r}")
        found.append(position[fits[0]])
    return np.array(found, np.intp)


def plain_name(name: str) -> str:
    """Return a joint name without namespace and without the ending `_joint`."""
    return name.rsplit("/", 1)[-1].removesuffix("_joint")
