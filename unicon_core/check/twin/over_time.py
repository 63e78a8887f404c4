"""Contracts whose clocks are others: of the gait, for telling why a policy falls."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from unicon_core.check.twin.perturb import Change, clock_reordered
from unicon_core.policies.contract import PhaseSpec, PolicyContract

__all__ = ["clock_repairs"]


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


def _changed(contract: PolicyContract, name: str, culprit: str, phase: PhaseSpec) -> Change:
    return Change(f"the gait clock, {name}", culprit, replace(contract, phase=phase))
