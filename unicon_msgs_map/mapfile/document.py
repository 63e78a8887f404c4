"""What a mapping file says, as classes that `unicon_base.schema` reads; it knows no message types.

A file that includes others may leave out of an entry what theirs say, so `missing_keys` judges what
all of them say together.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np

from unicon_base import AnyDict
from unicon_base.located_yaml import Located
from unicon_base.schema.marks import Checked, Matches, Text, Unit, Within, Write
from unicon_base.schema.types import Here, Mistakes, show
from unicon_msgs_map.errors import MapFileError
from unicon_msgs_map.spec import PER_SI, Numbers, Qos, Reception, RosName, TrajectorySpec

DIRECTIONS = ("publish", "subscribe")
HIGHEST_RATE = 10_000.0
"""In [Hz]: as of a workflow's ticks."""
LARGEST = 1e12
"""|scale| and |offset|: nanoseconds in a second are 1e9. What is infinite makes NaN of a 0."""
WIDEST_TEXT = 64

QOS_PROFILES: dict[str, Qos] = {
    "default": Qos(),
    "sensor_data": Qos(reliability="best_effort", depth=5),
    "latest": Qos(reliability="best_effort", depth=1),
    "latched": Qos(durability="transient_local", depth=1),
}


def _wrong_text(form: str) -> str:
    if any(len(n) > 2 or int(n) > WIDEST_TEXT for n in re.findall(r"[0-9]+", form)):
        return f"is {form[:40]!r}, wider than {WIDEST_TEXT}; write 8.2f"
    try:
        width = len(format(0.0, form))
    except ValueError:
        return f"is {form!r}, which is not a format; write a width, as in 8.2f"
    if width != len(format(-1.5, form)) or width < 2:
        return f"is {form!r}, which has no fixed width; write one, as in 8.2f"
    return ""


def _wrong_constant(value: Any) -> str:
    return f"is {show(value)}; write a mapping" if isinstance(value, Mapping) else ""


Offset = Annotated[float, Within(-LARGEST, LARGEST)]
Scale = Annotated[Offset, Checked(lambda x: "" if x else "is 0; drop the field instead")]
Sign = Annotated[
    float,
    Checked(
        lambda x: "" if abs(x) == 1.0 else f"is {x:g}; write 1 or -1, and other factors as scale"
    ),
]
Constant = Annotated[Any, Checked(_wrong_constant)]
"""A reference such as `joint_pos[3:6]`, `$joint_names` or `=text`, or a number, boolean or list."""


@dataclass(frozen=True)
class Conversion:
    """A field whose value is more than copied: value × unit × scale + offset, for each element.

    Attributes:
        state: a state, such as joint_pos[3:6].
        const: or a constant.
        scale: factor, one or per element.
        sign: 1 or -1, one or per element.
        offset: summand in the unit of the value that is written, one or per element.
        unit: the message's unit; SI unless given.
        quat: order of a quaternion's elements, from and to; `none` leaves it as it is.
        by: path of the names that order a received array; `none` takes it by position.
        text: format of a number in a published string, of a fixed width such as 8.2f.
        checksum: instead of a state, the sum that is written here.
    """

    state: Text | None = None
    const: Any = None
    scale: Scale | list[Scale] = 1.0
    sign: Sign | list[Sign] = 1.0
    offset: Offset | list[Offset] = 0.0
    unit: Literal[tuple(PER_SI)] | None = None  # type: ignore[valid-type]
    quat: Literal["xyzw_from_wxyz", "wxyz_from_xyzw", "none"] | None = None
    by: Text | None = None
    text: Annotated[str | None, Checked(_wrong_text)] = None
    checksum: Literal["unitree"] | None = None

    def __post_init__(self) -> None:
        """Refuse keys that contradict each other.

        Raises:
            MapFileError: they do.
        """
        said = [self.state is not None, self.const is not None]
        if self.checksum and any(said):
            raise MapFileError(f"a checksum is computed; drop {('state', 'const')[said[1]]!r}")
        if not self.checksum and sum(said) != 1:
            raise MapFileError("give either 'state' or 'const'")
        sizes = [len(each) for each in (self.sign, self.scale) if isinstance(each, list)]
        if len(set(sizes)) > 1:
            raise MapFileError(
                f"sign has {sizes[0]} entries, scale has {sizes[1]}; give equally many"
            )

    @property
    def factor(self) -> Numbers:
        """Scale and sign in one."""
        product: float | list[float] = np.multiply(self.scale, self.sign).tolist()
        return tuple(product) if isinstance(product, list) else product


