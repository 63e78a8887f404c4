"""Processes beside a run that read its ticks, such as a viewer, `--view`.

Each tick is copied into a ring in shared memory; one copy a tick.
"""

from __future__ import annotations

import json
import math
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from unicon_base import AnyDict, AnyMapping, PlatformError, TextSink, UniconError
from unicon_core.flow import Block, Stage
from unicon_core.handles import FrameRing
from unicon_core.runtime.phases import Phase
from unicon_core.states import States
from unicon_core.states.standard import external_states
from unicon_core.workflow import HookBlocks, Program, WorkflowDocument
from unicon_core.workflow.hardware import declared_facts
from unicon_core.workflow.registry import find_factory
from unicon_lab.view import PORT
from unicon_lab.view.driver import Driver
from unicon_lab.view.shown import DEAD_MAN, HEAD, NAME, PAGE, shown_of
from unicon_ros.attachments import Attachment
from unicon_ros.bridge.services import Controls
from unicon_ros.parameters import Tuning
from unicon_ros.peripheral import Peripheral, peripheral_states, short

if TYPE_CHECKING:
    from unicon_core.runtime import Report, Runner
    from unicon_ros.bridge import RosSession

PROCESS = "unicon_lab.view.process"

KEPT_S = 1.0
"""Of ticks in the ring, in [s]: a viewer that looks rarely still plots every one of them."""

RARELY = 0.01
"""Interval of looking who drives, at the phase and the overruns, in [s]."""

# Places of the numbers of `HEAD`.
_TICK, _STAMP, _PHASE, _PAUSED, _LATE, _TOOK, _OVERRUNS, _DRIVES, _ROBOTS, _COUNTERS = range(10)

FEWEST, LARGEST = 16, 32 << 20
"""Ticks in the ring at least, and its bytes at most beyond those."""

TEXTS_S = 0.2
"""Interval of sending a viewer texts that have changed, in [s]."""

LAST_WORDS = 0.2
"""For so long a viewer may show the last ones before it is closed, in [s]."""

STAYS = 2.0
"""A page that has gone for so long is closed, not loaded again, in [s]."""

LINES = 20
"""Last lines of the run's log that a viewer gets."""

LONGEST = 3500
"""Bytes of the texts: they go through a pipe whole or not at all."""


