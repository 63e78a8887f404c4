"""Commands checked for finite numbers, servos in NumPy, late joints, physics steps of a tick.

And the damping command: what leaves last for the motors, for the runner and every platform.

    last = LastSent(states)
    last.note()                                       # behind each `send`
    damping = Damping(states, robot, last, period)    # whatever had happened before
    repeated(lambda: (damping(), send()), period, DAMPING_TIME)

Stiffness falls to zero within `BLEND` and never rises, targets stay where they were sent last,
velocities and feed-forward are zero, damping stays. No safety block runs behind it, so that it
keeps the limits by itself.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from fractions import Fraction
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, DTypeLike

from unicon_base import Fault, ModelError
from unicon_base.arrays import Array, Float32, Float64, Int64
from unicon_core.bounds import DAMPING, STIFFNESS
from unicon_core.robots import Robot
from unicon_core.robots.load import JointPhysics
from unicon_core.states import States
from unicon_core.states.groups import Copies, subset
from unicon_core.states.standard import COMMAND_STATES
from unicon_core.states.states import flat, stacked


class FiniteCheck:
    """Raises a fault where a command is NaN or infinite; it names state and joint.

    Args:
        commands: name to array of shape (..., n).
        joint_names: of the last axis.
        who: in front of the message, for a robot that is one of several.
    """

    def __init__(
        self, commands: Mapping[str, Array], joint_names: Sequence[str], who: str = ""
    ) -> None:
        self._commands = dict(commands)
        self._names = joint_names
        self._said = who
        self._flat = flat(list(commands.values()))

    def __call__(self) -> None:
        for values in self._flat:
            # A product with itself is finite only if every element is: 0.3 µs against 1.5 µs.
            if not values.dot(values) < math.inf:
                self._raise()

    def _raise(self) -> None:
        for state, view in self._commands.items():
            wrong = np.argwhere(~np.isfinite(view))
            if len(wrong):  # else a huge value overflowed the product
                index = tuple(map(int, wrong[0]))
                who = f"robot {index[0]}, " if len(index) > 1 else self._said
                raise Fault(f"{who}{state} of joint {self._names[index[-1]]} is {view[index]}")


class Command:
    """A copy of the command states, taken once a tick, all of it finite.

    Attributes:
        rows: in the order of `COMMAND_STATES`: q*, qd*, tau_ff, kp, kd in [rad], [rad/s], [N·m],
            [N·m/rad], [N·m·s/rad], shape (5, ..., n).

    Args:
        views: holds the command states by name, each of shape (..., n).
        joint_names: of the last axis.
        who: in front of a fault's message.
        dtype: of the copy.
    """

    def __init__(
        self,
        views: Mapping[str, Array] | States,
        joint_names: Sequence[str],
        who: str = "",
        dtype: DTypeLike = np.float64,
    ) -> None:
        sources = [views[name] for name in COMMAND_STATES]
        self.rows: Array = np.zeros((len(sources), *sources[0].shape), dtype)
        whole = stacked(sources)
        self._copies = list(zip(self.rows, sources)) if whole is None else [(self.rows, whole)]
        self._flat = self.rows.reshape(-1)
        self._check = FiniteCheck(dict(zip(COMMAND_STATES, self.rows)), joint_names, who)

    def take(self) -> None:
        """Copy the command states.

        Raises:
            Fault: a command is not finite.
        """
        for row, source in self._copies:
            row[...] = source
        if not self._flat.dot(self._flat) < math.inf:  # false for NaN too: one call finds both
            self._check()


class Servo:
    """The PD equation that every motor follows, at each of its own steps:

        tau = kp (q* - q) + kd (qd* - qd) + tau_ff,   clipped to the effort limits.

    Args:
        rows: q*, qd*, tau_ff, kp, kd as of `Command.rows`, shape (5, ..., n), or five arrays of
            shape (..., n); read at each call.
        effort_limit: largest torque of each joint in [N·m], NaN for none, shape (n,).
        lower: smallest torque in [N·m], shape (n,); the opposite of the largest if None.

    Attributes:
        torque: of the last call in [N·m], shape (..., n).
    """

    def __init__(
        self, rows: Array | Sequence[Array], effort_limit: ArrayLike, lower: ArrayLike | None = None
    ) -> None:
        self._rows = rows
        self._limit = np.nan_to_num(np.asarray(effort_limit, rows[0].dtype), nan=np.inf)
        self._lower = -self._limit if lower is None else np.asarray(lower, rows[0].dtype)
        self.torque: Array = np.zeros_like(rows[0])
        self._part = np.zeros_like(rows[0])

    def __call__(self, pos: Array, vel: Array) -> Array:
        """Return `torque` at measured positions [rad] and velocities [rad/s], shape (..., n)."""
        target, velocity, feed_forward, stiffness, damping = self._rows
        torque = self.torque
        np.subtract(target, pos, out=torque)
        torque *= stiffness
        np.subtract(velocity, vel, out=self._part)
        self._part *= damping
        self._part += feed_forward
        torque += self._part
        np.clip(torque, self._lower, self._limit, out=torque)
        return torque


def strength_of(physics: JointPhysics) -> Float64 | None:
    """Return the factor on each motor's torque, shape (n,); None where all are 1."""
    strength = np.where(np.isnan(physics.strength), 1.0, physics.strength)
    return None if (strength == 1.0).all() else strength


