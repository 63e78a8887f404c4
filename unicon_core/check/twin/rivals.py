"""Contracts under which a walk does not fall, so that only a comparison tells which is right.

A policy that was trained over varied robots bears half and twice its damping, period and gait
clock. Where one of them walks clearly better it is a finding; where none does, the walk says
nothing about them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from unicon_core.check.twin.perturb import Change
from unicon_core.policies import PolicyContract

GAIT = "phase.period"
"""Culprit of a clock that is too fast or too slow. With one too fast a policy may follow its
command as well, in more and quicker steps: the rate of its targets tells."""


def rivals(contract: PolicyContract) -> Iterator[Change]:
    """Yield the contract with half and twice its damping, its period and that of its gait clock.

    Args:
        contract: the given one.
    """
    for factor in (0.5, 2.0):
        softer = replace(contract, damping=contract.damping * np.float32(factor))
        yield Change(f"damping times {factor:g}", "damping", softer)
        slower = replace(contract, period=contract.period * factor)
        yield Change(f"a period of {slower.period:g} s", "period", slower)
        if contract.phase is not None:
            clock = replace(contract.phase, period=contract.phase.period * factor)
            what = f"a gait clock of {clock.period:g} s"
            yield Change(what, GAIT, replace(contract, phase=clock))
