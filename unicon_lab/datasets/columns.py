"""Columns of a data set: which states become which feature, and features as LeRobot has them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_base.arrays import Index
from unicon_base.errors import StateError
from unicon_core.states.standard import FORWARDED_STATES
from unicon_lab.datasets.episodes import Episode
from unicon_lab.datasets.pictures import Pictures
from unicon_lab.datasets.video import NAME, PIXELS, can_encode
from unicon_lab.recording import Record

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
"""What is commanded besides."""
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
            if state in INSTEAD and self.key == ACTION:
                sent = _flat(episode, INSTEAD[state])[:, places]
                part = np.where(np.isnan(part), sent, part)
            parts.append(part)
        return np.concatenate(parts, axis=1).astype(self.dtype)


def default_states(record: Record) -> list[str]:
    """Return the states that are observed unless told."""
    there = record.kept["sent"]
    poses = [name for name in there if name.endswith("_pose")]
    return [name for name in (*OBSERVED, *BASE) if name in there] + poses


def default_actions(episodes: Sequence[Episode]) -> list[str]:
    """Return the states of the action unless told: what was commanded, else what was sent."""
    there = episodes[0].record.kept["sent"]
    commanded = COMMANDED in there and any(
        not np.isnan(_flat(each, COMMANDED)).all() for each in episodes
    )
    first = COMMANDED if commanded else INSTEAD[COMMANDED]
    return [name for name in (first, *ALSO) if name in there]


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
        key, places = OBSERVED.get(name, f"observation.{name}"), _known(episodes, name, told)
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
    joints = record.layout.specs["joint_pos"].names if "joint_pos" in record.layout.specs else ()
    if joints and record.layout.specs[state].names == joints:
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

    def described(self) -> dict[str, Any]:
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


def info_of(features: Mapping[str, Feature], fps: int) -> dict[str, Any]:
    """Return the features as `meta/info.json` has them."""
    found: dict[str, Any] = {}
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
