"""RecordedTicks: every state of every tick on its way from the ring into a recording.

Of the moments before `sent` only those states are recorded that came from outside there; the rest
follows from the tick before. Where nothing is before (the first tick, a reset) they are all in
`memory.json`, beside what the blocks remembered.
"""

from __future__ import annotations

import base64
import json
import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING

from unicon_core.memory import Snapshot
from unicon_core.runtime.tick_ring import HEAD, KeptMemory, TickRing
from unicon_ros.recording.facts import content_of, layout_facts
from unicon_ros.recording.records import attachment, metadata
from unicon_ros.recording.tick_message import kept_moments

if TYPE_CHECKING:
    from unicon_core.runtime.statistics import TickStatistics
    from unicon_ros.recorder import Recorder


class RecordedTicks:
    """Takes the ticks of a ring; makes the facts and memories that go with them.

    Args:
        recorder: not started yet.
        ring: whose blocks stand in the program.
    """

    def __init__(self, recorder: Recorder, ring: TickRing) -> None:
        self._recorder, self._ring = recorder, ring
        self._layout = layout = ring.layout
        self._write = recorder.tick_channel(layout, ring.outside)
        moments = kept_moments(layout, ring.outside).values()
        self._whole = slice(HEAD.size, HEAD.size + layout.nbytes)
        self._row = bytearray(HEAD.size + sum(moment.size for moment in moments))
        self._copies = [(slice(0, HEAD.size), slice(0, HEAD.size))]
        for number, moment in enumerate(moments):
            there = HEAD.size + number * layout.nbytes
            for to, source in moment.copies(layout):
                self._copies.append((to, slice(there + source.start, there + source.stop)))
        self._memory: KeptMemory | None = None
        self._rows = 0
        ring.tap = self._take

    def attach(self, facts: Mapping[str, str]) -> None:
        """Give the facts of the run to the recorder."""
        facts = {**facts, **layout_facts(self._layout, self._ring.outside)}
        self._recorder.add_record(partial(metadata, "unicon", facts))

    def close(self, statistics: TickStatistics) -> None:
        """Give what is known at the end of the run."""

        def made() -> bytes:
            late = json.dumps(statistics.lateness_us())
            return metadata("unicon", {"overruns": str(statistics.overruns), "late_us": late})

        self._recorder.add_record(made)

    def _take(self, raw: memoryview) -> None:
        row, memory = self._row, self._ring.newest
        for to, source in self._copies:
            row[to] = raw[source]
        _, stamp, _, _, _ = HEAD.unpack_from(raw)
        if not self._write(stamp, row):
            return  # dropped, and counted
        if memory is not self._memory or not self._rows:
            self._memory = memory
            if memory is None or memory.anew or not self._rows:  # others are for fault records
                self._remember(memory, bytes(raw[self._whole]))
        self._rows += 1

    def _remember(self, memory: KeptMemory | None, states: bytes) -> None:
        found = (
            memory
            if memory is not None
            else KeptMemory(self._rows, False, Snapshot(), {"every block": "is unknown"})
        )
        self._recorder.add_record(_attachment(found, self._rows, self._ring.trouble, states))


def _attachment(
    memory: KeptMemory, number: int, trouble: str, states: bytes
) -> Callable[[], bytes]:
    """Return what makes the attachment, in a thread: it takes milliseconds."""
    name = f"memory-{number}.json" if number else "memory.json"
    now = time.time_ns()

    def make() -> bytes:
        content = content_of(memory, number) | {"received": base64.b64encode(states).decode()}
        text = json.dumps({"trouble": trouble, "memories": [content]})
        return attachment(name, "application/json", now, text.encode())

    return make
