"""The damping command: what leaves last for the motors, for the runner and every platform.

    last = LastSent(states)
    last.note()                                       # behind each `send`
    damping = Damping(states, robot, last, period)    # whatever had happened before
    repeated(lambda: (damping(), send()), period, DAMPING_TIME)

Stiffness falls to zero within `BLEND` and never rises, targets stay where they were sent last,
velocities and feed-forward are zero, damping stays. No safety block runs behind it, so that it
keeps the limits by itself.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from unicon_base.arrays import Float32
from unicon_core.bounds import DAMPING, STIFFNESS
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_core.states.groups import Copies, subset
from unicon_core.states.standard import COMMAND_STATES

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
