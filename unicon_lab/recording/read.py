"""Reading of recordings and fault records: `open_record(PATH).states("joint_pos")`."""

from __future__ import annotations

import base64
import json
import os
import re
import struct
from bisect import bisect_right
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from unicon_base.arrays import Array, Bool, Int64, UInt8
from unicon_base.errors import StateError, UniconError, alternatives
from unicon_core.runtime.tick_ring import DONE, HEAD
from unicon_core.states import Layout, States
from unicon_lab.recording.ticks import SCHEMA
from unicon_lab.recording.scan import Frames, Scan, frames_in, gather, scan
from unicon_lab.recording.ticks import FRAMES, Moment, RecordedSubset, kept_moments

_T = TypeVar("_T")

SHORTEST, LONGEST = 1e-6, 86_400.0
"""Of a period in [s]."""

_WRONG = (
    ArithmeticError,
    AttributeError,
    LookupError,
    RecursionError,
    StateError,
    TypeError,
    ValueError,
    struct.error,
)

_HEADS = np.dtype(
    [("cdr", "V4"), ("stamp", "<i8"), ("tick", "<i8"), ("phase", "<u4"), ("ended", "<u4")]
)
_MEMORY = re.compile(r"memory(-\d+)?\.json")


@dataclass(frozen=True)
class Record:
    """A record of ticks, to the bit. Its files are mapped: what is asked for is read.

    Attributes:
        facts: reason, workflow, robot, versions, … as texts.
        layout: of the states.
        moments: what is kept of a tick: `received`, …, `sent`.
        kept: moment to the states that are kept there; at `sent` they are all. Of a recording the
            others have those that came from outside there.
        stamps: time of each tick in [ns], shape (ticks,).
        ticks: number of each, shape (ticks,).
        phases: phase of each, as text.
        ended: False for the tick in which the fault was, shape (ticks,).
        done: True for a tick with which its phase was done, shape (ticks,): the flow, or who gives
            the states. Older records do not say it.
        memories: what the blocks remembered: `before` (index of a tick), `anew` (the flow was
            reset before it), and what `Memory.restore` takes.
        files: name to content of what goes along: `report.json`, `trace.json`.
        paths: the files that it was read from.
    """

    facts: Mapping[str, str]
    layout: Layout
    moments: tuple[str, ...]
    kept: Mapping[str, tuple[str, ...]]
    stamps: Int64
    ticks: Int64
    phases: tuple[str, ...]
    ended: Bool
    done: Bool
    memories: list[dict[str, Any]]
    files: Mapping[str, bytes]
    paths: tuple[Path, ...]
    _places: Mapping[str, Moment]
    _scans: Sequence[Scan]
    _begins: Sequence[int]
    _whole: Mapping[int, UInt8]
    _feeds: dict[tuple[int, str, bool], tuple[States, Any]] = field(default_factory=dict)

    @property
    def period(self) -> float:
        """Time of a tick in [s].

        Raises:
            UniconError: the record does not say it.
        """
        said = self.facts.get("period_s", "nothing")
        try:
            period = float(said)
        except ValueError:
            period = 0.0
        if not SHORTEST <= period <= LONGEST:
            raise UniconError(
                f"{self.paths[0]} does not say its period: period_s is {said!r:.40}; record it "
                "with unicon run --record"
            )
        return period

    @property
    def whole(self) -> bool:
        """Whether nobody cut it off, and nobody is writing it."""
        return all(each.ended for each in self._scans)

    def told(self, name: str, kind: type[_T]) -> _T:
        """Return a fact that is written as JSON; an empty one where there is none of that kind."""
        try:
            said = json.loads(self.facts.get(name, ""))
        except (RecursionError, ValueError):
            return kind()
        return said if isinstance(said, kind) else kind()

    def need(self, moment: str, names: Iterable[str] = ()) -> None:
        """Refuse what is not kept in the record.

        Args:
            moment: such as `sent`.
            names: of states that are asked for there.

        Raises:
            StateError: no such moment, or one of the states is not kept at it.
        """
        if moment not in self.kept:
            known = alternatives(moment, self.moments)
            raise StateError(f"{self.paths[0]} has no moment {moment!r}; {known}")
        there = self.kept[moment]
        for name in names:
            if name in there:
                continue
            why = f"; {alternatives(name, there)}"
            if name in self.layout.slots:
                why = ", where it did not come from outside; ask for it at 'sent'"
            raise StateError(f"{self.paths[0]} has no state {name!r} at {moment!r}{why}")

    @property
    def policies(self) -> dict[str, dict[str, Any]]:
        """Name of a policy to `path`, `model`, and the `sha256` of its network."""
        policies: dict[str, Any] = self.told("policies", dict)
        return {
            name: said
            for name, said in policies.items()
            if isinstance(said, dict) and isinstance(said.get("sha256"), str)
        }

    def states(self, name: str, moment: str = "sent", rows: slice = slice(None)) -> Array:
        """Return a state in every tick, shape (ticks, …), or in some of them.

        Raises:
            StateError: no such state, or it is not kept at that moment.
        """
        self.need(moment, [name])
        slot, place = self.layout.slots[name], self._places[moment]
        at = place.begin + place.places[name]
        begin, end, _ = rows.indices(len(self.ticks))
        parts = [
            gather(
                each.data, each.ticks[max(begin - first, 0) : max(end - first, 0)] + at, slot.nbytes
            )
            for each, first in zip(self._scans, self._begins)
        ]
        packed = np.concatenate(parts)
        return packed.view(slot.dtype).reshape(-1, *slot.shape)

    @property
    def frame_names(self) -> tuple[str, ...]:
        """Names of the handles whose frames were recorded, without `_handle`."""
        topics = {topic: None for each in self._scans for topic in each.frames}
        return tuple(topic.removeprefix(FRAMES) for topic in topics)

    def frames(self, name: str) -> Frames:
        """Return the pictures or clouds of one ring, by their handles.

        Args:
            name: of `frame_names`.

        Raises:
            StateError: no such frames.
        """
        found = frames_in(name, self._scans)
        if found is None:
            raise StateError(
                f"no frames {name!r} in {self.paths[0]}; {alternatives(name, self.frame_names)}"
            )
        return found

    def feed(self, moment: str, row: int, states: States) -> None:
        """Put what came from outside at a moment of a tick into live states.

        Where blocks were reset before the tick, and in the first one, that is all of `received`.
        States of another layout get those that they have too, by name.

        Args:
            moment: of `moments`.
            row: index of the tick.
            states: of a program.

        Raises:
            StateError: no such moment.
        """
        whole = self._whole.get(row) if moment == "received" else None
        key = id(states), moment, whole is None
        if key not in self._feeds:
            self.need(moment)
            place = self._places[moment] if whole is None else None
            self._feeds[key] = states, self._copies(place, states)
        data, at, live = whole, 0, states.buffer
        if data is None:
            number = bisect_right(self._begins, row) - 1
            found = self._scans[number]
            data, at = found.data, int(found.ticks[row - self._begins[number]])
        for to, begin, end in self._feeds[key][1]:
            live[to] = data[at + begin : at + end]

    def _copies(self, place: Moment | None, states: States) -> list[tuple[slice, int, int]]:
        """Return to where in live states which bytes go: of a tick's moment, or of all states.

        Of states that are of one shape and type in both.
        """
        mine = self.layout.slots
        if place is None:
            begins = {name: slot.offset for name, slot in mine.items()}
        elif states.layout.hash == self.layout.hash:
            return [(to, source.start, source.stop) for source, to in place.copies(self.layout)]
        else:
            begins = {name: place.begin + at for name, at in place.places.items()}
        return [
            (
                slice(slot.offset, slot.offset + slot.nbytes),
                begins[name],
                begins[name] + slot.nbytes,
            )
            for name, slot in states.layout.slots.items()
            if name in begins and (mine[name].shape, mine[name].dtype) == (slot.shape, slot.dtype)
        ]


