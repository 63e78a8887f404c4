"""How `policy.yaml` writes the values of a contract: hints with units and bounds, and what is made.

Numbers become float32 arrays, or what float32 makes of them, as the networks take them. The key
`motion`, for policies that follow a recorded motion, is a `MotionSpec`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

import numpy as np

from unicon_base import AnyDict, AnyMapping, PolicyError
from unicon_base.arrays import Float32
from unicon_base.schema.marks import (
    Checked,
    Made,
    Matches,
    Names,
    NotEmpty,
    Text,
    Within,
    Write,
    positive,
    twice,
)
from unicon_base.schema.types import Here
from unicon_core.bounds import POSITION, SCALE

LONGEST_FILTER = 100
"""Samples of a moving average; a policy at 50 Hz sees two seconds then."""
LARGEST_SLEW = 1000.0
"""Of a command in [1/s] of its unit: what is more jumps within a tick."""
MOST_FRAMES = 10_000
"""Of a history."""
LONGEST_PERIOD = 1000.0
"""Of a policy and of a gait in [s]."""


def floats(value: Any) -> Float32:
    """Return a number or a list of numbers as a read-only array, shape (k,)."""
    array = np.array(value if isinstance(value, list) else [value], np.float32)
    array.flags.writeable = False
    return array


def rounded(value: Any) -> tuple[float, ...]:
    """Return a number or a list of numbers as float32 has them."""
    return tuple(map(float, floats(value)))


def rounded_one(value: float) -> float:
    """Return a number as float32 has it."""
    return float(np.float32(value))


def listed(value: Any) -> tuple[Any, ...]:
    """Return one value or a list of them as a tuple."""
    return tuple(value) if isinstance(value, list) else (value,)


def _clip(sides: Any) -> Float32:
    """`[lowest, highest]`, each one number or a list; shape (2, 1) or (2, k)."""
    arrays = list(map(floats, sides))
    width = max(side.size for side in arrays)
    if {side.size for side in arrays} - {1, width}:
        raise PolicyError(f"has {arrays[0].size} and {arrays[1].size} values; write as many")
    clip = np.stack([np.broadcast_to(side, (width,)) for side in arrays])
    for low, high in clip.T[clip[0] > clip[1]]:
        raise PolicyError(f"is [{low:g}, {high:g}]; the lowest must come first")
    return clip


def _range(pair: Any) -> tuple[float, float]:
    (low,), (high,) = _clip(pair).tolist()
    return low, high


def _said(ranges: AnyMapping) -> AnyDict:
    return {name: pair for name, pair in ranges.items() if pair is not None}


def _slew(rates: Any) -> tuple[float, ...]:
    return tuple(map(float, np.broadcast_to(np.float32(rates), 3)))


def each(number: Any) -> Made:
    """Return the mark of an array, for which one number or a list of them is written."""
    many = list[number]
    return Made(floats, number | Annotated[many, NotEmpty, Write("a list of them")])


Limit = Annotated[float, Within(endless=True)]
ClipBound = Limit | list[Limit]
Pair = Annotated[tuple[Limit, Limit], Write("[lowest, highest]")]
Clip = Annotated[
    Float32, Made(_clip, Annotated[tuple[ClipBound, ClipBound], Write("[lowest, highest]")])
]
Range = Annotated[tuple[float, float], Made(_range, Pair)]
Ranges = Annotated[Mapping[str, tuple[float, float]], Made(_said, Mapping[str, Range | None])]
Rate = Annotated[
    float,
    Within(0.0, LARGEST_SLEW, above=True, endless=True),
    Write(f"a change above 0 and at most {LARGEST_SLEW:g} in [m/s², rad/s²], .inf for any"),
]
Slew = Annotated[
    tuple[float, float, float],
    Made(_slew, Rate | Annotated[tuple[Rate, Rate, Rate], Write("a list of those of vx, vy, wz")]),
    Write("the largest change of vx, vy, wz in [m/s², m/s², rad/s²], or one for all"),
]
Angle = Annotated[
    float,
    Within(-POSITION, POSITION, "rad"),
    Write(f"a number from {-POSITION:g} to {POSITION:g} [rad] (are these degrees?)"),
]
Alpha = Annotated[
    float, positive(1.0), Write("the weight of the newest sample, above 0 and at most 1")
]
Place = Annotated[int, Within(0)]
Places = Annotated[tuple[int, ...], Made(listed, Place | list[Place])]
Offsets = Annotated[tuple[float, ...], Made(rounded, float | list[float])]
Period = Annotated[float, Within(1e-6, LONGEST_PERIOD, "s")]
Stand = Annotated[float, Made(rounded_one, float), Write("a phase in [rad]")]
Threshold = Annotated[
    float,
    Made(
        rounded_one,
        Annotated[
            float, positive(), Write("a speed above 0 in [m/s] and [rad/s]: no command is below it")
        ],
    ),
]
Tensor = Annotated[str, Made(str, str | int), Write("the name of a tensor")]
Sha256 = Annotated[
    str, Made(str.lower, Annotated[str, Matches("[0-9a-fA-F]{64}", "the 64 digits of 'sha256sum'")])
]


@dataclass(frozen=True)
class Feed:
    """What fills a part of a network's input: `source[start:stop]`.

    Attributes:
        source: `observation`, or `NAME.output` of an earlier network.
        start, stop: elements; `stop` is None for all.
    """

    source: str
    start: int = 0
    stop: int | None = None

    @classmethod
    def of(cls, text: str) -> Feed:
        """Return what a text such as `observation[0:45]` means.

        Raises:
            PolicyError: it means nothing.
        """
        match = re.fullmatch(r"([^\[\]]+)(?:\[(\d{1,6}):(\d{1,6})\])?", text)
        if match is None:
            raise PolicyError(f"has {text!r}; write observation, observation[0:45] or NAME.output")
        source, start, stop = match.groups()
        if start is None:
            return cls(source)
        if int(start) >= int(stop):
            raise PolicyError(f"has {text!r}, which is empty; the first comes first")
        return cls(source, int(start), int(stop))

    def __str__(self) -> str:
        return self.source if self.stop is None else f"{self.source}[{self.start}:{self.stop}]"


def _feeds(texts: Any) -> tuple[Feed, ...]:
    return tuple(map(Feed.of, listed(texts)))


_FeedText = Annotated[str, Write("observation, observation[0:45] or NAME.output")]
Feeds: TypeAlias = Mapping[
    str, Annotated[tuple[Feed, ...], Made(_feeds, _FeedText | Annotated[list[_FeedText], NotEmpty])]
]


@dataclass(frozen=True)
class ClockRate:
    """How fast a gait clock runs: `(offset + scale · state[index]) / period`, in gaits a second.

    Attributes:
        state: such as a command with the frequency in [Hz] (`period: 1.0`), or an output.
        index: element of it.
        scale, offset: of it.
    """

    state: Text
    index: Place = 0
    scale: Annotated[float, Within(-SCALE, SCALE)] = 1.0
    offset: Annotated[float, Within(-SCALE, SCALE)] = 0.0

    def __str__(self) -> str:
        return f"({self.offset:g} + {self.scale:g} · {self.state}[{self.index}])"


@dataclass(frozen=True)
class ClockShift:
    """How far each phase is ahead of the gait clock: a sum of elements of a state, in gaits.

    Attributes:
        state: such as a command with the offsets of gaits, as shares of one.
        index: the elements that are added up: a list for each phase.
    """

    state: Text
    index: Annotated[tuple[tuple[Place, ...], ...], Write("a list of elements for each phase")]

    def __str__(self) -> str:
        sums = ("+".join(map(str, places)) or "0" for places in self.index)
        return f"{self.state}[{', '.join(sums)}]"


AXES = {
    "x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0),
    "-x": (-1.0, 0.0, 0.0), "-y": (0.0, -1.0, 0.0), "-z": (0.0, 0.0, -1.0),
}  # fmt: skip
"""Word of `motion.chain` to the unit vector that it means."""


MotionTime = Annotated[float, Within(0.0, 86_400.0, "s")]
"""Within a motion, which is a day at most."""


@dataclass(frozen=True)
class MotionSpec:
    """The motion that a policy is to follow, and the body by which the robot is compared with it.

    Attributes:
        anchor_body: such as `torso_link`; a body of the robot's model.
        file: `.npz` or `.csv`, or None: outputs of the network are the reference.
        bodies: of the outputs `motion_body_pos_w` and `motion_body_quat_w`, in their order.
        align: `yaw` turns the motion about the vertical and shifts it, so that it begins where the
            robot stands; `none` leaves it in the robot's world.
        start: of what is played of it in [s].
        end: of what is played in [s], or None for all.
        hold: for so long in [s] the first frame is shown before the motion goes on; those who train
            with it hold it (amazon-far/holosoma: `freeze_at_timestep_zero_prob`).
        fps: frames in a second of a file, or None: as the file says, 30 of a `.csv`.
        joints: the file's joints in order, `policy`, `robot`, or None: as its format has it.
        duration: of a motion of which the policy sees no more than `motion_phase`, in [s], in place
            of `anchor_body`; or None.
        chain: joint to axis (`x`, `-y`, …) from the base to the anchor, for a robot without a
            model; empty: as the model has it.
    """

    anchor_body: Annotated[Text, Write("a body, as torso_link")] = ""
    file: Annotated[Path | None, Write("a .npz or .csv file")] = None
    bodies: Annotated[tuple[Text, ...], Checked(twice)] = ()
    align: Literal["yaw", "none"] = "yaw"
    start: MotionTime = 0.0
    end: MotionTime | None = None
    hold: MotionTime = 0.0
    fps: Annotated[float | None, Within(1.0, 10_000.0, "Hz")] = None
    joints: Literal["policy", "robot"] | Names | None = None
    chain: Mapping[str, Literal["x", "y", "z", "-x", "-y", "-z"]] = field(default_factory=dict)
    duration: MotionTime | None = None

    @staticmethod
    def between(found: AnyDict, here: Here) -> None:
        """Note an end before the start, and other than one of anchor_body and duration."""
        start = found.get("start", 0.0)
        for key in ("end", "duration"):
            end = found.get(key)
            if end is not None and end <= start:
                here.value(f"is {end:g} s and start {start:g} s; end after the start", key)
        said = {key for key, value in here.written.items() if value is not None}
        if "duration" not in said and "anchor_body" not in said:
            here.value(
                "needs anchor_body, or duration in [s] where the policy sees motion_phase alone"
            )
        elif "duration" in said and (more := said - {"duration", "start", "hold"}):
            here.value(f"stands beside {min(more)}; only start and hold go with it", "duration")
