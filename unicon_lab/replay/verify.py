"""Verify: replays a record and compares every state of every tick with the recorded, to the bit."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from unicon_base.errors import Fault, StateError
from unicon_core.runtime.phases import Phase
from unicon_core.states.standard import COMMAND_STATES
from unicon_core.workflow import WorkflowDocument
from unicon_lab.recording import Record
from unicon_lab.replay.difference import Difference, located
from unicon_lab.replay.replayed import Replayed
from unicon_lab.replay.workflow import others, versions


@dataclass(frozen=True)
class Verdict:
    """What became of a replay.

    Attributes:
        ticks: that were replayed.
        differing: those of them in which a state differs.
        commands: those of them in which a command differs.
        first: where the first of them differs, or None.
        period: of a tick in [s].
        notes: what is not as it was recorded, or could not be replayed, one line each.
        fault: whether the recorded fault came again, "" where there was none.
    """

    ticks: int
    differing: int
    commands: int
    first: Difference | None
    period: float
    notes: tuple[str, ...]
    fault: str = ""


def verify(record: Record, document: WorkflowDocument) -> Verdict:
    """Replay a record in a program that is built anew, and compare.

    Each tick begins with the recorded states, so that one that differs makes none behind it differ.

    Args:
        record: what was recorded.
        document: the workflow.

    Raises:
        StateError: the record is of another robot, is empty, or nothing in it can be replayed.
        UniconError: the workflow cannot be built.
    """
    if not record.ended.any():
        raise StateError("the record holds no tick that ended: there is nothing to compare")
    replayed = _Compared(record, document)
    program = replayed.program
    try:
        notes = others(record, program)
        ticks = replayed.run()
    finally:
        program.close()
    notes += [
        f"what {name!r} remembered is left out: there is no such block here"
        for name in sorted(replayed.homeless)
    ]
    lacking = [each.get("unproven") for each in record.memories]
    unproven = {n: why for each in lacking if isinstance(each, dict) for n, why in each.items()}
    notes += [
        f"the record lacks the memory of block {name!r} ({why}); unicon check names it"
        for name, why in unproven.items()
    ]
    notes += [f"{n} ticks {which} cannot be replayed" for which, n in replayed.skipped.items()]
    if not ticks:
        raise StateError(f"nothing in the record can be replayed: {'; '.join(notes)}")
    notes += replayed.columns.lacking
    if replayed.scaled:
        factors = ", ".join(f"{factor:g}" for factor in sorted(replayed.scaled))
        notes.append(
            f"the recorded gains are those of the workflow times {factors}: scaled from outside, "
            "as by stiffness_scale, or the workflow's are others; they are not compared"
        )
    if replayed.first is not None:
        notes += versions(record)
    return Verdict(
        ticks,
        len(replayed.rows),
        replayed.commands,
        replayed.first,
        program.period,
        tuple(notes),
        "" if replayed.fault is None else _fault(record, replayed.fault),
    )


def _fault(record: Record, again: str) -> str:
    """Return what became of the recorded fault; one from outside does not come again."""
    reason = record.facts.get("reason", "")
    if not again:
        return f"the recorded fault did not come again: {reason or 'its reason is not recorded'}"
    if not reason or reason == again:
        return f"the fault came again: {again}"
    return f"another fault than the recorded one came: {again}; recorded: {reason}"


class _Compared(Replayed):
    """Compares all states at the end of each tick."""

    def __init__(self, record: Record, document: WorkflowDocument) -> None:
        self.rows: set[int] = set()
        self.commands = 0
        self.first: Difference | None = None
        super().__init__(record, document)

    def ended(self, row: int) -> None:
        """Compare all states."""
        states, columns, beyond = self.program.states, self.columns, self.beyond
        if self.record.phases[row] == Phase.WAIT.value:  # gates mark what was measured
            beyond = beyond.union(self.program.platform.facts.writes)
        names = [
            name
            for name in columns.names
            if name not in beyond
            and states[name].tobytes() != columns.column(name, "sent")[row].tobytes()
        ]
        if not names:
            return
        self.rows.add(row)
        self.commands += not set(names).isdisjoint(COMMAND_STATES)
        if self.first is None:

            def recorded(name: str) -> NDArray[np.generic]:
                return np.asarray(columns.column(name, "sent")[row])

            self.first = located(self._begun(row), names, recorded, states, self.graph)

    def failed(self, row: int, error: Exception) -> None:
        """Take a tick that raised where the recorded one did not: it differs."""
        self.rows.add(row)
        self.commands += 1
        if self.first is None:
            kind = "" if isinstance(error, Fault) else f"{type(error).__name__}: "
            fault = f"{kind}{' '.join(str(error).split())}"
            self.first = replace(self._begun(row), fault=fault)

    def _begun(self, row: int) -> Difference:
        return Difference(row, int(self.record.ticks[row]), self.record.phases[row])
