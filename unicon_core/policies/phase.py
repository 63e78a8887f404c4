"""What runs before a policy: gait clock, slew of its velocity command, and derived states.

The gait clock writes phases of stepping as sine and cosine states, for policies that read them.

`gait_phase_sin` and `gait_phase_cos` have one element for each phase; `gait_phase` has all sines,
then all cosines. Sources that have another order take the first two, or an `index`.

From amazon-far/holosoma, `holosoma_inference/policies/locomotion.py` and `base.py`: before each
inference every phase φ advances by 2π · dt / period and is wrapped as fmod(φ + π, 2π) − π; two legs
start at 0 and π; while the command is zero (|v_xy| and |w_z| below 0.01) both stand at π, and when
it is no longer zero they start over from 0 and π.
From google-deepmind/mujoco_playground, joystick tasks: both stand at π, and go on from there.
From unitreerobotics/unitree_rl_lab, `mdp/observations.h`: one phase, no standing, [sin, cos].
From BoosterRobotics/booster_gym, T1: one phase, fmod(time · frequency, 1); while the command is
zero, sine and cosine are 0; the time runs on meanwhile in deployment, and stands in training.
From Improbable-AI/walk-these-ways, `go1_gym_deploy/envs/lcm_agent.py` (`phase.rate`): the frequency
in [Hz] is an element of the command, by which one phase advances, wrapped at 1. Policies that set
the rate themselves have it as an output, which `outputs` makes a state; it acts a tick later.
There (`phase.shift`) further elements put the feet ahead of that phase: by sums of three of them.

`base_rpy` are roll, pitch and yaw of `base_quat` in [rad]: turns about the fixed axes x, then y,
then z of the world, roll and yaw in (−π, π], pitch in [−π/2, π/2]. Its sources agree:
roboterax/humanoid-gym `scripts/sim2sim.py` (quaternion_to_euler_array; `envs/base/legged_robot.py`
puts Isaac Gym's angles from [0, 2π) there) and AgibotTech/agibot_x1_infer
`control_module/rotation_tools.h` (QuatToXyz).
"""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np

from unicon_base import PolicyError
from unicon_base.arrays import Float32, Float64
from unicon_core.policies.contract import CommandSpec, FilterSpec, PhaseSpec, PolicyContract
from unicon_core.policies.controller import PackedStates
from unicon_core.states import StateSpec


