"""The message of a kept tick: a ROS type made of a layout, whose bytes are those of the states.

Any reader of ROS 2 bags finds every state in it, and every element that has a name by this name:
`sent.joint_pos.fr_hip_joint`. `HEAD` of the ring comes first, then the states at each moment: all
of them as they lie in the buffer, or one after the other those that came from outside. Alignment in
CDR is that of the buffer; gaps are fields named `padding…`.

The memory of blocks stands beside the ticks: snapshots as JSON, without the loss of a bit.
"""

from __future__ import annotations

import base64
import hashlib
import json
import math
import re
import time
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from unicon_base import AnyDict, StateError
from unicon_core.memory import ATOMS, Component, EnumMember, FromLibrary, GeneratorState, Snapshot
from unicon_core.policies.policy import policy_of
from unicon_core.runtime.tick_ring import HEAD, PHASES
from unicon_core.states import Layout
from unicon_lab.recording.mcap_file import McapFile
from unicon_lab.recording.records import MESSAGE, MESSAGE_HEAD, ROW, Buffer, Channel

if TYPE_CHECKING:
    from unicon_core.workflow import Program

SCHEMA = "unicon.record/1"
TOPIC = "/unicon/ticks"

FRAMES = "/unicon/frames/"
"""Topics of frames begin so; behind it stands the name of their handle without `_handle`."""

PHASE = "\n".join(f"uint32 {phase.name}={n}" for n, phase in enumerate(PHASES)) + "\nuint32 phase"
"""The field of a phase below its constants, by which Foxglove names the values."""

Names = Mapping[str, Sequence[str]]
"""State to the names of its elements, where its own specification has none."""

RecordedSubset = Mapping[str, frozenset[str] | None]
"""Moment to the states that are kept there; None for all."""

_ROS_TYPES = [
    "bool",
    "int8",
    "int16",
    "int32",
    "int64",
    "uint8",
    "uint16",
    "uint32",
    "uint64",
    "float32",
    "float64",
]


@dataclass(frozen=True)
class Moment:
    """What a message keeps of one moment.

    Attributes:
        begin: where it stands in the message in [bytes], the head of CDR included.
        size: in [bytes], a multiple of 8.
        places: state to where it stands behind `begin`, in that order.
        whole: all states, as they lie in the buffer.
    """

    begin: int
    size: int
    places: Mapping[str, int]
    whole: bool

    def copies(self, layout: Layout) -> list[tuple[slice, slice]]:
        """Return from which bytes of the message to which of the buffer, neighbours as one."""
        if self.whole:
            return [(slice(self.begin, self.begin + self.size), slice(0, layout.nbytes))]
        runs: list[list[int]] = []
        for name, place in self.places.items():
            slot, at = layout.slots[name], self.begin + place
            if runs and runs[-1][1] == at and runs[-1][3] == slot.offset:
                runs[-1][1], runs[-1][3] = at + slot.nbytes, slot.offset + slot.nbytes
            else:
                runs.append([at, at + slot.nbytes, slot.offset, slot.offset + slot.nbytes])
        return [(slice(a, b), slice(c, d)) for a, b, c, d in runs]


