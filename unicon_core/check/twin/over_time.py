"""Contracts that say otherwise what happens over time: gait clocks, filters, feedback, slew.

For telling why a policy falls.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from unicon_core.check.twin.perturb import Change, clock_reordered, with_terms
from unicon_core.policies.contract import FilterSpec, PhaseSpec, PolicyContract

ALPHAS = (0.2, 0.5, 0.8)
"""Weights of the newest action that are tried where no filter is said: of programs' habits."""


def clock_repairs(contract: PolicyContract) -> Iterator[Change]:
    """Yield other gait clocks: their order, offsets, period and direction."""
    phase = contract.phase
    if phase is None or not any(t.state.startswith("gait_phase") for t in contract.terms):
        return
    count = len(phase.offsets)
    each = [k + half for k in range(count) for half in (0, count)]
    if count > 1:  # sine and cosine of one leg, then of the other
        yield Change(
            "sine and cosine of each leg side by side",
            "order of sines and cosines",
            clock_reordered(contract, each),
        )
    even = tuple(2.0 * np.pi * k / count for k in range(count))
    offsets = {
        "its offsets in turns": tuple(2.0 * np.pi * x for x in phase.offsets),
        "its offsets in degrees": tuple(np.radians(phase.offsets)),
        "its offsets spread evenly": even,
        "its offsets all 0": (0.0,) * count,
        "its offsets reversed": phase.offsets[::-1],
    }
    for name, values in offsets.items():
        if not np.allclose(np.cos(values), np.cos(phase.offsets), atol=1e-3):
            yield _changed(contract, name, "phase.offsets", replace(phase, offsets=values))
    for factor in (0.5, 2.0):
        changed = replace(phase, period=phase.period * factor)
        yield _changed(contract, f"its period times {factor:g}", "phase.period", changed)


def delay_repairs(contract: PolicyContract) -> Iterator[Change]:
    """Yield the contract with actions as early as a child can give them."""
    child = contract.child
    if child is not None and child.delay > 1:
        early = replace(contract, child=replace(child, delay=1))
        yield Change("child.delay 1", "child.delay", early)


def filter_repairs(contract: PolicyContract) -> Iterator[Change]:
    """Yield other filters of action and terms, other feedback, and commands without a slew."""
    action, said = contract.action, contract.action.filter
    if said is not None or action.clip is not None:
        for word in ("raw", "clipped", *(("filtered",) if said is not None else ())):
            if word != action.feedback:
                fed = replace(action, feedback=word)
                changed = replace(contract, action=fed)
                yield Change(f"action.feedback {word}", "action.feedback", changed)
    for name, other in _others(said):
        fed = replace(action, filter=other)
        if other is None and action.feedback == "filtered":
            fed = replace(fed, feedback="clipped")
        yield Change(f"action.filter {name}", "action.filter", replace(contract, action=fed))
    for alpha in ALPHAS if said is None else ():
        spec = FilterSpec(alpha=alpha, start="zeros")
        for word in (action.feedback, "filtered"):
            fed = replace(action, filter=spec, feedback=word)
            name = f"an action.filter of alpha {alpha:g}, feedback {word}"
            yield Change(name, "action.filter", replace(contract, action=fed))
    for i, term in enumerate(contract.terms):
        for name, other in _others(term.filter):
            terms = [*contract.terms[:i], replace(term, filter=other), *contract.terms[i + 1 :]]
            name = f"the filter of term {term.name!r} {name}"
            yield Change(name, f"filter of term {term.name!r}", with_terms(contract, terms))
    if contract.command is not None:
        unslewed = replace(contract, command=None)
        yield Change("a command without slew", "command.slew", unslewed)


def _others(said: FilterSpec | None) -> Sequence[tuple[str, FilterSpec | None]]:
    """Return other filters than the one that is said: how, and which."""
    if said is None:
        return []
    found: list[tuple[str, FilterSpec | None]] = [("left out", None)]
    if said.alpha is not None and said.alpha < 1.0:
        found.append(("of 1 − alpha", replace(said, alpha=1.0 - said.alpha)))
    if said.low_pass is not None:
        factors = {"a quarter": 0.25, "four times": 4.0, "1 / 2π": 0.5 / np.pi, "2π": 2.0 * np.pi}
        for name, factor in factors.items():
            frequency = said.low_pass * factor
            found.append((f"of {name} the cut-off", replace(said, low_pass=frequency)))
    return found


def _changed(contract: PolicyContract, name: str, culprit: str, phase: PhaseSpec) -> Change:
    return Change(f"the gait clock, {name}", culprit, replace(contract, phase=phase))
