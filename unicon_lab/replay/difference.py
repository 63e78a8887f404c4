"""Difference: where a replayed tick is not the recorded one: block, state, element and term."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from unicon_base.arrays import Array
from unicon_core.flow import Block
from unicon_core.flow.compiled import CompiledGraph
from unicon_core.policies import Policy
from unicon_core.policies.driven import policy_of
from unicon_core.states import States

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