class GaitPhase:
    """Writes `gait_phase_sin`, `gait_phase_cos` and `gait_phase` each tick, before the policy.

    Args:
        spec: of the contract.
        states: with the phase states (`policy_states` declares them) and the command state.
        period: control period in [s].
        what: it is, for messages.

    Attributes:
        phase: the phases in [rad], shape (rows, k), float64.

    Raises:
        PolicyError: a state is not declared, or has another size.
    """

    memory = ("phase", "_clock", "_standing")

    name = "gait_phase"

    def __init__(
        self, spec: PhaseSpec, states: PackedStates, period: float, what: str = "gait phase"
    ) -> None:
        count = len(spec.offsets)
        rows = states.num_robots or 1
        sizes = {"gait_phase_sin": count, "gait_phase_cos": count, "gait_phase": 2 * count}
        for name, size in sizes.items():
            if name not in states or states[name].size != rows * size:
                raise PolicyError(
                    f"{what}: state {name!r} must be declared with {size} elements; "
                    "policy_states gives it"
                )
        self.reads: tuple[str, ...] = ()
        self.writes: tuple[str, ...] = tuple(sizes)
        self._step = 2.0 * np.pi * period / spec.period
        self._start = np.tile(np.array(spec.offsets, np.float64), (rows, 1))
        self.phase = self._start.copy()
        self._sin, self._cos, self._both = (
            states[name].reshape(rows, size) for name, size in sizes.items()
        )
        self._stand = spec.stand
        self._below = spec.stand_below
        usual = {"freeze": "stand", "zero": "clock"}.get(str(spec.stand), "offsets")
        self._resume = spec.resume or usual
        # The clock that runs on while the phases stand; the phases themselves where none does.
        runs_on = spec.stand is not None and self._resume == "clock"
        self._clock = self.phase.copy() if runs_on else self.phase
        self._standing = np.zeros(rows, bool)
        self._rate, self._shift = rate, shift = spec.rate, spec.shift
        if rate is not None:
            self._rates = self._view(states, what, "rate", rate.state, rate.index)[
                :, rate.index, None
            ]
        if shift is not None:
            self._used = used = sorted({place for places in shift.index for place in places})
            self._shifts = self._view(states, what, "shift", shift.state, max(used, default=0))
            self._sums = np.zeros((len(used), count))
            for i, places in enumerate(shift.index):
                for place in places:
                    self._sums[used.index(place), i] += 2.0 * np.pi
        if spec.stand is not None:
            if spec.command not in states or states[spec.command].size != rows * 3:
                raise PolicyError(
                    f"{what}: it stands still while state {spec.command!r} (vx, vy, wz) is "
                    "zero, and there is no such state of 3 elements; correct phase.command"
                )
            self.reads += (spec.command,)
            self._command = states[spec.command].reshape(rows, 3)

    def _view(self, states: PackedStates, what: str, key: str, name: str, highest: int) -> Float32:
        rows = len(self.phase)
        if name not in states or states[name].size <= highest * rows:
            raise PolicyError(
                f"{what}: its {key} takes element {highest} of state {name!r}, which is not there; "
                f"correct phase.{key}"
            )
        self.reads += (name,)
        return states[name].reshape(rows, -1)

    @property
    def begins(self) -> bool:
        """Whether the first phase has just passed its offset, or does not go towards it."""
        since = float((self.phase[0, 0] - self._start[0, 0]) % (2.0 * np.pi))
        step = float(np.ravel(self._advance())[0])
        return since < step or step <= 0.0 or bool(self._standing[0])

    def reset(self) -> None:
        """Start all phases at their offsets."""
        self.phase[...] = self._clock[...] = self._start
        self._standing[...] = False

    def __call__(self) -> None:
        """Advance by one control period and write the states."""
        phase, clock = self.phase, self._clock
        before = None if self._stand is None else phase.copy()
        clock += self._advance() + np.pi
        np.fmod(clock, 2.0 * np.pi, out=clock)
        clock -= np.pi
        if before is not None:
            self._stand_still(before)
        count = phase.shape[1]
        if self._shift is not None:
            phase = phase + self._shifts[:, self._used] @ self._sums
        np.sin(phase, out=self._both[:, :count], casting="same_kind")
        np.cos(phase, out=self._both[:, count:], casting="same_kind")
        if self._stand == "zero":
            self._both[self._standing] = 0.0
        self._sin[...] = self._both[:, :count]
        self._cos[...] = self._both[:, count:]

    def _advance(self) -> float | Float64:
        """Return how far the phases go in a tick in [rad], shape (rows, 1) where a state says."""
        if self._rate is None:
            return self._step
        step: Float64 = self._rate.offset + self._rate.scale * self._rates.astype(np.float64)
        return self._step * step

    def _stand_still(self, before: Float64) -> None:
        """Put the phases of robots without a command where they stand."""
        phase, command = self.phase, self._command
        still = (np.hypot(command[:, 0], command[:, 1]) < self._below) & (
            np.abs(command[:, 2]) < self._below
        )
        phase[...] = self._clock
        again = self._standing & ~still
        if self._resume == "offsets" and again.any():
            phase[again] = self._start[again]
        if still.any():
            phase[still] = before[still] if isinstance(self._stand, str) else self._stand
        self._standing[...] = still


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


