"""Verify: replays a record and compares every state of every tick bit-exact with the recorded."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np

from unicon_base import Fault, StateError
from unicon_base.arrays import Array
from unicon_core.flow import Block
from unicon_core.flow.compiled import CompiledGraph
from unicon_core.policies import Policy
from unicon_core.policies.policy import policy_of
from unicon_core.runtime.phases import Phase
from unicon_core.states.standard import COMMAND_STATES
from unicon_core.workflow import WorkflowDocument
from unicon_lab.recording import Record
from unicon_lab.replay.replayed import Replayed, ratio
from unicon_lab.replay.workflow import others, versions


@dataclass(frozen=True)
class Difference:
    """What differs in a tick.

    Attributes:
        row: of the record.
        tick: its number.
        phase: of the run.
        block: that wrote the state, and what amends it; of a fault "".
        state: the first one that differs, in the order in which blocks write them.
        element: name or number of its first element that differs; "" of a scalar.
        recorded, replayed: the values of that element.
        why: the observation's term, or what else can be told of it.
        others: further states that differ.
        fault: what the replayed tick raised, which the recorded one did not, or "".
    """

    row: int
    tick: int
    phase: str
    block: str = ""
    state: str = ""
    element: str = ""
    recorded: float = 0.0
    replayed: float = 0.0
    why: tuple[str, ...] = ()
    others: tuple[str, ...] = ()
    fault: str = ""

    def lines(self, period: float) -> list[tuple[str, str]]:
        """Return it as pairs for a table."""
        time = f"{self.tick * period:.6g} s"
        found = [("first differs", f"tick {self.tick} ({time}, phase {self.phase})")]
        if self.fault:
            return [*found, ("raised", self.fault), ("recorded", "the tick ended without a fault")]
        element = f", {self.element}" if self.element else ""
        return [
            *found,
            ("block", self.block),
            ("state", f"{self.state}{element}"),
            ("recorded", f"{self.recorded!r}"),
            ("replayed", f"{self.replayed!r}"),
            *(("why", text) for text in self.why),
            *([("also differ", ", ".join(self.others))] if self.others else []),
        ]


def unequal(there: Array, here: Array) -> tuple[int, ...]:
    """Return the place of the first element of two arrays whose bytes differ."""
    bits = [np.ascontiguousarray(each).view(f"V{here.itemsize}") for each in (there, here)]
    return tuple(np.argwhere(bits[0] != bits[1])[0].tolist())


def _ran(graph: CompiledGraph) -> Iterator[Block]:
    """Yield the blocks that ran in the last tick, in their order; fused ones one by one."""
    ends = [int(stamp) for stamp in graph.stamps[2:]]
    for i in sorted(range(len(ends)), key=ends.__getitem__):
        if ends[i]:
            yield from graph.blocks[i].parts or (graph.blocks[i],)


def _reason(policy: Policy, state: str, column: int, there: Array, here: Array) -> list[str]:
    """Return the known reasons of a difference in a policy's state."""
    own = {
        name: next((w for w in policy.writes if w == name or w.endswith(f"_{name}")), "")
        for name in ("observation", "action")
    }
    if state == own["observation"] and policy.lane.observation is not None:
        return _term(
            policy.lane.observation, column, np.atleast_2d(there)[0], np.atleast_2d(here)[0]
        )
    if state == own["action"]:
        same = "the observation is the same and " if own["observation"] else ""
        return [f"{same}the action is not: another network, another runtime of it, or its memory"]
    if state == "joint_pos_target":
        return [
            "the action is the same: its scale, offset, clip or order of joints is not, or a "
            "block that amends the target changed"
        ]
    if state in ("joint_stiffness", "joint_damping"):
        return ["observation and action are the same: the gain itself is another one"]
    return []


def _term(observed: Any, column: int, there: Array, here: Array) -> list[str]:
    """Return the observation's term, and how its recorded values would come about."""
    part, i, frame = observed.element_of(column)
    facts = [f"scale {part.scale[i]:g}"]
    if part.subtract[i]:
        facts.append(f"subtract {part.subtract[i]:g}")
    if np.isfinite((part.low[i], part.high[i])).any():
        facts.append(f"clip {part.low[i]:g} to {part.high[i]:g}")
    lines = [f"{observed.place_of(column)}: here {', '.join(facts)}"]
    places = [observed.element_of(c) for c in range(observed.size)]
    columns = [c for c, (p, _, age) in enumerate(places) if p is part and age == frame]
    there, here = there[columns], here[columns]
    if (factor := ratio(there, here, 1e-4)) is not None and (here != 0.0).sum() > 1:
        was = ", ".join(f"{factor * float(each):.6g}" for each in np.unique(part.scale)[:4])
        return [*lines, f"the recorded term is this one times {factor:.6g}: its scale was {was}"]
    for a, b in combinations(np.flatnonzero(there != here).tolist(), 2):
        if there[a] == here[b] and there[b] == here[a]:
            said = [part.names[i] if part.names else f"element {i}" for i in (a, b)]
            return [*lines, f"{said[0]} and {said[1]} have each other's recorded values"]
    return lines


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


