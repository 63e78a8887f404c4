"""The gait clock: phases of stepping as sine and cosine states, for policies that read them.

From amazon-far/holosoma, `holosoma_inference/policies/locomotion.py` and `base.py`: before each
inference every phase φ advances by 2π · dt / period and is wrapped as fmod(φ + π, 2π) − π; two legs
start at 0 and π; while the command is zero (|v_xy| and |w_z| below 0.01) both stand at π, and when
it is no longer zero they start over from 0 and π.
From unitreerobotics/unitree_rl_lab, `mdp/observations.h`: one phase, no standing, [sin, cos].
"""

from __future__ import annotations

import numpy as np

from unicon_core.errors import PolicyError
from unicon_core.policies.contract import PhaseSpec
from unicon_core.policies.prefixed import PackedStates

__all__ = ["GaitPhase"]


class GaitPhase:
    """Writes `gait_phase_sin`, `gait_phase_cos` and `gait_phase` each tick, before the policy.

    Args:
        spec: of the contract.
        states: with the phase states (`policy_states` declares them) and the command state.
        period: control period in [s].

    Attributes:
        phase: the phases in [rad], shape (rows, k), float64.

    Raises:
        PolicyError: a state is not declared, or has another size.
    """

    name = "gait_phase"

    def __init__(self, spec: PhaseSpec, states: PackedStates, period: float) -> None:
        count = len(spec.offsets)
        rows = states.num_robots or 1
        sizes = {"gait_phase_sin": count, "gait_phase_cos": count, "gait_phase": 2 * count}
        for name, size in sizes.items():
            if name not in states or states[name].size != rows * size:
                raise PolicyError(
                    f"gait phase: state {name!r} must be declared with {size} elements; "
                    "policy_states gives it"
                )
        self.reads: tuple[str, ...] = ()
        self.writes: tuple[str, ...] = tuple(sizes)
        self._step = 2.0 * np.pi * period / spec.period
        self._start = np.tile(np.array(spec.offsets, dtype=np.float64), (rows, 1))
        self.phase = self._start.copy()
        self._sin, self._cos, self._both = (
            states[name].reshape(rows, size) for name, size in sizes.items()
        )
        self._stand = spec.stand
        self._below = spec.stand_below
        self._standing = np.zeros(rows, bool)
        if spec.stand is not None:
            if spec.command not in states or states[spec.command].size != rows * 3:
                raise PolicyError(
                    f"gait phase: it stands still while state {spec.command!r} (vx, vy, wz) is "
                    "zero, and there is no such state of 3 elements; correct phase.command"
                )
            self.reads = (spec.command,)
            self._command = states[spec.command].reshape(rows, 3)

    def reset(self) -> None:
        """Start all phases at their offsets."""
        self.phase[...] = self._start
        self._standing[...] = False

    def __call__(self) -> None:
        """Advance by one control period and write the states."""
        phase = self.phase
        phase += self._step + np.pi
        np.fmod(phase, 2.0 * np.pi, out=phase)
        phase -= np.pi
        if self._stand is not None:
            command = self._command
            still = (np.hypot(command[:, 0], command[:, 1]) < self._below) & (
                np.abs(command[:, 2]) < self._below
            )
            again = self._standing & ~still
            if again.any():
                phase[again] = self._start[again]
            if still.any():
                phase[still] = self._stand
            self._standing[...] = still
        count = phase.shape[1]
        np.sin(phase, out=self._both[:, :count], casting="same_kind")
        np.cos(phase, out=self._both[:, count:], casting="same_kind")
        self._sin[...] = self._both[:, :count]
        self._cos[...] = self._both[:, count:]