def files_of(path: Path) -> list[Path]:
    """Return the files of a recording: itself, or those of its folder in their order.

    Raises:
        UniconError: there is none.
    """
    if not path.is_dir():
        return [path]
    found = [each for each in path.iterdir() if re.search(r"\.mcap(\.partial)?$", each.name)]
    if not found:
        raise UniconError(f"{path} has no recording in it; give a file or folder with .mcap files")

    def number(each: Path) -> tuple[int, str]:
        told = re.search(r"_(\d+)(\.recovered-\d+)?\.mcap(\.partial)?$", each.name)
        return (int(told[1]) if told else -1, each.name)

    return sorted(found, key=number)


def missing(path: Path) -> str:
    """Return what is told of a recording that is not there."""
    partial = path.with_name(f"{path.name}.partial")
    there = os.path.exists(partial)
    hint = f"a run writes it, or was cut off: give {partial}" if there else "correct the name"
    return f"cannot read {path}: there is no such file or folder; {hint}"


def open_record(path: str | Path, looked: Sequence[Scan] | None = None) -> Record:
    """Open a recording or fault record; of one that a kill cut off, what is whole.

    Args:
        path: of a file, or of a folder with the files of one recording.
        looked: what `scan` found in each of `files_of(path)`, where somebody has looked already:
            a look is a pass over the whole file.

    Raises:
        UniconError: it cannot be read, or is not such a record.
    """
    try:
        paths = files_of(Path(path))
        return _record(paths, [scan(each) for each in paths] if looked is None else looked)
    except FileNotFoundError as error:
        raise UniconError(missing(Path(path))) from error
    except OSError as error:
        raise UniconError(f"cannot read {path}: {error.strerror}") from error
    except _WRONG as error:
        reason = f"{error.args[0]!r} is missing" if isinstance(error, KeyError) else error
        raise UniconError(
            f"{path} is not a record of ticks: {reason}; give one that unicon wrote, or make one "
            "with unicon bag import"
        ) from error