def verify(record: Record, document: WorkflowDocument, native: bool = False) -> Verdict:
    """Replay a record in a program that is built anew, and compare.

    Each tick begins with the recorded states, so that one that differs makes none behind it differ.

    Args:
        record: what was recorded.
        document: the workflow.
        native: replay in a native tick, as `RunOptions.native`.

    Raises:
        StateError: the record is of another robot, is empty, or nothing in it can be replayed.
        UniconError: the workflow cannot be built.
    """
    if not record.ended.any():
        raise StateError("the record holds no tick that ended: there is nothing to compare")
    replayed = _Compared(record, document, native)
    program = replayed.program
    try:
        notes = others(record, program)
        ticks = replayed.run()
    finally:
        program.close()
    unproven: dict[str, str] = {}
    for each in record.memories:
        if isinstance(each.get("unproven"), dict):
            unproven |= each["unproven"]
    notes += [
        *(
            f"what {name!r} remembered is left out: there is no such block here"
            for name in sorted(replayed.homeless)
        ),
        *(
            f"the record lacks the memory of block {name!r} ({why}); unicon check names it"
            for name, why in unproven.items()
        ),
        *(f"{n} ticks {which} cannot be replayed" for which, n in replayed.skipped.items()),
    ]
    numbers, phases = record.ticks, record.phases
    notes += [
        f"the run was set back from tick {numbers[row] + 1} to tick {numbers[row + 1]}: a branch"
        for row in np.flatnonzero(np.diff(numbers) <= 0)
        if phases[row] == phases[row + 1]
    ]
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
    again, reason = replayed.fault, record.facts.get("reason", "")
    fault = ""
    if again is not None:  # a fault from outside does not come again
        fault = f"another fault than the recorded one came: {again}; recorded: {reason}"
        if not again:
            fault = "the recorded fault did not come again: "
            fault += reason or "its reason is not recorded"
        elif not reason or reason == again:
            fault = f"the fault came again: {again}"
    counts = ticks, len(replayed.rows), replayed.commands
    return Verdict(*counts, replayed.first, program.period, tuple(notes), fault)


class _Compared(Replayed):
    """Compares all states at the end of each tick."""

    def __init__(self, record: Record, document: WorkflowDocument, native: bool) -> None:
        self.rows: set[int] = set()
        self.commands = 0
        self.first: Difference | None = None
        super().__init__(record, document, native)

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
            self.first = self._located(row, names)

    def failed(self, row: int, error: Exception) -> None:
        """Take a tick that raised where the recorded one did not: it differs."""
        self.rows.add(row)
        self.commands += 1
        if self.first is None:
            kind = "" if isinstance(error, Fault) else f"{type(error).__name__}: "
            fault = f"{kind}{' '.join(str(error).split())}"
            self.first = replace(self._begun(row), fault=fault)

    def _located(self, row: int, names: Collection[str]) -> Difference:
        """Return the first difference of a tick that has just run, with its reason.

        Args:
            row: of the record.
            names: of all states that differ, at least one.
        """
        ran = list(_ran(self.graph))
        block, state = next(
            ((b, name) for b in ran for name in (*b.writes, *b.amends) if name in names),
            (None, next(iter(names))),
        )
        states = self.program.states
        there = np.atleast_1d(self.columns.column(state, "sent")[row])
        here = np.atleast_1d(states[state])
        place = unequal(there, here)
        said, why = "none that ran in this tick", []
        if block is not None:
            others = [each.name for each in ran if each is not block and state in each.amends]
            more = f"; amended by {', '.join(dict.fromkeys(others))}" if others else ""
            said = f"{block.name}{f' ({block.where})' if block.where else ''}{more}"
            policy = policy_of(block)
            why = [] if policy is None else _reason(policy, state, place[-1], there, here)
        spec, inner, element = states.spec(state), place, list[str]()
        if states.num_robots is not None:
            element, inner = [f"robot {place[0]}"], place[1:]
        if spec.names:
            element += [*map(str, inner[:-1]), spec.names[inner[-1]]]
        elif spec.shape:
            element.append(f"element {', '.join(map(str, inner))}")
        return replace(
            self._begun(row),
            block=said,
            state=state,
            element=", ".join(element),
            recorded=there[place].item(),
            replayed=here[place].item(),
            why=tuple(why),
            others=tuple(name for name in names if name != state),
        )

    def _begun(self, row: int) -> Difference:
        return Difference(row, int(self.record.ticks[row]), self.record.phases[row])
