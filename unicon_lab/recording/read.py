"""Reading of recordings and fault records: `open_record(PATH).states("joint_pos")`."""

from __future__ import annotations

import base64
import json
import os
import re
import struct
from bisect import bisect_right
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from unicon_base import AnyDict, StateError, UniconError, alternatives
from unicon_base.arrays import Array
from unicon_core.runtime.tick_ring import DONE, HEAD
from unicon_core.states import Layout, States
from unicon_lab.recording.scan import Frames, Scan, frames_in, gather, scan
from unicon_lab.recording.ticks import FRAMES, SCHEMA, Moment, kept_moments

_T = TypeVar("_T")

SHORTEST, LONGEST = 1e-6, 86_400.0
"""Of a period in [s]."""

_WRONG = (
    *(ArithmeticError, AttributeError, LookupError, RecursionError, StateError, TypeError),
    *(ValueError, struct.error),
)

_HEADS = np.dtype("V4,<i8,<i8,<u4,<u4")
_HEADS.names = ("cdr", "stamp", "tick", "phase", "ended")


class Record:
    """A record of ticks, bit-exact. Its files are mapped and read on demand.

    Args:
        paths: of its files, in their order.
        scans: of each.

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
        done: True for a tick with which its phase was done, shape (ticks,): the flow, or the source
            of the states. Older records do not have it.
        memories: memory of the blocks: `before` (index of a tick), `anew` (the flow was reset
            before it), and the argument of `Memory.restore`.
        files: name to content of what goes along: `report.json`, `trace.json`.
        paths: as given.

    Raises:
        UniconError: the files are of several runs, or one of them is there twice.
        LookupError, StateError, TypeError, ValueError, …: they are not such a record.
    """

    def __init__(self, paths: Sequence[Path], scans: Sequence[Scan]) -> None:
        self.paths, self._scans = tuple(paths), scans
        # The last file has what was reported at the end.
        self.facts = facts = {**scans[-1].facts, **scans[0].facts}
        for path, each in zip(paths, scans):
            if not each.facts.get("schema"):
                raise ValueError("it has no facts of unicon")
            if each.facts["schema"] != SCHEMA:
                raise ValueError(f"its schema is {each.facts['schema']!r}, known is {SCHEMA}")
            for fact in ("layout_hash", "moments", "kept", "run"):
                if each.facts.get(fact) != facts.get(fact):
                    raise UniconError(
                        f"{path} is of another run than {paths[0].name} ({fact}): a folder is read "
                        "as one recording; give one of its files, or move the others away"
                    )
        self.layout = layout = Layout.from_json(facts["layout"])
        self.moments: tuple[str, ...] = tuple(json.loads(facts["moments"]))
        some = {m: frozenset(n) for m, n in json.loads(facts.get("kept", "{}")).items()}
        self._places = kept_moments(layout, {moment: some.get(moment) for moment in self.moments})
        self.kept = {moment: tuple(each.places) for moment, each in self._places.items()}
        width = HEAD.size + sum(moment.size for moment in self._places.values())
        if any((each.heads(each.ticks)[1] != width).any() for each in scans):
            raise ValueError("its ticks are of another layout")
        raw = np.concatenate([gather(each.data, each.ticks, HEAD.size) for each in scans])
        heads, names = raw.view(_HEADS).reshape(-1), json.loads(facts["phases"])
        self.stamps, self.ticks = (heads[key].astype(np.int64) for key in ("stamp", "tick"))
        self.phases: tuple[str, ...] = tuple(names[number] for number in heads["phase"].tolist())
        self.ended = heads["ended"].astype(np.bool_)
        self.done = (heads["ended"] & DONE).astype(np.bool_)
        firsts = [int(each.facts.get("first_row", "0")) for each in scans]
        self._begins: list[int] = []
        count = 0
        for path, each, row in zip(paths, scans, firsts):
            if len(each.ticks) and row < firsts[0] + count:
                raise UniconError(
                    f"{path} has ticks that another file of its folder has, too; move the copy away"
                )
            self._begins.append(count)
            count += len(each.ticks)
        self.files = {name: content for each in scans for name, content in each.files.items()}
        memories = [
            {**each, "before": each["before"] - firsts[0]}
            for name, content in self.files.items()
            if re.fullmatch(r"memory(-\d+)?\.json", name)
            for each in json.loads(content)["memories"]
        ]
        there = [each for each in memories if 0 <= each["before"] < max(count, 1)]
        self.memories: list[AnyDict] = sorted(there, key=lambda each: int(each["before"]))
        self._whole = {
            each["before"]: np.frombuffer(base64.b64decode(each.pop("received")), np.uint8)
            for each in self.memories
            if "received" in each
        }
        if any(len(each) != layout.nbytes for each in self._whole.values()):
            raise ValueError("its memory is of another layout")
        self._feeds: dict[tuple[int, str, bool], tuple[States, Any]] = {}

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints; none without `joint_pos`."""
        positions = self.layout.specs.get("joint_pos")
        return tuple(positions.names) if positions else ()

    @property
    def period(self) -> float:
        """Time of a tick in [s].

        Raises:
            UniconError: the record does not have it.
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
        """Whether it was neither cut off nor is being written."""
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
            names: of states that are needed there.

        Raises:
            StateError: no such moment, or one of the states is not kept at it.
        """
        if moment not in self.kept:
            known = alternatives(moment, self.moments)
            raise StateError(f"{self.paths[0]} has no moment {moment!r}; {known}")
        there = self.kept[moment]
        for name in names:
            if name not in there:
                why = f"; {alternatives(name, there)}"
                if name in self.layout.slots:
                    why = ", where it did not come from outside; ask for it at 'sent'"
                raise StateError(f"{self.paths[0]} has no state {name!r} at {moment!r}{why}")

    @property
    def policies(self) -> dict[str, AnyDict]:
        """Name of a policy to `path`, `model`, and the `sha256` of its network."""
        return {
            name: said
            for name, said in self.told("policies", dict).items()
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
        parts = []
        for each, first in zip(self._scans, self._begins):
            there = each.ticks[max(begin - first, 0) : max(end - first, 0)]
            parts.append(gather(each.data, there + at, slot.nbytes))
        return np.concatenate(parts).view(slot.dtype).reshape(-1, *slot.shape)

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
        data = self._whole.get(row) if moment == "received" else None
        key, at = (id(states), moment, data is None), 0
        if key not in self._feeds:
            self.need(moment)
            place = self._places[moment] if data is None else None
            self._feeds[key] = states, self._copies(place, states)
        if data is None:
            number = bisect_right(self._begins, row) - 1
            found = self._scans[number]
            data, at = found.data, int(found.ticks[row - self._begins[number]])
        live = states.buffer
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
            (slice(slot.offset, slot.offset + slot.nbytes), begin, begin + slot.nbytes)
            for name, slot in states.layout.slots.items()
            if (begin := begins.get(name)) is not None
            and (mine[name].shape, mine[name].dtype) == (slot.shape, slot.dtype)
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
    """Return the message for a recording that is not there."""
    partial = path.with_name(f"{path.name}.partial")
    there = os.path.exists(partial)
    hint = f"a run writes it, or was cut off: give {partial}" if there else "correct the name"
    return f"cannot read {path}: there is no such file or folder; {hint}"


def open_record(path: str | Path, looked: Sequence[Scan] | None = None) -> Record:
    """Open a recording or fault record; of one that a kill cut off, what is whole.

    Args:
        path: of a file, or of a folder with the files of one recording.
        looked: what `scan` found in each of `files_of(path)`, where it was looked through already:
            a look is a pass over the whole file.

    Raises:
        UniconError: it cannot be read, or is not such a record.
    """
    path = Path(path)
    try:
        paths = files_of(path)
        return Record(paths, looked or [scan(each) for each in paths])
    except FileNotFoundError as error:
        raise UniconError(missing(path)) from error
    except OSError as error:
        raise UniconError(f"cannot read {path}: {error.strerror}") from error
    except _WRONG as error:
        reason = f"{error.args[0]!r} is missing" if isinstance(error, KeyError) else error
        raise UniconError(
            f"{path} is not a record of ticks: {reason}; give one that unicon wrote, or make one "
            "with unicon bag import"
        ) from error
