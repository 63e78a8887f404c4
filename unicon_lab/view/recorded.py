"""RecordedSource: a recording as a source of what is shown, with a time that is chosen."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from unicon_base import AnyDict, UniconError
from unicon_base.arrays import Float64
from unicon_core.flow import compile_graph
from unicon_core.models.find import model_of
from unicon_core.robots import load_robot
from unicon_core.runtime.phases import Phase
from unicon_core.states import States
from unicon_core.workflow import Program
from unicon_lab.recording import Record
from unicon_lab.replay.workflow import robot_of, workflow_of
from unicon_lab.view.shown import HEAD, Shown, shown_of
from unicon_lab.view.source import Answered, Snapshot

BEHIND_S = 60.0
"""So much of the ticks behind the present one is given at once, in [s]: what plots can show."""

MOST = 6000
"""Ticks that are given at once."""


def shown_in(record: Record) -> tuple[Shown, list[str]]:
    """Return what a recording is of, and what could not be found of it, one line each.

    Args:
        record: which names its workflow, robot and platform.

    Raises:
        UniconError: its robot is not known here.
    """
    facts, notes = record.facts, []
    phases = tuple(phase.value for phase in Phase)
    try:
        program = Program(workflow_of(record), dry=True)
    except UniconError as error:
        notes.append(f"its workflow is not built here, so that skills are not named: {error}")
        robot = load_robot(robot_of(record))
        try:
            model = model_of(None, robot)
        except UniconError as lacking:
            model = None
            notes.append(f"the robot is not drawn: {lacking}")
        said = facts.get("platform", "")
        shown = Shown(
            *(facts.get("workflow") or "recording", said, True, robot, model, record.layout),
            *(record.period, phases, ()),
        )
        return shown, notes
    try:
        shown, _ = shown_of(program, compile_graph(program.root))
    finally:
        program.close()
    about = record.told("platform_facts", dict)
    return replace(
        shown,
        platform=facts.get("platform", shown.platform),
        simulated=bool(about.get("simulated", shown.simulated)),
        layout=record.layout,
        period=record.period,
        graph=(),  # which part of it ran is not recorded
        drives=False,
        parameters={},
    ), notes


class _Row(Snapshot):
    """A tick of a recording."""

    def __init__(self, record: Record, phases: tuple[str, ...]) -> None:
        super().__init__(record.layout, HEAD.size + record.layout.nbytes)
        self._record, self._own = record, States(record.layout, buffer=self.buffer)
        self._phases = {name: number for number, name in enumerate(phases)}
        self.robots = record.layout.num_robots or 1

    def put(self, row: int) -> Snapshot:
        """Take a tick by its index."""
        record = self._record
        record.feed("sent", row, self._own)
        self.handle, self.tick = row + 1, int(record.ticks[row])
        self.wall_ns = int(record.stamps[row])
        self.phase = self._phases.get(record.phases[row], len(self._phases))
        return self


class RecordedSource:
    """The ticks of a recording up to a time that is chosen.

    Args:
        record: it.
        shown: of `shown_in`.
        notes: what to tell about it.

    Attributes:
        span: first and last moment in [s].
        times: of each tick in [s].
        speed: how fast `play_on` plays.
        texts: `faults` of a fault record; notes.

    Raises:
        UniconError: it has no tick.
    """

    def __init__(self, record: Record, shown: Shown, notes: list[str] | None = None) -> None:
        if not len(record.ticks):
            raise UniconError(
                f"{record.paths[0]} has no ticks: its run ended before the first one; give another"
            )
        self.times = _times(record)
        self.span = (0.0, float(self.times[-1]))
        self.speed = 1.0
        self._latest, self._each = _Row(record, shown.phases), _Row(record, shown.phases)
        self._most = max(1, min(MOST, round(BEHIND_S / record.period)))
        self._row, self._time, self._looked = 0, 0.0, 0.0
        self.answers: list[Answered] = []
        self.texts: AnyDict = {
            "waits_for": "",
            "timed": False,
            "faults": list(map(str, record.told("faults", list) or ())),
            "notes": [f"recording {record.paths[0].name}", *(notes or ())],
        }

    def seek(self, moment: float) -> None:
        """Choose the newest tick at a time in [s]; one outside of `span` is the nearest end."""
        if not np.isfinite(moment):
            return
        self._time = min(max(moment, self.span[0]), self.span[1])
        found = int(np.searchsorted(self.times, self._time + 1e-9, side="right"))
        self._row = max(found - 1, 0)

    def play_on(self) -> bool:
        """Let the time pass since the last call, for a sink without a time of its own.

        False at the end.
        """
        now = time.monotonic()
        passed, self._looked = now - (self._looked or now), now
        self.seek(self._time + self.speed * passed)
        return self._time < self.span[1]

    def latest(self) -> Snapshot | None:
        """Return the tick at the chosen time. Valid until the next call."""
        return self._latest.put(self._row)

    def since(self, handle: int) -> Iterator[Snapshot]:
        """Yield each tick behind one up to the chosen time; of very many the last ones."""
        end = self._row + 1
        for row in range(max(handle, end - self._most, 0), end):
            yield self._each.put(row)


def _times(record: Record) -> Float64:
    """Return the time of each tick in [s], from 0 on: by its stamp, or its number where not even
    that rises (a reset)."""
    stamps: Float64 = (record.stamps - record.stamps[0]).astype(np.float64) * 1e-9
    if (np.diff(stamps) >= 0.0).all() and stamps[-1] > 0.5 * (len(stamps) - 1) * record.period:
        return stamps
    return np.arange(len(stamps), dtype=np.float64) * record.period
