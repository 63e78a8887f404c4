"""States of a record as those of a program, aligned by name.

`Series` gives them tick by tick, for platform and block; `Columns` compares them, for replays.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from unicon_base import StateError, UniconError, WorkflowError
from unicon_base.arrays import Array, Index
from unicon_core.blocks.postures import robot_gains
from unicon_core.runtime.phases import Phase
from unicon_core.states import States
from unicon_core.states.standard import COMMAND_STATES, JOINT_STATES
from unicon_core.workflow.autowire import BuildContext
from unicon_lab.recording import Record, open_record


def refuse_other_batch(record: Record, states: States) -> None:
    """Refuse a record of another number of robots than a program's.

    Raises:
        StateError: it is.
    """
    if record.layout.num_robots != states.num_robots:
        raise StateError(
            f"the record is of {record.layout.num_robots or 1} robots and the workflow of "
            f"{states.num_robots or 1}; give the workflow the same num_robots"
        )


def elements(theirs: Sequence[str], ours: Sequence[str]) -> Index | None:
    """Return which element of the record is each of ours, shape (n,); None where all are alike.

    Args:
        theirs: names of the record's elements, ours among them.
        ours: names of the program's.
    """
    if tuple(theirs) == tuple(ours):
        return None
    places = {name: i for i, name in enumerate(theirs)}
    return np.array([places[name] for name in ours], np.intp)


MOVING = (Phase.RUN.value, Phase.SOFT.value)
"""Phases of a run in which its flow ticks."""


def opened(bag: str, relative_to: Path | None) -> Record:
    """Open a record that a workflow names: beside its file, or from the working folder.

    Raises:
        UniconError: it cannot be read.
    """
    beside = None if relative_to is None else relative_to / bag
    if beside is not None and os.path.exists(beside):
        return open_record(beside)
    return open_record(os.path.expanduser(bag))  # which leaves a user alone who is not known


class Series:
    """What is put into a program's states in its ticks.

    Where the record ticked at another rate, a tick gets the newest values that had come by then.

    Args:
        record: the record; ticks of its flow, or all where it has none.
        names: states that are wanted; those that it does not have are left out.
        moment: of its ticks.
        states: of the program, elements aligned by name.
        period: of the program's ticks in [s]; None for the record's own ticks, one by one.
        start: how much of the record is left out at its beginning, in [s].

    Attributes:
        names: states that are there.
        rows: row of the record for each tick, shape (ticks,).

    Raises:
        StateError: it is empty, or lacks joints of the robot.
    """

    def __init__(
        self,
        record: Record,
        names: Sequence[str],
        moment: str,
        states: States,
        period: float | None,
        start: float = 0.0,
    ) -> None:
        self.record = record
        self.rows = _rows(record, period, start)
        refuse_other_batch(record, states)
        self._values: dict[str, Array] = {
            name: values[self.rows]
            for name in names
            if name in record.kept[moment] and name in states
            if (values := _aligned(record, name, moment, states)) is not None
        }
        self._pairs = tuple((states[name], values) for name, values in self._values.items())
        self.names = tuple(self._values)

    def __len__(self) -> int:
        return len(self.rows)

    def values(self, name: str) -> Array:
        """Return a state in every tick of the program, shape (ticks, …)."""
        return self._values[name]

    def put(self, tick: int) -> None:
        """Put the states of a tick into the program's."""
        for view, values in self._pairs:
            view[...] = values[tick]


def _rows(record: Record, period: float | None, start: float) -> Index:
    ended = np.flatnonzero(record.ended)
    rows = np.array([i for i in ended if record.phases[i] in MOVING], np.intp)
    rows = rows if len(rows) else ended
    if not len(rows):
        raise StateError("the record holds no tick that ended: nothing can be replayed")
    own = record.period
    # Clocks may be set back.
    times = np.maximum.accumulate(record.stamps[rows] - record.stamps[rows[0]]) * 1e-9
    if period is None or abs(period - own) <= 1e-6 * own:
        period = own
    else:
        grid = np.arange(int(float(times[-1]) / period + 1e-6) + 1) * period
        rows = rows[np.searchsorted(times, grid + 1e-9, side="right") - 1]
    skipped = start / period
    if not 0.0 <= skipped < len(rows) - 0.5:
        raise UniconError(
            f"start is {start:g} s, and the record is {float(times[-1]):.3g} s long; give less, "
            "from 0 on"
        )
    return rows[round(skipped) :]


