"""A parsed mapping as plain values: from the loader, for encoders, decoders and bridges."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Literal

from unicon_base.schema.marks import Matches, NotAKey, Unit, Within
from unicon_msgs_map.errors import MapFileError, MapStateError, MessageTypeError
from unicon_msgs_map.layout.paths import Path, Reference

if TYPE_CHECKING:
    from unicon_msgs_map.layout.messages import Messages


Numbers = float | tuple[float, ...]

# https://design.ros2.org/articles/topic_and_service_names.html
RosName = Annotated[
    str,
    Matches(
        r"(?!.*__)(?:~?/)?[A-Za-z_][A-Za-z0-9_]*(?:/[A-Za-z_][A-Za-z0-9_]*)*",
        "a ROS name: words of letters, digits and '_' between slashes, like imu/data",
        255,
    ),
]
"""A name of a topic or action."""

LONGEST_TIMEOUT = 60.0
"""Of a subscription in [s]: its states are commands and sensors, and a robot falls within 1."""
Timeout = Annotated[float | None, Unit("s"), Within(0.0, LONGEST_TIMEOUT, above=True)]
Tolerance = Annotated[float, Unit("rad"), Within(0.0, LONGEST_TIMEOUT)]
QosTime = Annotated[float | None, Unit("s"), Within(0.0, 86_400.0, above=True)]
"""Of deadline, lifespan and lease: at most a day."""


@dataclass(frozen=True)
class Qos:
    """Quality of service of one topic; times in [s], None is the middleware's default.

    Attributes:
        reliability: `reliable` or `best_effort`.
        durability: `volatile` or `transient_local` (late joiners get the last messages).
        history: `keep_last` or `keep_all`.
        depth: messages kept.
        deadline: longest gap between messages that a reader accepts, [s].
        lifespan: age after which a message is dropped, [s].
        liveliness: `automatic` or `manual_by_topic`.
        liveliness_lease: time after which a silent writer counts as gone, [s].
    """

    reliability: Literal["reliable", "best_effort"] = "reliable"
    durability: Literal["volatile", "transient_local"] = "volatile"
    history: Literal["keep_last", "keep_all"] = "keep_last"
    depth: Annotated[int, Within(1)] = 10
    deadline: QosTime = None
    lifespan: QosTime = None
    liveliness: Literal["automatic", "manual_by_topic"] = "automatic"
    liveliness_lease: QosTime = None


@dataclass(frozen=True)
class FieldSpec:
    """One message field and what stands on our side of it.

    The value written is `value read × unit × scale + offset`, element by element; the unit
    factor leads from SI to the message's unit on publish and back on subscribe.

    Attributes:
        path: as written.
        steps: the parsed path.
        source: state, variable or constant.
        scale: factor, one or per element (a `sign` is part of it).
        offset: summand in the written value's unit, one or per element.
        unit: the message's unit, see `unicon_msgs_map.spec`; None is SI.
        quat: element order, `xyzw_from_wxyz`, `wxyz_from_xyzw` or `none`; None is automatic:
            geometry_msgs/Quaternion is converted, anything else is not.
        by: on subscribe, path of the names that order this array; `none` takes it by position;
            None is automatic.
        text: on publish into a string, a `format()` spec with a fixed width such as `8.2f`.
        checksum: on publish, `unitree` writes the CRC of the message's C struct here.
        where: `file:line: entry` for messages.
    """

    path: str
    steps: Path
    source: Reference
    scale: Numbers = 1.0
    offset: Numbers = 0.0
    unit: str | None = None
    quat: str | None = None
    by: str | None = None
    text: str | None = None
    checksum: str | None = None
    where: str | None = None

    def file_error(self, text: str) -> MapFileError:
        """Return the error to raise where the mapping of this field is wrong."""
        return MapFileError(f"{self.path}: {text}", self.where)

    def type_error(self, text: str) -> MessageTypeError:
        """Return the error to raise where the path does not fit the message type."""
        return MessageTypeError(f"{self.path}: {text}", self.where)

    def state_error(self, text: str) -> MapStateError:
        """Return the error to raise where our side does not fit the message field."""
        return MapStateError(f"{self.path}: {text}", self.where)


@dataclass(frozen=True)
class TopicSpec:
    """What topics of both directions have.

    Attributes:
        topic: relative names take the node's namespace.
        type: full type name, `pkg/msg/Name`.
        fields: what is mapped.
        messages: the type store that defines `type`.
        rate: [Hz], at most that often; None is every tick.
        qos: quality of service.
        optional: leave the topic out where a state or the ROS type is missing.
        where: `file:line: entry` for messages.
    """

    topic: str
    type: str
    fields: tuple[FieldSpec, ...]
    messages: Messages = field(repr=False, compare=False)
    rate: float | None = None
    qos: Qos = Qos()
    optional: bool = False
    where: str | None = None

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the states that the message reads or writes, in field order."""
        return tuple(dict.fromkeys(f.source.name for f in self.fields if f.source.kind == "state"))


