"""Block `excite`: moves joints about a pose by a known signal, to find out how they respond.

flow: {chain: [pose, {excite: {signal: chirp, joints: ["*_calf_joint"], frequency: [0.2, 4]}}]}
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache, partial
from typing import Annotated, Any, Literal

import numpy as np

from unicon_base.arrays import Float32, Float64
from unicon_base.errors import WorkflowError
from unicon_base.schema.marks import NotEmpty, Within, positive
from unicon_core.blocks.postures import Counting, JointCommand, robot_gains, ticks_of
from unicon_core.bounds import (
    DURATION,
    POSE_DURATION,
    POSE_SPEED,
    POSITION,
    DampingScale,
    Motion,
    Seconds,
    StiffnessScale,
    within,
)
from unicon_core.robots import Robot
from unicon_core.robots.load import joints_like, named_pose

Signal = Literal["sine", "chirp", "square", "triangle", "random"]

FREQUENCY = 100.0
"""In [Hz]: no leg's joint follows a tenth of it."""


class Excite(Counting):
    """Move position targets about a pose: target = pose + envelope · amplitude · signal.

    It goes to the pose first, within `fade`; the signal is faded in, and out before it is done.
    Pose and amplitude together stay within the joint limits, and the signal's slope within the
    speed limits: what does not is refused when the workflow is built.

    Args:
        signal: `sine`, `triangle`, `square` (it jumps), `chirp` (a sine whose frequency goes from
            the first to the second, linearly), or `random` (each joint by itself: a new value
            `frequency` times a second, smooth between them).
        joints: names and patterns of those that move; the others hold the pose.
        amplitude: in [rad] ([m] for sliding joints), or patterns to amplitudes.
        frequency: in [Hz]; two of them for a chirp.
        duration: of the signal in [s], each joint's with `in_turn`.
        fade: in [s], at most half of the duration.
        in_turn: one joint after the other, in the robot's order, instead of all together.
        around: the pose, as for `pose`; joints that it does not name stand.
        seed: of `random`.
        stiffness_scale: factor on the robot file's stiffness.
        damping_scale: factor on the robot file's damping.
    """

    memory = ("_start", "_way", "_approach")

    def __init__(
        self,
        command: JointCommand,
        *,
        robot: Robot,
        period: float,
        signal: Signal = "chirp",
        joints: Annotated[Sequence[str], NotEmpty] = ("*",),
        amplitude: Motion | Mapping[str, Motion] = 0.1,
        frequency: float | Annotated[Sequence[float], NotEmpty] = 1.0,
        duration: Annotated[float, positive(DURATION, "s")] = 10.0,
        fade: Seconds = 1.0,
        in_turn: bool = False,
        around: str | Mapping[str, float] = "stand",
        seed: Annotated[int, Within(0)] = 0,
        stiffness_scale: StiffnessScale = 1.0,
        damping_scale: DampingScale = 1.0,
    ) -> None:
        within(fade, "fade", "s", duration / 2, POSE_DURATION, above=False)
        sweep = _sweep(signal, frequency, period)
        centre, said = named_pose(around, robot, "block 'excite'")
        self._centre = np.where(said > 0.0, centre, np.nan_to_num(robot.default_joint_pos))
        sizes = _amplitudes(robot, joints, amplitude)
        _check(robot, signal, self._centre.astype(np.float32), sizes, max(sweep))
        self._amplitudes = np.diag(sizes)[sizes > 0.0] if in_turn else sizes[None]
        self._ticks = ticks_of(duration, period)
        self._fade = ticks_of(fade, period)
        self.gains = robot_gains(robot, "excite", stiffness_scale, damping_scale)
        self._wave = _wave(signal, sweep, self._ticks, period, (seed, robot.num_joints))
        self._command = command
        self._approach = self._fade
        self._ticks_per_rad = 0.5 * math.pi / (POSE_SPEED * period)
        self._start, self._way = (np.zeros_like(command.joint_pos_target) for _ in range(2))

    def __call__(self) -> bool:
        command = self._command
        target = self._command.joint_pos_target
        if self._tick == 0:
            command.entry(self._start)
            np.subtract(self._centre, self._start, out=self._way)
            farthest = float(np.abs(self._way).max())
            if math.isfinite(farthest):
                self._approach = max(self._fade, math.ceil(farthest * self._ticks_per_rad))
        self._tick += 1
        turn, tick = divmod(self._tick - self._approach, self._ticks)
        turns = len(self._amplitudes)
        if turn < 0 and self._tick < self._approach:
            np.multiply(self._way, _eased(self._tick / self._approach), out=target)
            target += self._start
        elif turn >= turns:
            target[...] = self._centre
        else:
            envelope = _eased(min(tick, self._ticks - tick, self._fade) / self._fade)
            target[...] = self._centre + self._amplitudes[turn] * (envelope * self._wave(tick))
        command.joint_vel_target[...] = 0.0
        command.joint_effort_ff[...] = 0.0
        command.joint_stiffness[...], command.joint_damping[...] = self.gains
        return turn >= turns