def _aligned(record: Record, name: str, moment: str, states: States) -> Array | None:
    """Return a state of the record with the program's elements, None where they do not fit."""
    theirs, ours = record.layout.specs[name], states.spec(name)
    values = record.states(name, moment)
    if theirs.names != ours.names:
        lacking = [each for each in ours.names if each not in theirs.names]
        if lacking and name in JOINT_STATES:
            raise StateError(
                f"the record is of robot {record.facts.get('robot', '?')} and has no joint "
                f"{lacking[0]!r} ({name}); its joints: {', '.join(theirs.names)}"
            )
        if lacking or not ours.names:
            return None
        order = elements(theirs.names, ours.names)
        values = values if order is None else values[..., order]
    same = values.shape[1:] == states[name].shape and values.dtype == states[name].dtype
    return values if same else None


class Columns:
    """What a record has of a program's states, elements in the program's order.

    Args:
        record: the record.
        states: of the program.

    Attributes:
        names: states that both have with the same elements.
        lacking: what is of one side alone, or of other sizes, one line each.

    Raises:
        StateError: the record is of a robot with other joints, or of another number of robots.
    """

    def __init__(self, record: Record, states: States) -> None:
        self._record, self._states = record, states
        refuse_other_batch(record, states)
        self._index: dict[str, Index | None] = {}
        self.lacking: list[str] = []
        theirs, ours = record.layout.specs, states.layout.specs
        joints = [set(specs["joint_pos"].names) for specs in (theirs, ours) if "joint_pos" in specs]
        if len(joints) == 2 and joints[0] != joints[1]:
            raise StateError(
                f"the record is of robot {record.facts.get('robot', '?')} with {len(joints[0])} "
                f"joints and the workflow's has {len(joints[1])}; joint "
                f"{min(joints[0] ^ joints[1])!r} is of one alone: give a workflow for the recorded "
                "robot"
            )
        for name, spec in ours.items():
            if name not in theirs:
                self.lacking.append(f"state {name!r} is not in the record")
            elif (theirs[name].shape, theirs[name].dtype) != (spec.shape, spec.dtype):
                self.lacking.append(
                    f"state {name!r} is {theirs[name].dtype} of shape {theirs[name].shape} in the "
                    f"record and {spec.dtype} of shape {spec.shape} here: it is not compared"
                )
            elif sorted(theirs[name].names) != sorted(spec.names):
                self.lacking.append(f"state {name!r} has other elements in the record")
            else:
                self._index[name] = elements(theirs[name].names, spec.names)
        self.lacking += [f"state {n!r} of the record is not here" for n in theirs if n not in ours]
        self.names = tuple(self._index)
        self._turned = [name for name, index in self._index.items() if index is not None]
        self._partly = len(record.kept["received"]) < len(record.layout.slots)
        self._kept: dict[tuple[str, str], Array] = {}

    def column(self, name: str, moment: str) -> Array:
        """Return a state of `names` in every tick, shape (ticks, …)."""
        key = (name, moment)
        if key not in self._kept:
            values, index = self._record.states(name, moment), self._index[name]
            self._kept[key] = values if index is None else np.ascontiguousarray(values[..., index])
        return self._kept[key]

    def kept(self, moment: str, names: Sequence[str]) -> list[str]:
        """Return those of some states that the record has at a moment."""
        return [name for name in names if name in self._record.kept[moment]]

    def begin(self, row: int) -> None:
        """Put states into the program as they were received in a tick."""
        if row and self._partly:  # what did not come from outside is what the tick before left
            self._record.feed("sent", row - 1, self._states)
            self._align("sent", row - 1)
        self._record.feed("received", row, self._states)
        self._align("received", row)

    def _align(self, moment: str, row: int) -> None:
        for name in self._turned:
            if name in self._record.kept[moment]:
                self._states[name][...] = self.column(name, moment)[row]