def _filling(
    runner: Runner,
    cells: Sequence[Any],
    ring: FrameRing,
    driver: Driver | Fed,
    controls: Controls | Fed,
) -> Callable[[], None]:
    """Return what copies a tick; all that it looks at is bound once.

    Args:
        runner: whose ticks are copied.
        cells: of its graph's variables that are the counters.
        ring: of ticks: `HEAD`, counters, states.
        driver: knows whether a viewer drives.
        controls: know whether the simulator stands still. A process that only looks has neither.
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
    """Gives a run's ticks to a process of its own; who made it closes it.

    Args:
        warn: takes lines for the operator.
        session: of ROS, or None.

    Attributes:
        address: where that process shows them, once it is started.
    """

    interval = 0.0
    """Of sending texts, in [s]."""
    kept = KEPT_S
    """Of ticks in the ring, in [s]."""
    _recorded, driving, paused = "", 0, 0

    def __init__(self, warn: TextSink, session: RosSession | None) -> None:
        self.warn, self.address, self._session = warn, "", session
        self._ring: FrameRing | None = None
        self._peripheral: Peripheral | None = None
        self._fill: Callable[[], object] = bool
        self._due_ns = 0

    def hook(self, program: Program) -> HookBlocks:
        """Return the block that copies each tick."""
        return {Stage.OBSERVE: [Block(self.label, self._tick, endless=True)]}

    def _start(
        self,
        runner: Runner,
        options: AnyDict,
        told: States | None = None,
        stale: float = 0.0,
        driver: Driver | None = None,
        controls: Controls | None = None,
        *names: str,
    ) -> Peripheral:
        """Start the process that reads a run's ring, and return it.

        Args:
            runner: of the run, before its first tick.
            options: of its sink; `port` becomes the one that it has got, where browsers look for a
                process that is started again.
            told: states that it publishes; None for those of a process that only looks.
            stale: so long it may be silent, in [s]; 0 for `interval`.
            driver, controls: as of `_filling`; None where it only looks.
            names: map and frame prefix, as of `shown_of`.

        Raises:
            UniconError: it cannot begin.
        """
        shown, variables = shown_of(runner.program, runner.graph, *names)
        cells = runner.graph.cells(variables)
        size = HEAD.size + 8 * len(cells) + runner.program.states.buffer.nbytes
        ticks = max(FEWEST, min(round(self.kept / runner.program.period), LARGEST // size))
        ring = self._ring = FrameRing.create(size, ticks)
        ring.touch()
        data = {"shown": replace(shown, records=bool(self._recorded)), "ring": str(ring.path)}
        given = {"name": self.label, "options": options, "data": data}
        told = told or States(peripheral_states(self.label, {}))
        often = stale or self.interval, driver.interval if driver else self.interval
        try:
            process = Peripheral(told, told.layout, PROCESS, given, {}, *often, self.warn)
        except BaseException:
            ring.close()
            raise
        self._peripheral, self.address = process, str(process.first["address"])
        self._runner, self._fill = (
            runner,
            _filling(runner, cells, ring, driver or self, controls or self),
        )
        options["port"] = urlsplit(self.address).port or options.get("port", PORT)
        return process

    def _tick(self) -> None:
        self._fill()
        now = time.perf_counter_ns()
        if now >= self._due_ns and self._peripheral is not None:
            self._due_ns = now + round(self.interval * 1e9)
            self._tell(self._peripheral)

    def _tell(self, peripheral: Peripheral) -> bool:
        """Send the texts; return whether any were new. It starts a process that died again."""
        return peripheral()

    def close(self) -> None:
        """End the process; safe to call twice."""
        for each in (self._peripheral, self._ring):
            if each is not None:
                each.close()


class View(Fed):
    """A viewer of one run; who made it closes it.

    Args:
        options: of the sink: `sink`, `host`, `port`, `token`, `fps`.
        session: of ROS, whose services act on the same run; None without ROS.
        map: name of the message map.
        frame_prefix: of ROS frames.
        warn: takes lines for the operator.
        recorded: where the run is recorded, "" for nowhere: it is not run again there.

    Attributes:
        address: where it is seen, once it is attached.
    """

    drives, label, interval = True, "view", TEXTS_S

    def __init__(
        self,
        options: AnyMapping,
        session: RosSession | None = None,
        map: str | None = None,
        frame_prefix: str = "",
        warn: TextSink = print,
        recorded: str = "",
    ) -> None:
        super().__init__(warn, session)
        self._options, self._recorded = dict(options), recorded
        self._names = map or "default", frame_prefix
        self.controls = session.controls if session is not None else Controls(time.sleep)
        self._tuning, self._told = Tuning(), States(PAGE)
        self._lines: list[str] = []
        self._texts: AnyDict = {}
        self._reader: object = None
        self._driver: Driver | None = None
        self._end, self._seen, self._pages = "", -math.inf, 0
        self._act: Callable[[AnyDict], object] = bool
        self.stays = options["sink"] == "page"

    def declare(self, document: WorkflowDocument) -> None:
        """Let the workflow have the states that a viewer's parameters and pushes change."""
        self._tuning.declare(document)
        name = str(document.get("platform"))  # one of several platforms is not pushed
        with suppress(UniconError):  # the program will say so
            if declared_facts(find_factory("platforms", name, PlatformError), name).simulated:
                known = {n: spec.to_dict() for n, spec in external_states().items()}
                document.values["states"] = known | document.values["states"]

    def hook(self, program: Program) -> HookBlocks:
        """Return the blocks of the viewer. Place it after the hook that receives commands."""
        press: Callable[[], object] = bool
        if self._session is not None and self._session.estop is not None:
            press = self._session.estop.press
        self._driver = Driver(program, self._told, self.controls, self._tuning, press)
        stages = {stage: list(blocks) for stage, blocks in self._tuning.hook(program).items()}
        for stage, blocks in self._driver.blocks().items():
            stages[stage] = blocks + stages.get(stage, [])
        stages[Stage.OBSERVE] = [Block(NAME, self._tick, endless=True), *stages[Stage.OBSERVE]]
        return stages

    def attach(self, runner: Runner) -> None:
        """Start the viewer's process, before the first tick.

        Raises:
            UniconError: it cannot begin.
        """
        driver, controls = self._driver, self.controls
        assert driver is not None
        if controls.runner is None:
            controls.runner = runner
        run = runner, self._options, self._told, DEAD_MAN, driver, controls
        peripheral = self._start(*run, *self._names)
        driver.attach(peripheral, runner)
        self._act, peripheral.heard = peripheral.heard, self._heard
        self._options.pop("layout", None)  # it is written once
        controls.others += [driver.look, self._tick]
        tell = runner.options.warn

        def heard(line: str) -> None:
            self._lines = [*self._lines, line][-LINES:]
            tell(line)

        runner.program.warn = heard

    def _tell(self, peripheral: Peripheral) -> bool:
        runner = self._runner
        texts = {
            "waits_for": runner.waits_for,
            "faults": runner.faults,
            "notes": self._lines,
            "parameters": self._tuning.values(),
            "ended": self._end,
        }
        process = peripheral.process  # one that was started again knows nothing
        if process is self._reader and texts == self._texts:
            return False
        if peripheral.wish("texts", {name: _cut(each) for name, each in texts.items()}):
            self._texts, self._reader = {**texts, "faults": list(runner.faults)}, process
        return True

    def ended(self, report: Report) -> tuple[str, str] | None:
        """Let pages show how the run ended; see `Attachment`."""
        self._end = report.ended
        text = f"{self.address} stays until it is closed; Ctrl-C ends it"
        return ("page", text) if self.stays and self.watched() else None

    def watched(self) -> bool:
        """Return whether a page was open in the last two seconds."""
        peripheral, now = self._peripheral, time.monotonic()
        if peripheral is None or peripheral.process.poll() is not None:
            return False
        self._tell(peripheral)
        peripheral.listen()
        self._seen = now if self._pages else self._seen
        return not self.again and now - self._seen < STAYS

    def _heard(self, told: AnyDict) -> None:
        """Take how many pages are open; a viewer's wishes go to the driver while there is a run."""
        if "pages" in told:
            self._pages = int(told["pages"])
        elif self._end and "act" in told and self._peripheral is not None:
            act, number, _ = told["act"]
            text = self._wished(str(act))
            self._peripheral.wish("answer", number, bool(self.again), short(text, LONGEST // 4))
        else:
            self._act(told)

    def _wished(self, act: str) -> str:
        """Let another run or the recording take the page over; return what to answer."""
        if act == "again":
            simulated = self._runner.program.platform.facts.simulated
            if self._recorded or not simulated:
                return f"{self._recorded} is there" if simulated else "a robot is started by hand"
            self.again = (*sys.argv[1:], f"--view-port={self._options['port']}")
        elif act == "recording" and self._recorded:
            from unicon_lab.recording import open_record
            from unicon_lab.view.recorded import RecordedSource, shown_in

            try:
                RecordedSource(record := open_record(self._recorded), shown_in(record)[0])
            except UniconError as error:
                return f"{self._recorded} is not shown: {error}"
            given = (f"--view-{n}={self._options[n]}" for n in ("host", "port", "token", "fps"))
            self.again = ("view", self._recorded, *given)
        return "the run has ended"

    def close(self) -> None:
        """Send the last texts, and end the viewer's process; once the run has ended.

        Safe to call twice.
        """
        if self._peripheral is not None and self._tell(self._peripheral):
            time.sleep(LAST_WORDS)
        super().close()


def _cut(value: Any) -> Any:
    if isinstance(value, dict):
        return value
    if isinstance(value, str):
        return short(value, LONGEST // 4)
    lines: list[str] = []
    for line in reversed(value):
        if len(json.dumps([line, *lines])) > LONGEST // 4:
            break
        lines.insert(0, line)
    return lines