def delay_of(physics: JointPhysics, timestep: float) -> Int64 | None:
    """Return each joint's delay in physics steps, shape (n,); None where all are 0.

    Args:
        physics: says it in [s].
        timestep: of the physics in [s].
    """
    delay = np.rint(np.nan_to_num(physics.delay) / timestep).astype(np.int64)
    return delay if delay.any() else None


class JointDelay:
    """The command of each physics step where joints get theirs late, each by its own delay.

    Args:
        rows: the present command as of `Command.rows`, shape (5, ..., n); read at each call.
        delay: in physics steps, shape (n,).
        decimation: physics steps in a tick.
    """

    memory = ("_past", "_tick")

    def __init__(self, rows: Array, delay: Int64, decimation: int) -> None:
        self._rows = rows
        ticks, begin = np.divmod(delay, decimation)
        edges = sorted({0, decimation, *begin.tolist()})
        # In the steps before a joint's `begin` the command of one tick earlier still acts.
        self._parts = [(end - start, ticks + (start < begin)) for start, end in pairwise(edges)]
        self._past = np.zeros((int(ticks.max()) + 2, *rows.shape), rows.dtype)
        self._joints = np.arange(rows.shape[-1])
        self._order = (*range(1, rows.ndim), 0)
        self.reset()

    def __call__(self) -> Iterator[tuple[int, Array]]:
        """Take the present command; yield physics steps and the command that acts in them."""
        depth = len(self._past)
        if self._tick == 0:  # before the first command arrives the motors hold what it says
            self._past[...] = self._rows
        self._past[self._tick % depth] = self._rows
        for steps, ages in self._parts:
            late = self._past[(self._tick - ages) % depth, ..., self._joints]
            yield steps, late.transpose(self._order)
        self._tick += 1

    def reset(self) -> None:
        """Begin anew with the next command."""
        self._tick = 0


MOST_STEPS = 10_000
"""Of a tick: with more nothing seems to go on."""


def steps_in(period: float, timestep: float, model: object, platform: str) -> int:
    """Return how many physics steps a tick has.

    Args:
        period: of a tick in [s].
        timestep: of the physics in [s].
        model: its file, for the message.
        platform: its name, likewise.

    Raises:
        ModelError: it is not a whole number of them, or has too many.
    """
    if not timestep >= period / MOST_STEPS:  # true for NaN too
        raise ModelError(
            f"a physics step of {timestep:.6g} s is too short for a tick of {period:.6g} s (model "
            f"{model}); write platforms: {{{platform}: {{timestep: {period / MOST_STEPS:.6g}}}}}, "
            "or more"
        )
    ratio = period / timestep
    steps = round(ratio)
    if steps >= 1 and abs(ratio - steps) < 1e-6 * steps:
        return steps
    down = max(math.floor(ratio), 1)
    up = max(math.ceil(ratio), 1)
    first, *others = (f"{period / n:.10g}" for n in dict.fromkeys((down, up)))
    either = "".join(f" (or {each})" for each in others)
    periods = " or ".join(f"{n * timestep:.6g}" for n in dict.fromkeys((down, up)))
    raise ModelError(
        f"a tick of {period:.6g} s is not a whole number of physics steps of {timestep:.6g} s "
        f"(model {model}); write platforms: {{{platform}: {{timestep: {first}}}}}{either}, or "
        f"correct the period to {periods}"
    )


