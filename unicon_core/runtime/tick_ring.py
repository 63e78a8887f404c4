"""TickRing: the last ticks, bit-exact, in memory, for fault records and recordings.

A tick is kept as the whole buffer of the states at each *moment* at which something came from
outside, and at its end: `received` (behind recv), `input` and `tuned` (behind blocks that a hook
put into these stages), `sent` (behind send and all that was put off). With what the blocks
remembered before a tick, everything between two moments follows from the first one.
"""

from __future__ import annotations

import struct
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from unicon_core.flow import Block, Node, Stage, blocks_of
from unicon_core.memory import Memory, Snapshot
from unicon_core.runtime.phases import Phase
from unicon_core.workflow.tick_tree import memory_of

if TYPE_CHECKING:
    from unicon_core.runtime.runner import Runner
    from unicon_core.workflow import Program

KEPT_S = 10.0
"""Of ticks that are kept at least in [s]; up to half as much more, since it begins at a memory."""
STRIDES = 2
"""Memories that are taken in that time."""
LARGEST = 64 << 20
"""Bytes of a ring; with larger states it goes back less far."""
FEWEST = 16
"""Ticks; where not even so many have room nothing is kept."""

BETWEEN = ("tick", "velocity_command")
"""States that the runner changes between two ticks."""

HEAD = struct.Struct("<4sqqII")
"""What a kept tick begins with: the head of CDR, time [ns], number, phase, and how it ended."""
ENDED, DONE = 1, 2
"""How: to its end; and there the whole graph was done, so that its blocks began anew. Else 0."""
_CDR = bytes((0, 1, 0, 0))

PHASES = tuple(Phase)
"""The phases in the order of their numbers."""


@dataclass(frozen=True)
class KeptMemory:
    """What the blocks remembered before a tick.

    Attributes:
        row: number of the tick, counted from the first one that was kept in the run.
        anew: it was not what the tick before had left: the flow was reset.
        remembered: the memory.
        unproven: block to why its memory is not among it.
    """

    row: int
    anew: bool
    remembered: Snapshot
    unproven: dict[str, str] = field(default_factory=dict)


