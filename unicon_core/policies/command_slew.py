"""CommandSlew: the velocity command as a policy sees it, no faster than its contract says."""

from __future__ import annotations

import numpy as np

from unicon_core.policies.contract import CommandSpec
from unicon_core.policies.prefixed import PackedStates

COMMAND = "velocity_command"
SLEWED = "slewed_command"


class CommandSlew:
    """Writes `slewed_command` each tick, before the gait clock and the policy.

    It begins at zero, and goes towards `velocity_command` by at most slew · period.

    Args:
        spec: of the contract.
        states: with both.
        period: of the policy in [s].
    """

    reads = (COMMAND,)
    writes = (SLEWED,)

    def __init__(self, spec: CommandSpec, states: PackedStates, period: float) -> None:
        rows = states.num_robots or 1
        self._command, self._seen = (states[n].reshape(rows, 3) for n in (COMMAND, SLEWED))
        self._step = np.array(spec.slew, np.float32) * np.float32(period)
        self._least, self._change = -self._step, np.zeros_like(self._seen)

    def __call__(self) -> None:
        """Follow the command for one control period."""
        change = self._change
        np.subtract(self._command, self._seen, out=change)
        np.maximum(change, self._least, out=change)  # both pass NaN on
        np.minimum(change, self._step, out=change)
        self._seen += change

    def reset(self) -> None:
        """Begin at zero."""
        self._seen[...] = 0.0
