"""Stops for joints that do not follow, for too much power, the live twin and missed ticks.

They are `tracking_stop`, `power_stop`, `twin_stop` and `overrun_stop`.
"""

from __future__ import annotations

import time
from collections import deque
from typing import Annotated

import numpy as np

from unicon_base.errors import Fault, WorkflowError
from unicon_base.schema.marks import Within, positive
from unicon_core.blocks.postures import Commands, ticks_of
from unicon_core.blocks.safety.limits import first_of
from unicon_core.bounds import Motion, Timeout
from unicon_core.flow.block import Reads, Stage
from unicon_core.platforms.kit.command import Servo
from unicon_core.robots import Robot
from unicon_core.workflow.autowire import BuildContext

POWER = 100_000.0
"""In [W]: a humanoid's battery gives some 5,000 at most."""
LOSS = 10.0
"""In [W/(N·m)²]: small motors have some 0.5, geared legs 0.01 to 0.1."""


class TrackingStop:
    """Stop where a joint with stiffness stays far from its target.

    Args:
        bound: between target and measured position in [rad]. A policy that uses soft joints as
            springs asks for 0.5 and more in a healthy run: look at yours before you give less.
        timeout: for which it is beyond without a break in [s]; at least one tick.
    """

    memory = ("_count", "_counting")

    stage = Stage.SAFETY
    awaits = True  # that the robot follows its commands

    def __init__(
        self,
        joint_pos: Reads,
        joint_pos_target: Reads,
        joint_stiffness: Reads,
        *,
        robot: Robot,
        period: float,
        bound: Motion = 1.0,
        timeout: Timeout = 0.5,
    ) -> None:
        self._pos = joint_pos
        self._target = joint_pos_target
        self._stiffness = joint_stiffness
        self._robot = robot
        self._ticks = ticks_of(timeout, period)
        self._bound = bound
        self._apart = np.zeros_like(joint_pos)
        self._count = np.zeros(joint_pos.shape, np.int64)
        self._counting = False

    def __call__(self) -> None:
        """Look.

        Raises:
            Fault: a joint does not follow, or a position is not a number.
        """
        apart = np.subtract(self._target, self._pos, out=self._apart).reshape(-1)
        if apart.dot(apart) <= self._bound**2:  # then none of them is beyond: the usual tick
            if self._counting:
                self.reset()
            return
        self._counting = True
        far = ~(np.abs(self._apart) <= self._bound)  # true for NaN too
        far &= ~(self._stiffness <= 0.0)
        self._count += 1
        self._count *= far
        late = self._count >= self._ticks
        if late.any():
            index, who = first_of(late, self._robot)
            raise Fault(
                f"{who} does not follow: {self._apart[index]:+.2f} rad from its target for "
                f"{self._count[index]} ticks, allowed are {self._bound:.2f}; is it blocked?"
            )

    def reset(self) -> None:
        """Count anew."""
        self._count[...] = 0
        self._counting = False


class PowerStop:
    """Stop where the servos would take more power than is allowed.

    tau = kp (q* - q) + kd (qd* - qd) + tau_ff, clipped to the effort limits, gives
    P = sum(max(tau qd, 0) + loss tau²) in [W]: what the joints do, and what their windings lose.

    Args:
        limit: of all joints together in [W].
        loss: of a winding in [W/(N·m)²]; 0 leaves only what the joints do.
        timeout: for which it is beyond without a break in [s]; at least one tick.
    """

    memory = ("_count",)

    stage = Stage.SAFETY

    def __init__(
        self,
        joint_pos: Reads,
        joint_vel: Reads,
        command: Commands,
        *,
        robot: Robot,
        period: float,
        limit: Annotated[float, positive(POWER, "W")],
        loss: Annotated[float, Within(0.0, LOSS, "W/(N·m)²")] = 0.0,
        timeout: Timeout = 0.1,
    ) -> None:
        self._measured = joint_pos, joint_vel
        self._servo = Servo(tuple(command), robot.effort_limit)
        self._ticks = ticks_of(timeout, period)
        self._limit = limit
        self._loss = loss
        self._work = np.zeros_like(joint_pos)
        self._count = 0

    def __call__(self) -> None:
        """Look.

        Raises:
            Fault: too much power for too long, or it is not a number.
        """
        torque = self._servo(*self._measured)
        work = np.multiply(torque, self._measured[1], out=self._work)
        np.maximum(work, 0.0, out=work)
        torque *= torque
        torque *= self._loss
        work += torque
        power = work.sum(axis=-1)
        most = float(power.max())
        if most <= self._limit:
            self._count = 0
            return
        self._count += 1
        if self._count >= self._ticks:
            who = f"robot {int(np.argmax(power))}: " if power.ndim else ""
            raise Fault(
                f"{who}the joints would take {most:.0f} W for {self._count} ticks, allowed are "
                f"{self._limit:.0f}"
            )

    def reset(self) -> None:
        """Count anew."""
        self._count = 0