def kept_moments(layout: Layout, kept: RecordedSubset) -> dict[str, Moment]:
    """Return where the moments stand in a message, in their order."""
    slots = sorted(layout.slots.items(), key=lambda item: item[1].offset)
    found: dict[str, Moment] = {}
    begin = HEAD.size
    for moment, names in kept.items():
        places, end = {}, 0
        for name, slot in slots:
            if names is None:
                places[name], end = slot.offset, layout.nbytes
            elif name in names:
                step = min(np.dtype(slot.dtype).itemsize, 8)
                places[name] = -(-end // step) * step
                end = places[name] + slot.nbytes
        size = -(-end // 8) * 8
        found[moment] = Moment(begin, size, places, names is None)
        begin += size
    return found


def term_names(program: Program) -> Names:
    """Return the elements of each policy's observation, as `last_action_fr_hip_joint`.

    An element of an earlier frame ends in its age: `…_2_ago`.
    """
    found: dict[str, list[str]] = {}
    for policy in filter(None, map(policy_of, program.blocks)):
        observed = policy.lane.observation
        state = next((name for name in policy.writes if name.endswith("observation")), "")
        if observed is None or state not in program.states:
            continue
        found[state] = []
        for part, i, age in map(observed.element_of, range(observed.size)):
            element = f"{part.term.name}_{part.names[i] if part.names else i}"
            found[state].append(f"{element}_{age}_ago" if age else element)
    return found


def tick_channel(number: int, layout: Layout, kept: RecordedSubset, names: Names) -> Channel:
    """Return the channel of kept ticks.

    Args:
        number: of the channel in its file.
        layout: of the states.
        kept: what is kept of a tick, moment by moment.
        names: of elements, as of `term_names`.
    """
    named: dict[str, str] = {}
    texts = {
        name: (
            "States" if moment.whole else name.capitalize(),
            _fields(layout, moment, names, named),
        )
        for name, moment in kept_moments(layout, kept).items()
    }
    # Readers know a type by its name: two layouts must not share one.
    mark = _mark(f"{texts}")
    lines = [
        f"# A tick of unicon, bit-exact; the states' layout is {layout.hash}.",
        *("int64 stamp_ns", "int64 tick", PHASE, "uint32 ended"),
        *(f"unicon/{word}{mark} {name}" for name, (word, _) in texts.items()),
    ]
    types = {f"{word}{mark}": text for word, text in texts.values()} | named
    return Channel(
        number, TOPIC, f"unicon/msg/Tick{mark}", message_text(lines, types), "ros2msg", ""
    )


def message_text(lines: Iterable[str], types: Mapping[str, str]) -> str:
    """Return the definition of a message.

    Args:
        lines: its own fields.
        types: name of each further type, without `unicon/`, to its fields.
    """
    parts = ("\n".join(["=" * 80, f"MSG: unicon/{name}", text]) for name, text in types.items())
    return "\n".join([*lines, *parts])


def _mark(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:8]


def _fields(layout: Layout, moment: Moment, names: Names, named: dict[str, str]) -> str:
    """Return the fields of a message whose bytes are those of the states.

    Args:
        layout: of the states.
        moment: where they stand.
        names: of elements.
        named: takes the types that have an element a field.
    """
    lines: list[str] = []
    taken: set[str] = set()
    end = 0
    for name, place in (*moment.places.items(), ("", moment.size)):
        if place > end:
            lines.append(f"uint8[{place - end}] padding{end}")
        if name:
            slot, spec = layout.slots[name], layout.specs[name]
            kind, count = slot.dtype, slot.nbytes // np.dtype(slot.dtype).itemsize
            both = names.get(name, ()), spec.names  # the former may be of another policy
            elements = next((e for e in both if slot.shape[-1:] == (len(e),)), ())
            if kind not in _ROS_TYPES:
                kind, count, elements = "uint8", slot.nbytes, ()
            if elements:
                text = "\n".join(f"{kind} {field}" for field in field_names(elements))
                kind, count = f"Named{_mark(text)}", count // len(elements)
                named[kind], kind = text, f"unicon/{kind}"
            length = f"[{count}]" if count > 1 or (slot.shape and not elements) else ""
            said = ", ".join(filter(None, (spec.unit, spec.frame)))
            comment = f"  # {said}" if said else ""
            lines.append(f"{kind}{length} {_field(name, taken)}{comment}")
            end = place + slot.nbytes
    return "\n".join(lines)


def field_names(names: Iterable[str]) -> list[str]:
    """Return different names that ROS allows for fields, made of any texts."""
    taken: set[str] = set()
    return [_field(name, taken) for name in names]


def _field(name: str, taken: set[str]) -> str:
    clean = re.sub("[^a-z0-9]+", "_", name.lower()).strip("_")
    field, number = clean, 1
    while field in taken or field.startswith("padding") or not field[:1].isalpha():
        number += 1
        field = f"state_{clean}_{number}".replace("__", "_")
    taken.add(field)
    return field


def layout_facts(layout: Layout, kept: RecordedSubset) -> dict[str, str]:
    """Return what a reader needs to know of the ticks.

    Args:
        layout: of the states.
        kept: moment to the states that are kept there; None for all.
    """
    some = {moment: sorted(names) for moment, names in kept.items() if names is not None}
    return {
        "schema": SCHEMA,
        "written": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        "layout": layout.to_json(),
        "layout_hash": layout.hash,
        "moments": json.dumps(list(kept)),
        "kept": json.dumps(some),
        "phases": json.dumps([phase.value for phase in PHASES]),
    }


CHUNK_BYTES = 1 << 18


def add_ticks(file: McapFile, ticks: Iterable[Buffer]) -> None:
    """Write ticks to the first channel of a file.

    Args:
        file: open.
        ticks: each as CDR, with its `HEAD`.

    Raises:
        OSError: it cannot be written.
    """
    records = bytearray()
    rows: list[tuple[int, int, int]] = []
    for raw in ticks:
        stamp = max(int(HEAD.unpack_from(raw)[1]), 0)  # times in MCAP are unsigned
        rows.append((1, stamp, len(records)))
        size = MESSAGE_HEAD.size - 9 + len(raw)
        records += MESSAGE_HEAD.pack(MESSAGE, size, 1, 0, stamp, stamp) + raw
        if len(records) > CHUNK_BYTES:
            file.write(records, np.array(rows, ROW))
            records, rows = bytearray(), []
    if rows:
        file.write(records, np.array(rows, ROW))


_WRONG = (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError)
_SAME: Any = object()

_NAMED: AnyDict = {
    "snapshot": Snapshot,
    "component": Component,
    "library": FromLibrary,
    "generator": GeneratorState,
    "member": EnumMember,
    "list": list,
    "tuple": tuple,
    "deque": deque,
    "dict": dict,
}
_NAMES = {kind: name for name, kind in _NAMED.items()}


def to_json(value: Any) -> Any:
    """Return a snapshot, or a value of one, as JSON can write it, without the loss of a bit."""
    kind = type(value)
    if kind is float:
        return value if math.isfinite(value) else {"float": repr(value)}
    if kind in ATOMS:
        return value
    if isinstance(value, np.ndarray | np.generic):
        array = np.asarray(value)
        data = base64.b64encode(array.tobytes()).decode()
        content = {"dtype": array.dtype.str, "shape": list(array.shape), "data": data}
        return {"array" if kind is np.ndarray else "scalar": content}
    name = _NAMES[kind]
    if isinstance(value, dict):
        return {name: [[to_json(key), to_json(each)] for key, each in value.items()]}
    elements = [to_json(each) for each in value]
    return {name: [elements, value.maxlen] if kind is deque else elements}


def from_json(value: Any) -> Any:
    """Read what `to_json` returned. Nothing of it is imported or run.

    Raises:
        StateError: it is something else.
    """
    try:
        return _read(value)
    except _WRONG as error:
        raise StateError(f"not a memory of blocks: {error}; write it with to_json") from error


def _read(value: Any) -> Any:
    if not isinstance(value, dict):
        if type(value) not in ATOMS:
            raise ValueError(f"{value!r} stands in it")
        return value
    ((name, content),) = value.items()
    if name == "float":
        return float(content)
    if name in ("array", "scalar"):
        dtype = np.dtype(content["dtype"])
        flat = np.frombuffer(base64.b64decode(content["data"], validate=True), dtype)
        array = flat.reshape(content["shape"]).copy()
        return array if name == "array" else array[()]
    if name == "deque":
        return deque(map(_read, content[0]), content[1])
    kind = _NAMED[name]
    if issubclass(kind, dict):
        return kind((_read(key), _read(each)) for key, each in content)
    return kind(map(_read, content))


def changes(snapshot: Snapshot, built: Snapshot) -> Snapshot:
    """Return what of a snapshot is not as it was when the blocks had just been built.

    A replay with another option restores nothing that the option alone decides.
    """
    found = _changes(snapshot, built)
    return Snapshot() if found is _SAME else found


def _changes(snapshot: Any, built: Any) -> Any:
    if isinstance(snapshot, Component | Snapshot) and type(built) is type(snapshot):
        found = {name: _changes(each, built.get(name)) for name, each in snapshot.items()}
        kept = {name: each for name, each in found.items() if each is not _SAME}
        return type(snapshot)(kept) if kept or not snapshot else _SAME
    return _SAME if to_json(snapshot) == to_json(built) else snapshot