def tick_ns(timestep: float, steps: int) -> Fraction | int:
    """Return the duration of a tick in [ns], exactly: its multiples are rounded only once."""
    exact = Fraction(repr(timestep)) * 10**9 * steps
    return int(exact) if exact.denominator == 1 else exact


BLEND = 0.3
"""Stiffness is gone after this time, [s]: a step to zero lets a standing robot drop, and what has
gone wrong may hold on to its last target for so long and no longer."""

DAMPING_TIME = 0.5
"""How long the damping command is sent, [s]: without stiffness one message may be lost, and a run
that is asked to end shall be gone within a second."""

ABSURD = 1.0
"""A measured position that is further outside its limits is not a measurement, [rad] or [m]."""

ENDLESS = 1e3
"""Limit of joints whose limit is not known, [rad] or [m]: nothing is beyond it but nonsense."""

FASTEST = 0.002
"""Shortest time between two repetitions, [s]."""


class LastSent:
    """The command states as they left last.

    Args:
        states: which have all command states.

    Attributes:
        any: something has been sent.
        states: the command states of then.
    """

    memory = ("any", "_buffer")

    def __init__(self, states: States) -> None:
        self.any = False
        self.states = States(subset(states.layout, COMMAND_STATES))
        self._buffer = self.states.buffer
        self._copies = Copies(states, self.states.layout, self._buffer.data)

    def forget(self) -> None:
        """Be as before anything was sent."""
        self.any = False
        self.states.reset()

    def note(self) -> None:
        """Remember what was sent just now."""
        self._copies.pack()
        self.any = True

    @property
    def limp(self) -> bool:
        """Whether no joint had stiffness."""
        return not self.states["joint_stiffness"].any()


class Damping:
    """Writes the damping command of the next tick into the command states, all of it finite.

    Targets are those that were sent last, within the robot's limits; of a robot that was sent
    nothing the measured ones. They matter where a motor looks at nothing else: a robot that takes
    positions only keeps the last.

    Args:
        states: whose command states are written.
        robot: says limits and damping; what it does not say is not a limit, and what was sent.
        last: what was sent last.
        period: of a tick in [s].
    """

    def __init__(self, states: States, robot: Robot, last: LastSent, period: float) -> None:
        self._states = states
        lower, upper = robot.limits(ENDLESS)
        pose = np.nan_to_num(robot.default_joint_pos)
        if last.any:
            target = last.states["joint_pos_target"]
            good = np.isfinite(target)
        else:
            target = states["joint_pos"]
            good = (target >= lower - ABSURD) & (target <= upper + ABSURD)  # false for NaN
        self._target = np.clip(np.where(good, target, pose), lower, upper)
        self._stiffness = _bounded(last.states["joint_stiffness"], STIFFNESS)
        sent = _bounded(last.states["joint_damping"], DAMPING)
        self._damping = np.where(np.isfinite(robot.joint_damping), robot.joint_damping, sent)
        self._step = period / BLEND
        self._share = 1.0

    def __call__(self) -> None:
        self._share = max(self._share - self._step, 0.0)
        if self._share < 1e-9:
            self._share = 0.0
        states = self._states
        states["joint_pos_target"][...] = self._target
        states["joint_vel_target"][...] = 0.0
        states["joint_effort_ff"][...] = 0.0
        np.multiply(self._stiffness, np.float32(self._share), out=states["joint_stiffness"])
        states["joint_damping"][...] = self._damping


def _bounded(gain: Float32, most: float) -> Float32:
    return np.clip(np.nan_to_num(gain, posinf=0.0, neginf=0.0), 0.0, np.float32(most))


def repeated(send: Callable[[], object], period: float, duration: float = DAMPING_TIME) -> None:
    """Send a command again and again: at the tick's rate, once at least.

    Args:
        send: sends it; an error of it stops nothing.
        period: of a tick in [s].
        duration: in [s].

    Raises:
        Exception: what `send` raised last, after the time is over.
    """
    period = max(period, FASTEST)
    error: Exception | None = None
    due = time.monotonic()
    end = due + duration
    while True:
        try:
            send()
        except Exception as raised:
            error = raised
        due += period
        if due > end:
            break
        time.sleep(max(0.0, due - time.monotonic()))
    if error is not None:
        raise error