class TwinStop:
    """Stop where the twin's flag stays raised; the workflow has a `twin:`, whose bound counts.

    It looks right behind the twin, which simulates behind `send`.

    Args:
        timeout: for which one joint's flag is raised without a break in [s]; at least one tick.
    """

    memory = ("_count",)

    stage = Stage.SAFETY
    awaits = True  # that the robot follows its commands
    patient = True

    def __init__(
        self,
        twin_flag: Reads,
        twin_gap: Reads,
        *,
        robot: Robot,
        period: float,
        timeout: Timeout = 0.2,
    ) -> None:
        self._flag = twin_flag
        self._gap = twin_gap
        self._robot = robot
        self._ticks = ticks_of(timeout, period)
        self._count = np.zeros(twin_flag.shape, np.int64)

    def __call__(self) -> None:
        """Look.

        Raises:
            Fault: a joint differs from its twin's.
        """
        self._count += 1
        self._count *= self._flag
        worst = int(self._count.argmax())
        if self._count[worst] >= self._ticks:
            worst = int(np.argmax(np.where(self._count >= self._ticks, self._gap, -1.0)))
            raise Fault(
                f"joint {self._robot.joint_names[worst]} is {self._gap[worst]:.2f} rad from its "
                f"twin for {self._count[worst]} ticks; is its motor weak, hot or blocked?"
            )

    def reset(self) -> None:
        """Count anew."""
        self._count[...] = 0


LONGEST = 60.0
"""Largest window in [s]."""

PAUSE_NS = 250_000_000
"""A longer time between two ticks is a pause that somebody asked for: a tick that hangs for so long
on a robot is a fault of its own (`pacing.hang`)."""


class OverrunStop:
    """Stop where too many ticks were missed within a time, by the machine's clock.

    A simulator has no deadlines where it runs at full speed, so there it never trips.

    Args:
        count: missed ticks that are too many; no more than the window has.
        window: in [s].

    Raises:
        WorkflowError: the window has fewer ticks.
    """

    memory = ()

    stage = Stage.SAFETY
    pure = False  # a dry run would be a tick too

    def __init__(
        self,
        context: BuildContext,
        *,
        count: Annotated[int, Within(1)] = 10,
        window: Annotated[float, positive(LONGEST, "s")] = 1.0,
    ) -> None:
        period = context.period
        platform = context.platform
        ticks = round(window / period)
        if count > ticks:
            raise WorkflowError(
                f"count is {count}; give 1 to {max(ticks, 1)}, the ticks of window: {window:g} s"
            )
        self._period_ns = period * 1e9
        self._window_ns = round(window * 1e9)
        self._paced = platform is None or not platform.facts.simulated
        self._late_ns = 1.5 * self._period_ns
        self._pause_ns = max(PAUSE_NS, 5.0 * self._period_ns)
        self._window = window
        self._missed: deque[int] = deque(maxlen=count)
        self._last = 0

    def __call__(self) -> None:
        """Look.

        Raises:
            Fault: too many ticks were missed.
        """
        now = time.perf_counter_ns()
        took = now - self._last
        self._last = now
        if took < self._late_ns or took > self._pause_ns or not self._paced:
            return
        missed = self._missed
        missed.extend([now] * (round(took / self._period_ns) - 1))
        if len(missed) == missed.maxlen and now - missed[0] <= self._window_ns:
            raise Fault(
                f"{len(missed)} ticks were missed within {self._window:g} s: the machine does not "
                "keep the rate; give it less to do, or a lower rate"
            )

    def reset(self) -> None:
        """Count anew."""
        self._missed.clear()
        self._last = 0