Fields = Mapping[Annotated[str, Matches(r".+", "a path such as linear.x")], Constant | Conversion]


@dataclass(frozen=True)
class Entry:
    """What both directions say of a topic.

    Attributes:
        topic: relative names take the node's namespace.
        type: of its messages, such as sensor_msgs/msg/JointState.
        fields: path in the message to what stands on our side; an empty value removes an included
            one.
        rate: at most that often; every tick unless given.
        qos: a profile, or its figures.
        optional: leave the topic out where a state or the ROS type is missing.
        remove: takes an included entry out.
    """

    topic: RosName
    type: Text | None = None
    fields: Annotated[Fields | None, Write("{FIELD: STATE}")] = None
    rate: Annotated[float | None, Unit("Hz"), Within(0.0, HIGHEST_RATE, above=True)] = None
    qos: (
        Literal["default", "sensor_data", "latest", "latched"]
        | Annotated[Qos, Write("a mapping such as {reliability: reliable, depth: 10}")]
        | None
    ) = None
    optional: bool = False
    remove: Literal[True] | None = None


@dataclass(frozen=True)
class PublishEntry(Entry):
    """A topic that we publish."""

    @staticmethod
    def between(found: AnyDict, here: Here) -> None:
        """Note a reader that could stop the tick: Fast DDS blocks a full writer for 100 ms."""
        qos = found.get("qos")
        if isinstance(qos, Qos) and (qos.history, qos.reliability) == ("keep_all", "reliable"):
            here.value(
                "is reliable and keep_all, so a reader that hangs would stop the tick; say "
                "history: keep_last and a depth, or reliability: best_effort",
                "qos",
            )


@dataclass(frozen=True)
class SubscribeEntry(Entry, Reception):
    """A topic that we receive."""


_ENTRIES = Write("a list of entries: - {topic: …, type: …, fields: …}")


@dataclass(frozen=True)
class MapDocument:
    """A message map: what topics are made of, and what becomes of received ones.

    Attributes:
        schema: version of the format.
        description: one line.
        include: names or paths of maps to begin with.
        typestore: ROS distribution of the common interfaces; jazzy unless given.
        messages: .msg files or folders of them, or package://my_msgs/msg.
        publish: topics out.
        subscribe: topics in.
        trajectory: where joint trajectories come in.
    """

    schema: Literal["unicon.map/1"] = "unicon.map/1"
    description: Text | None = None
    include: Text | list[Text] | None = None
    typestore: Text | None = None
    messages: list[Text] | None = None
    publish: Annotated[list[PublishEntry] | None, _ENTRIES] = None
    subscribe: Annotated[list[SubscribeEntry] | None, _ENTRIES] = None
    trajectory: TrajectorySpec | None = None


def missing_keys(found: Located, mistakes: Mistakes) -> None:
    """Note entries of a map that lack a key or stand twice."""
    for direction in DIRECTIONS:
        first: dict[Any, int] = {}
        entries = found.value.get(direction)
        for i, entry in enumerate(entries if isinstance(entries, list) else ()):
            topic = entry.get("topic") if isinstance(entry, Mapping) else None
            if not isinstance(topic, str):
                continue  # noted already
            lacking = [key for key in ("type", "fields") if entry.get(key) is None]
            if lacking:
                text = f"missing key {lacking[0]!r}; an entry needs topic, type and fields"
                mistakes.note((direction, i), text)
            elif topic in first:
                place = found.where((direction, first[topic]))
                text = f"the topic is there twice (first {place}); merge the two or rename one"
                mistakes.note((direction, i), text)
            first.setdefault(topic, i)
