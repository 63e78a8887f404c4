"""Columns of a data set: which states become which feature, and features as LeRobot has them."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from unicon_base import AnyDict, StateError, UniconError
from unicon_base.arrays import Index, Int64
from unicon_core.states.standard import FORWARDED_STATES, pose_of
from unicon_lab.datasets.pictures import NAME, PIXELS, Pictures, Shown, can_encode
from unicon_lab.recording import Record

LONGEST_STEP = 1.0
"""Between two ticks in [s]; where the clock says more, or goes back, somebody has set it."""


@dataclass(frozen=True, eq=False)
class Episode:
    """Frames of a data set, one behind the other, all of one recording.

    Attributes:
        path: of the recording.
        record: it.
        rows: index of the tick of each frame, shape (frames,).
        shown: camera to its picture at each frame.
        held: camera to the number of frames whose own picture is not there.
        task: what it shows; "" where nobody has said so.
    """

    path: Path
    record: Record
    rows: Int64
    shown: Mapping[str, Shown] = field(default_factory=dict)
    held: Mapping[str, int] = field(default_factory=dict)
    task: str = ""


@dataclass(frozen=True)
class Kept:
    """An episode that an operator has kept: first and last tick of a recording, and the task."""

    first: int
    last: int
    task: str


def rate_of(record: Record) -> float:
    """Return the ticks a second of a recording, a whole number where it is one to 1e-6."""
    rate = 1.0 / record.period
    return float(round(rate)) if abs(rate - round(rate)) < 1e-6 * rate else rate


def episodes_of(
    path: Path,
    record: Record,
    fps: int,
    phases: Collection[str],
    pictures: Mapping[str, Pictures],
    kept: Collection[Kept] = (),
) -> list[Episode]:
    """Return an episode for each stretch of ticks of the phases, none where there are no such.

    An episode begins where every camera has given a picture. A picture is the one whose handle the
    tick held; where that was not recorded, or the camera was gone, the one before it.

    Args:
        path: of the recording.
        record: it.
        fps: frames a second.
        phases: of the ticks that count.
        pictures: camera to its pictures.
        kept: episodes that alone count; all ticks if empty.

    Raises:
        UniconError: a camera has no picture in any tick of a stretch.
    """
    found = []
    for rows, task in _kept_rows(record, phases, kept):
        rows = sampled(record, rows, fps)
        shown, held = {}, {}
        for name, each in pictures.items():
            handles = record.states(f"{name}_handle").reshape(-1)[rows]
            there = each.frames.at(handles & 0xFFFFFFFF)
            exact = (there >= 0) & (each.frames.handles[there] == handles & 0xFFFFFFFF)
            shown[name], held[name] = np.maximum.accumulate(there), exact
            if (there < 0).all():
                raise UniconError(
                    f"{path}: no picture of {name!r} in ticks {record.ticks[rows[0]]} to "
                    f"{record.ticks[rows[-1]]} of {record.phases[rows[0]]}; leave the recording "
                    f"out, or name other cameras: --cameras"
                )
        begin = max((int(np.argmax(each >= 0)) for each in shown.values()), default=0)
        cut = {name: Shown(pictures[name], each[begin:]) for name, each in shown.items()}
        missing = {name: int((~exact[begin:]).sum()) for name, exact in held.items()}
        found.append(Episode(path, record, rows[begin:], cut, missing, task))
    return found


def _kept_rows(
    record: Record, phases: Collection[str], kept: Collection[Kept]
) -> list[tuple[Int64, str]]:
    """Return the rows of each episode, and its task."""
    stretches, ticks = _stretches(record, phases), record.ticks
    if not kept:
        return [(rows, "") for rows in stretches]
    found = [
        (rows[(ticks[rows] >= each.first) & (ticks[rows] <= each.last)], each.task)
        for each in kept
        for rows in stretches
    ]
    return [(rows, task) for rows, task in found if len(rows)]


def _stretches(record: Record, phases: Collection[str]) -> list[Int64]:
    """Return the rows of ticks that follow each other in these phases and came to their end."""
    wanted = np.array([phase in phases for phase in record.phases], bool) & record.ended
    names = np.array(record.phases)
    rows = np.flatnonzero(wanted)
    if not len(rows):
        return []
    ends = (
        (np.diff(rows) > 1)
        | (np.diff(record.ticks[rows]) <= 0)
        | (names[rows[1:]] != names[rows[:-1]])
    )
    return np.split(rows, np.flatnonzero(ends) + 1)


def sampled(record: Record, rows: Int64, fps: int) -> Int64:
    """Return the rows at even times, each the nearest tick.

    Args:
        record: whose clock counts.
        rows: that follow each other, at least one, shape (ticks,).
        fps: of them a second.
    """
    steps = np.diff(record.stamps[rows]) * 1e-9
    counted = np.diff(record.ticks[rows]) * record.period
    steps = np.where((steps > 0.0) & (steps <= np.maximum(LONGEST_STEP, counted)), steps, counted)
    times = np.concatenate([[0.0], np.cumsum(steps)])
    wanted = np.arange(int(times[-1] * fps + 0.5) + 1) / fps
    if len(times) == 1:
        return rows
    after = np.clip(np.searchsorted(times, wanted), 1, len(times) - 1)
    nearer = wanted - times[after - 1] < times[after] - wanted
    chosen: Int64 = rows[after - nearer]
    return chosen


ACTION = "action"
OBSERVED = {
    "joint_pos": "observation.state",
    "joint_vel": "observation.velocity",
    "joint_effort": "observation.effort",
}
"""States whose feature LeRobot's policies know by another name."""
BASE = ("base_quat", "base_ang_vel", "projected_gravity")
"""What is observed besides where a recording has it, as are the `_pose` of end effectors."""
COMMANDED = FORWARDED_STATES[0]
INSTEAD = {COMMANDED: "joint_pos_target"}
"""What stands for an element that is NaN: nothing was commanded, and this was sent."""
ALSO = ("velocity_command",)
"""What is commanded besides, as are the `_target` of end effectors, whose pose stands for NaN."""
OPERATOR = "local_floor"
"""Frame of a headset's poses, which are features `operator.NAME`: no policy may see them."""
COMMANDS = (*INSTEAD, *INSTEAD.values(), *ALSO)
"""All that an action may be made of unless told."""
_TYPES = ("float32", "float64", "int32", "int64", "bool")


