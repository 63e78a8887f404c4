"""ClockRate: the key `phase.rate`, for gait clocks whose frequency a state gives.

From Improbable-AI/walk-these-ways, `go1_gym_deploy/envs/lcm_agent.py`: the frequency in [Hz] is an
element of the command, by which one phase advances, wrapped at 1. Policies that set the rate
themselves have it as an output, which `outputs` makes a state; it acts from the next tick on.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from unicon_base.schema.marks import Text, Within
from unicon_core.bounds import SCALE
from unicon_core.policies.hints import Place


@dataclass(frozen=True)
class ClockRate:
    """How fast a gait clock runs: `(offset + scale · state[index]) / period`, in gaits a second.

    Attributes:
        state: such as a command with the frequency in [Hz] (`period: 1.0`), or an output.
        index: element of it.
        scale, offset: of it.
    """

    state: Text
    index: Place = 0
    scale: Annotated[float, Within(-SCALE, SCALE)] = 1.0
    offset: Annotated[float, Within(-SCALE, SCALE)] = 0.0

    def __str__(self) -> str:
        return f"({self.offset:g} + {self.scale:g} · {self.state}[{self.index}])"