def _sweep(signal: str, frequency: float | Sequence[float], period: float) -> tuple[float, float]:
    """Return the first and the last frequency in [Hz]."""
    several = isinstance(frequency, Sequence)
    given: Sequence[float] = frequency if isinstance(frequency, Sequence) else [frequency]
    if several and (signal != "chirp" or len(given) != 2):
        wanted = "one, or [first, last]" if signal == "chirp" else "one"
        raise WorkflowError(f"frequency of a {signal} is {frequency!r}; give {wanted} in [Hz]")
    highest = min(FREQUENCY, 0.25 / period)  # four ticks show a wave
    first, last = (within(f, "frequency", "Hz", highest) for f in (given[0], given[-1]))
    return (0.1 * last, last) if signal == "chirp" and not several else (first, last)


def _amplitudes(
    robot: Robot, joints: Sequence[str], amplitude: float | Mapping[str, float]
) -> Float32:
    moving = sorted({i for pattern in joints for i in joints_like(pattern, robot)})
    sizes = np.full(robot.num_joints, np.nan)
    for pattern, size in (
        amplitude if isinstance(amplitude, Mapping) else {"*": amplitude}
    ).items():
        sizes[joints_like(pattern, robot)] = size
    without = [robot.joint_names[i] for i in moving if math.isnan(sizes[i])]
    if without:
        raise WorkflowError(f"amplitude says nothing of joint {without[0]}; add it, or a pattern")
    chosen = np.zeros(robot.num_joints, np.float32)
    chosen[moving] = sizes[moving]
    return chosen


def _check(robot: Robot, signal: str, centre: Float32, sizes: Float32, frequency: float) -> None:
    """Refuse what would leave the limits of position or speed."""
    for i in np.flatnonzero(sizes):
        name = robot.joint_names[i]
        size = float(sizes[i])
        room = float(np.nanmin((robot.upper[i] - centre[i], centre[i] - robot.lower[i], POSITION)))
        if size > room + 1e-6:
            raise WorkflowError(
                f"amplitude {size:g} rad about {centre[i]:g} rad is beyond the limits of joint "
                f"{name}; give at most {max(room, 0.0):.3g}, or another pose (around)"
            )
        speed = size * frequency * _SIGNALS[signal][0]
        limit = float(robot.velocity_limit[i])
        if speed > limit:  # false for an unknown limit
            raise WorkflowError(
                f"a {signal} of {size:g} rad at {frequency:g} Hz asks joint {name} for "
                f"{speed:.3g} rad/s, its limit is {limit:g}; lower amplitude or frequency"
            )


def _wave(
    signal: str, sweep: tuple[float, float], ticks: int, period: float, drawn: tuple[int, int]
) -> Callable[[int], Any]:
    """Return a signal of amplitude 1: of a tick of the signal a number, or one per joint.

    Args:
        signal: one of `Signal`.
        sweep: the first and the last frequency in [Hz].
        ticks: of the signal.
        period: of a tick in [s].
        drawn: seed, and number of joints, of `random`.
    """
    first, last = sweep
    half_slope = 0.5 * (last - first) / (ticks * period)
    shape = _SIGNALS[signal][1] or partial(_random, *drawn)

    def wave(tick: int) -> Any:
        time = tick * period
        return shape(time * (first + half_slope * time))

    return wave


def _random(seed: int, count: int, cycles: float) -> Float64:
    knot = math.floor(cycles)
    before, after = (_drawn(seed, k, count) for k in (knot, knot + 1))
    return before + _eased(cycles - knot) * (after - before)


def _sine(cycles: float) -> float:
    return math.sin(2.0 * math.pi * cycles)


# Signal to its largest |slope| at amplitude 1 and 1 Hz in [1/s], of a square's steps none to check,
# and to what makes it of cycles: None for `random`, which is of each joint by itself.
_SIGNALS: dict[str, tuple[float, Callable[[float], Any] | None]] = {
    "sine": (2 * math.pi, _sine),
    "chirp": (2 * math.pi, _sine),
    "triangle": (4.0, lambda cycles: 4.0 * abs((cycles - 0.25) % 1.0 - 0.5) - 1.0),
    "square": (0.0, lambda cycles: 1.0 if cycles % 1.0 < 0.5 else -1.0),
    "random": (math.pi, None),
}


@lru_cache(maxsize=8)
def _drawn(seed: int, knot: int, count: int) -> Float64:
    """Return the values of a knot, the same whenever they are asked for."""
    return np.random.default_rng((seed, knot)).uniform(-1.0, 1.0, count)


def _eased(share: float) -> float:
    """Half a cosine from 0 to 1."""
    return 0.5 - 0.5 * math.cos(math.pi * share)