TARGET = "joint_pos_target"
GAINS = ("joint_stiffness", "joint_damping")


class Recorded:
    """Writes recorded commands tick by tick; done with the last one.

    A robot's approach ends where they begin, as before any flow. In a simulator, which begins where
    its scene says, `approach` goes there.

    Args:
        context: states, robot and period.
        series: of the commands.
        approach: how long the joints go from where they are to the first target, in [s].
    """

    memory = ("_from", "_tick")

    name = "recorded"
    reads = ("joint_pos",)

    def __init__(self, context: BuildContext, series: Series, approach: float) -> None:
        states = context.states
        self._series, self._ticks = series, round(approach / context.period)
        self._target, self._measured = states[TARGET], states["joint_pos"]
        self._from = np.zeros_like(self._target)
        self._first = np.array(series.values(TARGET)[0])
        lacking = [name for name in GAINS if name not in series.names]
        gains = robot_gains(context.robot, "recorded") if lacking else ()
        self._gains = [(states[n], g) for n, g in zip(GAINS, gains) if n in lacking]
        self.writes = (*series.names, *lacking)
        self._tick = 0

    def __call__(self) -> bool:
        tick = self._tick
        self._tick += 1
        if tick == 0:
            self._from[...] = self._measured
        for view, values in self._gains:
            view[...] = values
        behind = tick - self._ticks
        self._series.put(max(behind, 0))
        if behind < 0:
            share = np.float32((tick + 1) / (self._ticks + 1))
            np.subtract(self._first, self._from, out=self._target)
            self._target *= share
            self._target += self._from
        return behind >= len(self._series) - 1

    def reset(self) -> None:
        """Begin anew."""
        self._tick = 0


def recorded(
    context: BuildContext,
    *,
    bag: str,
    take: Sequence[str] = COMMAND_STATES,
    start: float = 0.0,
    approach: float = 0.0,
) -> Recorded:
    """Give recorded commands.

    Args:
        context: states, robot and period.
        bag: recording or fault record: a file or a folder, beside the workflow or from here.
        take: command states; gains that are not among them, or not in it, are
            the robot file's.
        start: how much is left out at the beginning, in [s].
        approach: how long the joints first go from where they are to the first target, in [s].

    Raises:
        WorkflowError: it does not fit the robot, or holds a command that is not finite.
        UniconError: it cannot be read.
    """
    if not 0.0 <= approach <= 60.0:
        raise WorkflowError(f"recorded: approach is {approach!r} s; give 0 to 60")
    for name in take:
        if name not in COMMAND_STATES:
            raise WorkflowError(
                f"recorded: {name!r} is not a command state; known: {', '.join(COMMAND_STATES)}"
            )
    record = opened(bag, context.relative_to)
    there = record.told("imported_states", list)  # all else in it was never commanded
    wanted = [name for name in COMMAND_STATES if name in take and (not there or name in there)]
    series = Series(record, wanted, "sent", context.states, context.period, start)
    if TARGET not in series.names:
        raise WorkflowError(
            f"recorded: {bag} gives no {TARGET} for the joints of robot {context.robot.name}; it "
            f"is of robot {record.facts.get('robot', '?')}, and take is {', '.join(take)}"
        )
    for name in series.names:
        bad = np.argwhere(~np.isfinite(series.values(name).astype(float)))
        if len(bad):
            tick, place = int(bad[0][0]), int(bad[0][-1])
            joint = context.robot.joint_names[place]
            raise WorkflowError(
                f"recorded: {bag} holds a {name} that is not finite ({joint}, row "
                f"{int(series.rows[tick])}); record anew, or begin behind it with start"
            )
    return Recorded(context, series, approach)