def make_filter(spec: FilterSpec, shape: tuple[int, ...], period: float) -> Filter:
    """Return a filter.

    Args:
        spec: of the contract.
        shape: of a sample.
        period: of the policy in [s].
    """
    if spec.moving_average is not None:
        return _Mean(spec.moving_average, shape, spec.start == "zeros")
    alpha = spec.alpha
    if alpha is None:
        alpha = -math.expm1(-2.0 * math.pi * (spec.low_pass or 0.0) * period)
    return _LowPass(alpha, shape, spec.start == "zeros")


class _LowPass:
    """A first-order low pass."""

    memory = ("_kept", "_fresh")

    def __init__(self, alpha: float, shape: tuple[int, ...], zeros: bool) -> None:
        self._new, self._old, self._zeros = np.float32(alpha), np.float32(1.0 - alpha), zeros
        self._kept, self._now, self._rest = (np.zeros(shape, np.float32) for _ in range(3))
        self._fresh = True

    def __call__(self, sample: Float32) -> None:
        if self._fresh and not self._zeros:
            self._now[...] = sample
            return
        np.multiply(self._kept, self._old, out=self._rest)
        np.multiply(sample, self._new, out=self._now)
        np.add(self._now, self._rest, out=self._now)
        sample[...] = self._now

    def advance(self) -> None:
        self._kept[...] = self._now
        self._fresh = False

    def reset(self) -> None:
        self._kept[...] = 0.0
        self._fresh = True


class _Mean:
    """A moving average, over a ring whose last n samples always stand in one piece."""

    memory = ("_ring", "_head", "_fresh")

    def __init__(self, n: int, shape: tuple[int, ...], zeros: bool) -> None:
        self._n, self._zeros = n, zeros
        self._ring = np.zeros((2 * n, *shape), np.float32)
        self._sum = np.zeros(shape, np.float32)
        self._head, self._fresh = 0, True

    def __call__(self, sample: Float32) -> None:
        ring, head, n = self._ring, self._head, self._n
        if self._fresh:
            ring[...] = 0.0 if self._zeros else sample
        # Sample k is written twice, at k and k + n; the window then begins at k + 1.
        ring[head] = ring[head + n] = sample
        window = ring[head + 1 : head + 1 + n]
        self._sum[...] = window[0]
        for each in window[1:]:  # one after the other: `sum` would add in an order of its own
            self._sum += each
        np.divide(self._sum, np.float32(n), out=sample)

    def advance(self) -> None:
        self._head = (self._head + 1) % self._n
        self._fresh = False

    def reset(self) -> None:
        self._fresh = True


Filter: TypeAlias = _LowPass | _Mean
"""A filter of samples of one shape."""

RPY = "base_rpy"


def derived_states(contract: PolicyContract) -> dict[str, StateSpec]:
    """Return the states that are derived for a policy: `base_rpy` where it is read, constants."""
    states = {
        term.state: StateSpec(
            (len(term.value),), description="constant", initial=tuple(term.value.tolist())
        )
        for term in contract.terms
        if term.value is not None
    }
    if RPY in contract.seen:
        angles, text = ("roll", "pitch", "yaw"), "base orientation, turned about x, y, z"
        states[RPY] = StateSpec((3,), "float32", "rad", "world", angles, text)
    return states


class RollPitchYaw:
    """Writes `base_rpy` each tick, before the policy.

    Args:
        states: with it and `base_quat`.
    """

    memory = ()

    reads = ("base_quat",)
    writes = (RPY,)

    def __init__(self, states: PackedStates) -> None:
        self._quat, self._angles = states["base_quat"].reshape(-1, 4), states[RPY].reshape(-1, 3)

    def __call__(self) -> None:
        """Write the angles of all robots."""
        self._angles[...] = [
            (
                math.atan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)),
                math.asin(max(min(2.0 * (w * y - z * x), 1.0), -1.0)),
                math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)),
            )
            for w, x, y, z in self._quat.tolist()
        ]
