"""Verify: replays a record and compares every state of every tick with the recorded, to the bit."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from unicon_base.arrays import Array
from unicon_base.errors import Fault, StateError
from unicon_core.flow import Block
from unicon_core.flow.compiled import CompiledGraph
from unicon_core.policies import Policy
from unicon_core.policies.driven import policy_of
from unicon_core.runtime.phases import Phase
from unicon_core.states import States
from unicon_core.states.standard import COMMAND_STATES
from unicon_core.workflow import WorkflowDocument
from unicon_lab.recording import Record
from unicon_lab.replay.replayed import Replayed
from unicon_lab.replay.workflow import others, versions

TARGET, GAINS = "joint_pos_target", ("joint_stiffness", "joint_damping")


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


def located(
    found: Difference,
    names: Collection[str],
    recorded: Callable[[str], Array],
    states: States,
    graph: CompiledGraph,
) -> Difference:
    """Return the difference with block, element and reason, from the states that differ.

    Args:
        found: row, tick and phase.
        names: of all states that differ, at least one.
        recorded: returns the recorded value of a state.
        states: as replayed.
        graph: which has just run the tick.
    """
    block, state = next(
        ((b, name) for b in _ran(graph) for name in (*b.writes, *b.amends) if name in names),
        (None, next(iter(names))),
    )
    there, here = np.atleast_1d(recorded(state)), np.atleast_1d(states[state])
    place = unequal(there, here)
    why: list[str] = []
    policy = policy_of(block) if block is not None else None
    if policy is not None:
        why = _reason(policy, state, place, recorded, states, names)
    return replace(
        found,
        block=_said(block, state, graph),
        state=state,
        element=_element(states, state, place),
        recorded=there[place].item(),
        replayed=here[place].item(),
        why=tuple(why),
        others=tuple(name for name in names if name != state),
    )


def unequal(there: Array, here: Array) -> tuple[int, ...]:
    """Return the place of the first element of two arrays whose bytes differ."""
    size = f"V{here.dtype.itemsize}"
    bits = [np.ascontiguousarray(each).view(size) for each in (there, here)]
    return tuple(int(i) for i in np.argwhere(bits[0] != bits[1])[0])


def _ran(graph: CompiledGraph) -> Iterator[Block]:
    """Yield the blocks that ran in the last tick, in their order; fused ones one by one."""
    ends = [int(stamp) for stamp in graph.stamps[2:]]
    for i in sorted(range(len(ends)), key=ends.__getitem__):
        if ends[i]:
            yield from graph.blocks[i].parts or (graph.blocks[i],)


def _said(block: Block | None, state: str, graph: CompiledGraph) -> str:
    if block is None:
        return "none that ran in this tick"
    amending = [b.name for b in _ran(graph) if b is not block and state in b.amends]
    where = f" ({block.where})" if block.where else ""
    more = f"; amended by {', '.join(dict.fromkeys(amending))}" if amending else ""
    return f"{block.name}{where}{more}"


def _element(states: States, state: str, place: tuple[int, ...]) -> str:
    spec, batch = states.spec(state), states.num_robots is not None
    robot = f"robot {place[0]}, " if batch else ""
    inner = place[1:] if batch else place
    if not spec.shape:
        return robot.removesuffix(", ")
    if not spec.names:
        return f"{robot}element {', '.join(map(str, inner))}"
    before = "".join(f"{i}, " for i in inner[:-1])
    return f"{robot}{before}{spec.names[inner[-1]]}"


# -- of a policy --------------------------------------------------------------------------------


def _reason(
    policy: Policy,
    state: str,
    place: tuple[int, ...],
    recorded: Callable[[str], Array],
    states: States,
    names: Collection[str],
) -> list[str]:
    """Return what can be told of a policy's state that differs."""
    observed = policy.lane.observation
    if state == _own(policy, "observation") and observed is not None:
        return _term(
            policy, place[-1], np.atleast_2d(recorded(state)), np.atleast_2d(states[state])
        )
    if state == _own(policy, "action"):
        same = "the observation is the same and " if _own(policy, "observation") else ""
        return [f"{same}the action is not: another network, another runtime of it, or its memory"]
    if state == TARGET:
        return [
            "the action is the same: its scale, offset, clip or order of joints is not, or a "
            "block that amends the target changed"
        ]
    if state in GAINS:
        return ["observation and action are the same: the gain itself is another one"]
    return []


def _own(policy: Policy, name: str) -> str:
    """Return a state of the policy as it is declared, "" where it has none of that name."""
    return next((w for w in policy.writes if w == name or w.endswith(f"_{name}")), "")


def _term(policy: Policy, column: int, there: Array, here: Array) -> list[str]:
    """Tell the observation's term, and how its recorded values would come about."""
    observed = policy.lane.observation
    assert observed is not None
    part, i, frame = observed.element_of(column)
    facts = [f"scale {part.scale[i]:g}"]
    if part.subtract[i]:
        facts.append(f"subtract {part.subtract[i]:g}")
    if np.isfinite((part.low[i], part.high[i])).any():
        facts.append(f"clip {part.low[i]:g} to {part.high[i]:g}")
    lines = [f"{observed.place_of(column)}: here {', '.join(facts)}"]
    places = [observed.element_of(c) for c in range(observed.size)]
    columns = [c for c, (p, _, age) in enumerate(places) if p is part and age == frame]
    hint = _hint(there[0, columns], here[0, columns], part.scale, part.names)
    return lines + ([hint] if hint else [])


def _hint(there: Array, here: Array, scale: Array, names: Sequence[str]) -> str:
    """Return how the values of a term would become the recorded ones, "" where nothing fits."""
    moved = here != 0.0
    if moved.sum() > 1 and not there[~moved].any():
        ratios = there[moved].astype(float) / here[moved]
        factor = float(ratios[0])
        if np.all(np.abs(ratios - factor) <= 1e-4 * abs(factor)):
            was = ", ".join(f"{factor * float(each):.6g}" for each in np.unique(scale)[:4])
            return f"the recorded term is this one times {factor:.6g}: its scale was {was}"
    odd = [int(i) for i in np.flatnonzero(there != here)]
    for a in odd:
        for b in odd:
            if a < b and there[a] == here[b] and there[b] == here[a]:
                said = [names[i] if names else f"element {i}" for i in (a, b)]
                return f"{said[0]} and {said[1]} have each other's recorded values"
    return ""


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
