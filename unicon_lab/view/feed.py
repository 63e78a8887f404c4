"""Feed: copies each tick into a ring in shared memory, for a viewer's process; one copy a tick."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from unicon_core.handles import FrameRing
from unicon_core.runtime.phases import Phase
from unicon_core.states import States
from unicon_lab.view import PORT
from unicon_lab.view.shown import HEAD, shown_of
from unicon_ros.attachments import Attachment
from unicon_ros.peripheral import Peripheral

if TYPE_CHECKING:
    from unicon_core.runtime import Runner
    from unicon_lab.view.driver import Driver
    from unicon_ros.bridge.services import Controls

PROCESS = "unicon_lab.view.process"

KEPT_S = 1.0
"""Of ticks in the ring, in [s]: a viewer that looks rarely still plots every one of them."""

RARELY = 0.01
"""How often it is looked who drives, at the phase and the overruns, in [s]."""

# Places of the numbers of `HEAD`.
_TICK, _STAMP, _PHASE, _PAUSED, _LATE, _TOOK, _OVERRUNS, _DRIVES, _ROBOTS, _COUNTERS = range(10)

FEWEST, LARGEST = 16, 32 << 20
"""Ticks in the ring at least, and its bytes at most beyond those."""


def _filling(
    runner: Runner, cells: Sequence[Any], ring: FrameRing, driver: Driver, controls: Controls
) -> Callable[[], None]:
    """Return what copies a tick; all that it looks at is bound once.

    Args:
        runner: whose ticks are copied.
        cells: of its graph's variables that are the counters.
        ring: of ticks: `HEAD`, counters, states.
        driver: tells whether a viewer drives.
        controls: tell whether the simulator stands still.
    """
    states = runner.program.states.buffer.data.cast("B")
    program, statistics = runner.program, runner.statistics
    head, table, memory, start = ring.parts()
    slots, size, begin, number = ring.slots, ring.nbytes, ring.nbytes - len(states), 0
    front = memoryview(bytearray(begin))  # filled here and copied: it stays warm, slots do not
    words = front.cast("q")
    words[_ROBOTS], words[_COUNTERS] = program.states.num_robots or 1, len(cells)
    numbered = tuple(enumerate(cells, HEAD.size // words.itemsize))
    tick = memoryview(program.states["tick"].reshape(-1).data)
    rows = memoryview(statistics.rows.reshape(-1).data)
    capacity, width = statistics.rows.shape
    phases, phase, now = {p: n for n, p in enumerate(Phase)}, None, time.perf_counter_ns
    often, left = max(1, round(RARELY / program.period)), 0

    def look() -> None:
        """Look at what changes rarely: each is a cold line of memory more."""
        nonlocal left, phase
        left = often
        words[_PAUSED], words[_DRIVES] = controls.paused, driver.driving
        words[_OVERRUNS] = statistics.overruns
        if phase is not runner.phase:  # an enum's hash is slow
            phase = runner.phase
            words[_PHASE] = phases[phase]

    def fill() -> None:
        nonlocal number, left
        left -= 1
        if left <= 0:
            look()
        ticks = statistics.count
        if ticks:  # of the tick before: this one has not ended
            row = (ticks - 1) % capacity * width
            began = rows[row + 2]
            words[_LATE], words[_TOOK] = began - rows[row], rows[row + 1] - began
        number += 1
        place = number % slots
        at, place = start + place * size, 2 * place
        words[_TICK], words[_STAMP] = tick[0], now()
        for word, cell in numbered:
            words[word] = cell.cell_contents
        table[place] = 0
        memory[at : at + begin] = front
        memory[at + begin : at + size] = states
        table[place + 1] = words[_STAMP]
        table[place] = head[0] = number

    return fill


class Fed(Attachment):
    """A run whose ticks a process of its own is given; whoever made it closes it.

    Args:
        warn: takes lines for the operator.

    Attributes:
        address: where that process shows them, once it is started.
    """

    def __init__(self, warn: Callable[[str], None]) -> None:
        self.warn, self.address = warn, ""
        self._ring: FrameRing | None = None
        self._peripheral: Peripheral | None = None
        self._runner: Runner | None = None
        self._fill: Callable[[], object] = bool
        self._due_ns = 0

    def _start(
        self,
        runner: Runner,
        name: str,
        told: States,
        options: dict[str, Any],
        driver: Driver,
        controls: Controls,
        *,
        stale: float,
        period: float,
        map: str = "default",
        frame_prefix: str = "",
    ) -> Peripheral:
        """Start the process that reads a run's ring, and return it.

        Args:
            runner: of the run, before its first tick.
            name: of the peripheral that the process is.
            told: what it tells.
            options: of its sink; `port` becomes the one that it has got, where browsers look for a
                process that is started again.
            driver, controls: as of `_filling`.
            stale: so long it may be silent, in [s].
            period: between two looks at it, in [s].
            map: name of the message map.
            frame_prefix: of ROS frames.

        Raises:
            UniconError: it cannot begin.
        """
        shown, variables = shown_of(runner.program, runner.graph, map, frame_prefix)
        cells = runner.graph.cells(variables)
        size = HEAD.size + 8 * len(cells) + runner.program.states.buffer.nbytes
        ticks = max(FEWEST, min(round(KEPT_S / runner.program.period), LARGEST // size))
        ring = FrameRing.create(size, ticks)
        ring.touch()
        data = {"shown": shown, "ring": str(ring.path)}
        given = {"name": name, "options": options, "data": data}
        try:
            process = Peripheral(told, told.layout, PROCESS, given, {}, stale, period, self.warn)
        except BaseException:
            ring.close()
            raise
        self._ring, self._peripheral, self.address = ring, process, str(process.first["address"])
        self._runner, self._fill = runner, _filling(runner, cells, ring, driver, controls)
        options["port"] = urlsplit(self.address).port or options.get("port", PORT)
        return process

    def close(self) -> None:
        """End the process; safe to call twice."""
        if self._peripheral is not None:
            self._peripheral.close()
        if self._ring is not None:
            self._ring.close()