class TickRing:
    """Keeps the last ticks of a program; its blocks are a hook's.

    Args:
        program: whose hooks before have given their blocks already.
        least: ticks that are kept however large the states are.

    Attributes:
        layout: of the states.
        moments: names of what is kept of a tick, in order.
        outside: moment to the states that blocks from outside may have changed just before it, as
            they declare; None where one of them declares nothing, and in `sent`.
        tap: gets every tick when it has ended, in some microseconds, before `rows` counts it; or
            None.
        capacity: ticks; 0 where the states are too large.
        row_bytes: of a tick: `HEAD`, then the states at each moment.
        rows: ticks that were kept since the beginning.
        built: what the blocks remembered before the first tick of the run, or None.
        trouble: why memories are missing, or "".
    """

    def __init__(self, program: Program, least: int = 0) -> None:
        states = program.states
        self._program, self._states = program, states.buffer.data.cast("B")
        self.layout = states.layout
        self._tick = states["tick"].reshape(-1)
        self._stamp = states["stamp_ns"].reshape(-1) if program.platform.facts.simulated else None
        given = [stage for stage in (Stage.INPUT, Stage.TUNE) if program.stages[stage]]
        names = {Stage.INPUT: "input", Stage.TUNE: "tuned"}
        self.moments = ("received", *(names[stage] for stage in given), "sent")
        self.outside: dict[str, frozenset[str] | None] = {
            "received": _changed(program.stages[Stage.RECV], program.platform.facts.writes),
            **{names[stage]: _changed(program.stages[stage]) for stage in given},
            "sent": None,
        }
        self.tap: Callable[[memoryview], object] | None = None
        self._given = given
        self._size = self.layout.nbytes
        self.row_bytes = HEAD.size + len(self.moments) * self._size
        stride = max(round(KEPT_S / STRIDES / program.period), 1)
        self._stride = min(stride, LARGEST // self.row_bytes // (STRIDES + 1))
        self.capacity = self._stride * (STRIDES + 1)
        if self.capacity < FEWEST:
            self.capacity, self._stride = least, 1 << 62
        self.rows = 0
        self.trouble = ""
        self.built: Snapshot | None = None
        # Written once, so that no page of it is new to a tick.
        self._data = memoryview(np.full(self.capacity * self.row_bytes, 0xFF, np.uint8).data)
        starts = range(HEAD.size, len(self._data), self.row_bytes)
        self._received_rows = [self._data[at : at + self._size] for at in starts]
        self._slot = self._at = 0  # of the present row
        self._reached = 0  # moments of the present row that are kept
        self._anew = self._frozen = False
        self._runner: Runner | None = None
        self._phase, self._phase_number = PHASES[0], 0
        self._memory: Memory | None = None
        self._memories: deque[KeptMemory] = deque()

    def blocks(self) -> dict[Stage, list[Block]]:
        """Return the blocks that keep the ticks; none where there is no room."""
        if not self.capacity:
            return {}
        received = Block("ring received", self._received, endless=True, reset=self._was_reset)
        received.warm_up = self._copy  # 2 µs less in a loop of 50 Hz
        stages = {Stage.RECV: [received]}
        for number, stage in enumerate(self._given, 1):
            take = self._taker(number)
            stages[stage] = [Block(f"ring {self.moments[number]}", take, endless=True)]
        return stages | {Stage.OBSERVE: [Block("ring", self._sent, endless=True)]}

    def attach(self, runner: Runner) -> None:
        """Get to know the runner, and what its blocks remember, before the first tick."""
        self._runner = runner
        if not self.capacity:
            return
        try:
            self._memory = memory_of(self._program, runner.graphs())
        except Exception as error:  # a block of somebody's, which cannot be looked into
            self.trouble = f"what the blocks remember was not kept: {error!r}"
        self._remember(False)
        self.built = self._memories[0].remembered if self._memories else None
        runner.at_fault.append(self.freeze)

    # -- in the tick ----------------------------------------------------------------------------

    def _received(self) -> None:
        if self._frozen:  # it is damped
            return
        if self._anew:
            self._anew = False
            self._remember(True)
        self._copy()  # all that the command waits for
        self._reached = 1

    def _copy(self) -> None:
        self._received_rows[self._slot][:] = self._states

    def _head(self, ended: int) -> None:
        runner, stamp = self._runner, self._stamp
        if runner is not None and runner.phase is not self._phase:
            self._phase = runner.phase
            self._phase_number = PHASES.index(self._phase)
        now = time.time_ns() if stamp is None else int(stamp[0])
        number = int(self._tick[0])
        HEAD.pack_into(self._data, self._at, _CDR, now, number, self._phase_number, ended)

    def _taker(self, number: int) -> Callable[[], None]:
        size, states, data = self._size, self._states, self._data
        offset = HEAD.size + number * size

        def take() -> None:
            if self._frozen:  # damping hears topics, too: the oldest tick stands in this place
                return
            at = self._at + offset
            data[at : at + size] = states
            self._reached = number + 1

        return take

    def _sent(self) -> None:
        if self._frozen:
            return
        self._fill()
        # Within a tick the graph is made fresh by what ends it alone.
        self._head(ENDED | DONE if self._anew else ENDED)
        self._next()
        if self.rows % self._stride == 0:
            self._remember(False)

    def _fill(self) -> None:
        """Keep the states as they are now at the moments that were not reached.

        That is `sent` alone in a tick of the run; there is no input in one that only damps.
        """
        size, data = self._size, self._data
        at = self._at + HEAD.size + self._reached * size
        for _ in range(self._reached, len(self.moments)):
            data[at : at + size] = self._states
            at += size

    def _next(self) -> None:
        if self.tap is not None:
            self.tap(self._data[self._at : self._at + self.row_bytes])
        self._reached = 0
        self.rows += 1
        self._slot = self.rows % self.capacity
        self._at = self._slot * self.row_bytes

    def _remember(self, anew: bool) -> None:
        if self._memory is None:
            return
        try:
            taken = self._memory.take()
            self._memories.append(KeptMemory(self.rows, anew, taken, {**self._memory.unproven}))
            while self._memories[0].row < self.rows - self.capacity:
                self._memories.popleft()
        except Exception as error:  # a run does not end because of its record
            self._memory = None
            self.trouble = f"what the blocks remembered in tick {self.rows} was not kept: {error!r}"

    def _was_reset(self) -> None:
        self._anew = True

    # -- at the end -----------------------------------------------------------------------------

    def freeze(self) -> None:
        """Keep the states as they are now in a tick that does not end; 1 µs.

        Between two ticks it is a tick of its own, the first time.
        """
        if not self.capacity or self._frozen:
            return
        self._frozen = True
        self._fill()
        self._head(0)
        self._next()

    @property
    def newest(self) -> KeptMemory | None:
        """What was remembered last."""
        return self._memories[-1] if self._memories else None

    def memories(self) -> list[KeptMemory]:
        """Return the memories of the ticks that are still there, the oldest first."""
        oldest = self.rows - self.capacity
        return [each for each in self._memories if each.row >= oldest]

    def kept(self) -> Iterator[memoryview]:
        """Yield the ticks from the oldest memory on, each as CDR."""
        memories = self.memories()
        oldest = max(self.rows - self.capacity, 0)
        for row in range(memories[0].row if memories else oldest, self.rows):
            at = row % self.capacity * self.row_bytes
            yield self._data[at : at + self.row_bytes]


def _changed(nodes: Sequence[Node], more: Sequence[str] = ()) -> frozenset[str] | None:
    """Return the states that blocks change, with those that the runner sets between two ticks."""
    blocks = [block for node in nodes for block in blocks_of(node)]
    if not all(block.writes or block.amends for block in blocks):
        return None  # nobody knows
    found = {state for block in blocks for state in (*block.writes, *block.amends)}
    return frozenset({*found, *more, *BETWEEN})