@dataclass(frozen=True, eq=False)
class Column:
    """One feature.

    Attributes:
        key: of the feature.
        dtype: of its elements.
        states: names of states, with the places of those of their elements that it has.
        names: of its elements.
    """

    key: str
    dtype: str
    states: tuple[tuple[str, Index], ...]
    names: tuple[str, ...]

    def values(self, episode: Episode) -> NDArray[np.generic]:
        """Return what a tick had when its command was sent, shape (frames, elements)."""
        parts = []
        for state, places in self.states:
            part = _flat(episode, state)[:, places]
            instead = INSTEAD.get(state) or pose_of(state.removesuffix("_target"))
            if self.key == ACTION and instead in episode.record.kept["sent"]:
                sent = _flat(episode, instead)[:, places]
                part = np.where(np.isnan(part), sent, part)
            parts.append(part)
        return np.concatenate(parts, axis=1).astype(self.dtype)


def default_states(record: Record) -> list[str]:
    """Return the states that are observed unless told."""
    there = record.kept["sent"]
    poses = [name for name in there if name.endswith("_pose")]
    return [name for name in (*OBSERVED, *BASE) if name in there] + poses + _operator(record)


def _operator(record: Record) -> list[str]:
    """Return the states of a headset: poses, and which of them are tracked."""
    poses = [n for n in record.kept["sent"] if record.layout.specs[n].frame == OPERATOR]
    return poses + [n.replace("_head", "_valid") for n in poses if n.endswith("_head")]


def _targets(record: Record) -> list[str]:
    """Return the targets of end effectors, of whose pose a record knows."""
    there = record.kept["sent"]
    return [n for n in there if n.endswith("_target") and pose_of(n[: -len("_target")]) in there]


def default_actions(episodes: Sequence[Episode]) -> list[str]:
    """Return the states of the action unless told: what was commanded, else what was sent."""
    there = episodes[0].record.kept["sent"]
    commanded = COMMANDED in there and any(
        not np.isnan(_flat(each, COMMANDED)).all() for each in episodes
    )
    first = COMMANDED if commanded else INSTEAD[COMMANDED]
    return [name for name in (first, *ALSO) if name in there] + _targets(episodes[0].record)


