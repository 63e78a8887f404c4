"""The message of a kept tick: a ROS type made of a layout, whose bytes are the states' buffer.

Any reader of ROS 2 bags finds every state by name in it. `HEAD` of the ring comes first, then the
states at each moment; alignment in CDR is that of the buffer, gaps are fields named `padding…`.
"""

from __future__ import annotations

import hashlib
import re

import numpy as np

from unicon_core.states import Layout
from unicon_ros.recording.records import Channel

__all__ = ["TOPIC", "tick_channel"]

TOPIC = "/unicon/ticks"

_ROS_TYPES = {
    "bool": "bool", "int8": "int8", "int16": "int16", "int32": "int32", "int64": "int64",
    "uint8": "uint8", "uint16": "uint16", "uint32": "uint32", "uint64": "uint64",
    "float32": "float32", "float64": "float64",
}  # fmt: skip


def tick_channel(number: int, layout: Layout, moments: tuple[str, ...]) -> Channel:
    """Return the channel of kept ticks.

    Args:
        number: of the channel in its file.
        layout: of the states.
        moments: names of what is kept of a tick.
    """
    states = _states_text(layout)
    # Readers know a type by its name: two layouts must not share one.
    mark = hashlib.sha256(f"{moments}{states}".encode()).hexdigest()[:8]
    lines = [
        f"# A tick of unicon, to the bit; the states' layout is {layout.hash}.",
        "int64 stamp_ns",
        "int64 tick",
        "uint32 phase",
        "uint32 ended",
        *(f"unicon/States{mark} {moment}" for moment in moments),
        "=" * 80,
        f"MSG: unicon/States{mark}",
        states,
    ]
    text = "\n".join(lines)
    return Channel(number, TOPIC, f"unicon/msg/Tick{mark}", text, "ros2msg", "")


def _states_text(layout: Layout) -> str:
    """Return the fields of a message whose bytes are those of the packed states."""
    lines: list[str] = []
    taken: set[str] = set()
    end = 0

    def pad(until: int) -> None:
        if until > end:
            lines.append(f"uint8[{until - end}] padding{end}")

    for name, slot in sorted(layout.slots.items(), key=lambda item: item[1].offset):
        pad(slot.offset)
        kind, count = _ROS_TYPES.get(slot.dtype), slot.nbytes // np.dtype(slot.dtype).itemsize
        if kind is None:  # ROS has no such number
            kind, count = "uint8", slot.nbytes
        length = f"[{count}]" if slot.shape else ""
        spec = layout.specs[name]
        said = ", ".join(text for text in (spec.unit, spec.frame) if text)
        comment = f"  # {said}" if said else ""
        lines.append(f"{kind}{length} {_field(name, taken)}{comment}")
        end = slot.offset + slot.nbytes
    pad(layout.nbytes)
    return "\n".join(lines)


def _field(name: str, taken: set[str]) -> str:
    """Return a name that ROS allows, made of a state's."""
    clean = re.sub("_+", "_", name.lower()).strip("_")
    field, number = clean, 1
    while field in taken or field.startswith("padding"):
        number += 1
        field = f"state_{clean}_{number}"
    taken.add(field)
    return field