def _record(paths: Sequence[Path], scans: Sequence[Scan]) -> Record:
    facts = {**scans[-1].facts, **scans[0].facts}  # the last one has what was told at the end
    for path, each in zip(paths, scans):
        if not each.facts.get("schema"):
            raise ValueError("it has no facts of unicon")
        if each.facts["schema"] != SCHEMA:
            raise ValueError(f"its schema is {each.facts['schema']!r}, known is {SCHEMA}")
        for fact in ("layout_hash", "moments", "kept", "run"):
            if each.facts.get(fact) != facts.get(fact):
                raise UniconError(
                    f"{path} is of another run than {paths[0].name} ({fact}): a folder is read as "
                    "one recording; give one of its files, or move the others away"
                )
    layout = Layout.from_json(facts["layout"])
    moments = tuple(json.loads(facts["moments"]))
    some: RecordedSubset = {m: frozenset(n) for m, n in json.loads(facts.get("kept", "{}")).items()}
    places = kept_moments(layout, {moment: some.get(moment) for moment in moments})
    width = HEAD.size + sum(moment.size for moment in places.values())
    if any((each.sizes != width).any() for each in scans):
        raise ValueError("its ticks are of another layout")
    heads = np.concatenate([gather(each.data, each.ticks, HEAD.size) for each in scans])
    heads = heads.view(_HEADS).reshape(-1)
    names = json.loads(facts["phases"])
    begins = [0]
    first = int(scans[0].facts.get("first_row", "0"))
    for path, each in zip(paths, scans):
        if len(each.ticks) and int(each.facts.get("first_row", "0")) < first + begins[-1]:
            raise UniconError(
                f"{path} has ticks that another file of its folder has, too; move the copy away"
            )
        begins.append(begins[-1] + len(each.ticks))
    files = {name: content for each in scans for name, content in each.files.items()}
    memories = _memories(files, first, begins[-1])
    whole = {
        each["before"]: np.frombuffer(base64.b64decode(each.pop("received")), np.uint8)
        for each in memories
        if "received" in each
    }
    if any(len(each) != layout.nbytes for each in whole.values()):
        raise ValueError("its memory is of another layout")
    return Record(
        facts,
        layout,
        moments,
        {moment: tuple(place.places) for moment, place in places.items()},
        heads["stamp"].astype(np.int64),
        heads["tick"].astype(np.int64),
        tuple(names[number] for number in heads["phase"].tolist()),
        heads["ended"].astype(np.bool_),
        (heads["ended"] & DONE).astype(np.bool_),
        memories,
        files,
        tuple(paths),
        places,
        scans,
        begins[:-1],
        whole,
    )


def _memories(files: Mapping[str, bytes], first: int, ticks: int) -> list[dict[str, Any]]:
    """Return what was remembered before ticks that are there, in their order."""
    found = [
        {**each, "before": each["before"] - first}
        for name, content in files.items()
        if _MEMORY.fullmatch(name)
        for each in json.loads(content)["memories"]
    ]
    there = [each for each in found if 0 <= each["before"] < max(ticks, 1)]
    return sorted(there, key=lambda each: int(each["before"]))