def made_columns(
    episodes: Sequence[Episode], states: Sequence[str], actions: Sequence[str]
) -> tuple[list[Column], list[str]]:
    """Return the features of some episodes, and a line for each element that is left out.

    An element that is NaN in every frame of every episode is left out: nobody measures or commands
    it.

    Args:
        episodes: all of one layout; at least one.
        states: that are observed, each a feature of its own.
        actions: that make up the action.

    Raises:
        StateError: no such state, or one whose numbers LeRobot does not have.
    """
    record = episodes[0].record
    record.need("sent", (*states, *actions))
    for name in (*states, *actions):
        if record.layout.specs[name].dtype not in _TYPES:
            raise StateError(
                f"state {name!r} is {record.layout.specs[name].dtype}, which a data set does not "
                f"have; name other states: {', '.join(_TYPES)}"
            )
    told: list[str] = []
    columns = []
    for name in states:
        whose = "operator" if name in _operator(record) else "observation"
        key = OBSERVED.get(name, f"{whose}.{name}")
        places = _known(episodes, name, told)
        if len(places):
            names = _names(record, name, places)
            columns.append(Column(key, record.layout.specs[name].dtype, ((name, places),), names))
    parts = [(name, _known(episodes, name, told)) for name in actions]
    parts = [(name, places) for name, places in parts if len(places)]
    names = tuple(each for name, places in parts for each in _names(record, name, places))
    if parts:
        columns.append(Column(ACTION, "float32", tuple(parts), names))
    return columns, told


def _flat(episode: Episode, state: str) -> NDArray[np.generic]:
    first, last = int(episode.rows[0]), int(episode.rows[-1])
    values = episode.record.states(state, "sent", slice(first, last + 1))
    return values.reshape(len(values), -1)[episode.rows - first]


def _known(episodes: Sequence[Episode], state: str, told: list[str]) -> Index:
    """Return the elements of a state that are ever a number."""
    elements = episodes[0].record.layout.elements(state)
    known = np.zeros(len(elements), bool)
    for episode in episodes:
        known |= ~np.isnan(_flat(episode, state).astype(np.float64)).all(axis=0)
    if not known.all():
        missing = [name for name, there in zip(elements, known) if not there]
        more = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
        told.append(f"{missing[0]}{more}: never a number, left out")
    return np.flatnonzero(known)


def _names(record: Record, state: str, places: Index) -> tuple[str, ...]:
    """Return the names of elements; those of joints without the state in front."""
    elements = record.layout.elements(state)
    if record.joints and record.layout.specs[state].names == record.joints:
        elements = [name.removeprefix(f"{state}.") for name in elements]
    return tuple(elements[place] for place in places)


TICK = "unicon.tick"
"""Feature with the number of the recording's tick, so that a frame is found again there."""


@dataclass(frozen=True)
class Feature:
    """One of them.

    Attributes:
        dtype: `float32`, …, `image` or `video`.
        shape: of one frame.
        names: of the elements or axes, None without.
        camera: that it shows, "" for numbers.
    """

    dtype: str
    shape: tuple[int, ...]
    names: tuple[str, ...] | None = None
    camera: str = ""

    def described(self) -> AnyDict:
        """Return what the Hugging Face library wants to know of its column, {} without one."""
        if self.dtype == "video":
            return {}
        if self.dtype == "image":
            return {"_type": "Image"}
        value = {"dtype": self.dtype, "_type": "Value"}
        if self.shape == (1,):
            return value
        return {"feature": value, "length": self.shape[0], "_type": "Sequence"}


DEFAULTS = {
    "timestamp": Feature("float32", (1,)),
    **dict.fromkeys(
        ("frame_index", "episode_index", "index", "task_index"), Feature("int64", (1,))
    ),
}
"""Those that every data set has, behind the others."""


def image_key(camera: str) -> str:
    """Return the feature of a camera."""
    return f"observation.images.{camera}"


def features_of(
    columns: list[Column], cameras: Mapping[str, Pictures], video: bool
) -> dict[str, Feature]:
    """Return the features of a data set, but for those that every one has.

    Args:
        columns: of its numbers.
        cameras: name to pictures.
        video: pictures are to be videos, where their size and what is installed allows it.
    """
    found = {each.key: Feature(each.dtype, (len(each.names),), each.names) for each in columns}
    found[TICK] = Feature("int64", (1,))
    for name, each in cameras.items():
        kind = "video" if video and can_encode(each.height, each.width) else "image"
        axes = ("height", "width", "channels")
        found[image_key(name)] = Feature(kind, (each.height, each.width, 3), axes, name)
    return found


def info_of(features: Mapping[str, Feature], fps: int) -> AnyDict:
    """Return the features as `meta/info.json` has them."""
    found: AnyDict = {}
    for key, each in features.items():
        names = None if each.names is None else list(each.names)
        found[key] = {"dtype": each.dtype, "shape": list(each.shape), "names": names}
        if each.dtype == "video":
            found[key]["info"] = {
                "video.height": each.shape[0],
                "video.width": each.shape[1],
                "video.codec": NAME,
                "video.pix_fmt": PIXELS,
                "video.is_depth_map": False,
                "video.fps": fps,
                "video.channels": 3,
                "has_audio": False,
            }
    return found