@dataclass(frozen=True)
class PublishSpec(TopicSpec):
    """One topic that we publish; fields not mapped are zero, empty, or (Quaternion) identity."""

    def every(self, period: float) -> int:
        """Return how many ticks of `period` [s] lie from one message to the next: at least 1."""
        return 1 if self.rate is None else max(1, round(1.0 / (self.rate * period)))


@dataclass(frozen=True, kw_only=True)
class Reception:
    """What a subscription does with messages, and without.

    Attributes:
        timeout: [s] without an accepted message after which `on_timeout` applies; None is never.
        on_timeout: `zero` sets the written states to zero, `hold` leaves them, `unset` makes them
            NaN, which says that nobody commands.
        missing: elements of ours that the message lacks: `hold`, `zero` or `error`.
        extra: elements of the message that we lack: `ignore` or `error`.
        unnamed: a message that should carry names and has none: `error`, or `order` to take
            the elements in our order where their number is ours.
        nonfinite: NaN and infinities: `reject` the message or `accept` them.
    """

    timeout: Timeout = None
    on_timeout: Literal["zero", "hold", "unset"] = "zero"
    missing: Literal["hold", "zero", "error"] = "hold"
    extra: Literal["ignore", "error"] = "ignore"
    unnamed: Literal["error", "order"] = "error"
    nonfinite: Literal["reject", "accept"] = "reject"


@dataclass(frozen=True)
class SubscribeSpec(TopicSpec, Reception):
    """One topic that we receive; fields not mapped are skipped."""


@dataclass(frozen=True)
class TrajectorySpec:
    """Where joint trajectories come in, whole and not field by field.

    Attributes:
        topic: of trajectory_msgs/msg/JointTrajectory, or None.
        action: of control_msgs/action/FollowJointTrajectory, or None.
        missing: joints that a trajectory lacks: `error`, or `hold`.
        start_tolerance: how far a first point at 0 s may be from the joints in [rad].
        path_tolerance: how far joints may be off on the way in [rad]; 0 does not ask.
        goal_tolerance: how far they may be off at the end in [rad]; 0 does not ask.
        goal_time: how long after its end the goal may be reached in [s]; 0 waits without an end.
        where: `file:line` for messages.
    """

    topic: RosName | None = None
    action: RosName | None = None
    missing: Literal["error", "hold"] = "error"
    start_tolerance: Tolerance = 0.1
    path_tolerance: Tolerance = 0.0
    goal_tolerance: Tolerance = 0.0
    goal_time: Annotated[float, Unit("s"), Within(0.0, LONGEST_TIMEOUT)] = 0.0
    where: Annotated[str | None, NotAKey()] = None

    def __post_init__(self) -> None:
        """Refuse one that comes in nowhere.

        Raises:
            MapFileError: there is neither topic nor action.
        """
        if self.topic is None and self.action is None:
            raise MapFileError("give topic or action, or both")


@dataclass(frozen=True)
class MessageMap:
    """A mapping file: topics out and topics in.

    Attributes:
        publish: topics out.
        subscribe: topics in.
        trajectory: where joint trajectories come in, or None.
        messages: the type store that defines their types.
        path: the file, where there is one.
        description: the file's own words.
    """

    publish: tuple[PublishSpec, ...]
    subscribe: tuple[SubscribeSpec, ...]
    messages: Messages = field(repr=False, compare=False)
    path: str | None = None
    description: str = ""
    trajectory: TrajectorySpec | None = None


PER_SI: dict[str, float] = {
    # angle, angular velocity
    "rad": 1.0,
    "deg": 180.0 / math.pi,
    "mrad": 1e3,
    "rev": 1.0 / (2.0 * math.pi),
    "rad/s": 1.0,
    "deg/s": 180.0 / math.pi,
    "rpm": 60.0 / (2.0 * math.pi),
    # length, velocity, acceleration
    "m": 1.0,
    "cm": 1e2,
    "mm": 1e3,
    "m/s": 1.0,
    "mm/s": 1e3,
    "km/h": 3.6,
    "m/s^2": 1.0,
    "g": 1.0 / 9.80665,  # standard gravity, 3rd CGPM (1901)
    # force, torque, mass
    "N": 1.0,
    "kN": 1e-3,
    "N*m": 1.0,
    "mN*m": 1e3,
    "kg": 1.0,
    # time
    "s": 1.0,
    "ms": 1e3,
    "us": 1e6,
    "ns": 1e9,
    # electricity, ratio
    "V": 1.0,
    "mV": 1e3,
    "A": 1.0,
    "mA": 1e3,
    "ratio": 1.0,
    "percent": 1e2,
}
