"""Player: plays one trajectory, tick by tick, as commands that a `forward_command` follows.

Time is counted in ticks: after one that hung the path goes on where it was and does not jump.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from unicon_base.arrays import Array, Float64
from unicon_core.trajectory.accepted import Code, Limits, Points, Refusal, Spline, Start, accepted


@dataclass(frozen=True)
class Tolerances:
    """How far the joints may be off, each of shape (n,) in [rad], infinite where it is not asked.

    Attributes:
        path: on the way.
        goal: at the end.
        time: how long after its end the goal may be reached in [s]; 0 waits without an end.
    """

    path: Float64
    goal: Float64
    time: float = 0.0


@dataclass(frozen=True)
class Ending:
    """How a trajectory ended.

    Attributes:
        code: of the action's result.
        reason: one line, "" for success.
        canceled: whether somebody asked for it.
    """

    code: Code
    reason: str = ""
    canceled: bool = False


class Player:
    """Plays trajectories into the states of joint commands.

    Args:
        limits: of the robot.
        period: of a tick in [s].
        position: written: commanded positions in [rad], shape (n,), NaN where nothing is.
        velocity: written: commanded velocities in [rad/s], shape (n,).
        target: of the follower: commanded positions of the last tick in [rad], shape (n,).
        measured: read: positions in [rad], shape (n,).
        follows: how many ticks somebody has followed the commands, since he began to.

    Attributes:
        limits: as given.
        playing: a trajectory is on its way.
        time: since it began in [s].
        desired: position [rad] and velocity [rad/s] of this tick, each of shape (n,).
    """

    def __init__(
        self,
        limits: Limits,
        period: float,
        position: Array,
        velocity: Array,
        target: Callable[[], Array],
        measured: Array,
        follows: Callable[[], int],
    ) -> None:
        self.limits, self._period, self._follows = limits, period, follows
        self._position, self._velocity = position, velocity
        self._target, self._measured = target, measured
        self.playing, self.time = False, 0.0
        self.desired = (np.zeros(len(limits.joints)), np.zeros(len(limits.joints)))
        self._off = np.zeros(len(limits.joints))
        self._spline: Spline | None = None
        self._tolerances: Tolerances | None = None
        self._ended: Callable[[Ending], object] = bool
        self._ticks = 0
        self._count, self._followed = 0, False
        self._warm_up()

    def _warm_up(self) -> None:
        """Accept something: the first one takes 5 ms, the others less than 1."""
        rest = np.zeros(len(self.limits.joints))
        free = Limits(self.limits.joints, rest - 1.0, rest + 1.0, rest + 1.0)
        there = rest.tolist()
        points = Points(free.joints, [1.0, 2.0], [there, there], [[], there], [[], []])
        accepted(points, free, Start(rest, rest, rest))

    # -- between ticks --------------------------------------------------------------------------

    def play(
        self, points: Points, tolerances: Tolerances | None, ended: Callable[[Ending], object]
    ) -> None:
        """Begin a trajectory with the next tick, in the place of one that is on its way.

        Args:
            points: as they came.
            tolerances: None asks for none.
            ended: called once, with how it ended.

        Raises:
            Refusal: it is not one to be followed; the other goes on.
        """
        if not self._followed:
            raise Refusal("the flow does not follow joint commands now (forward_command)")
        target = self._target().astype(np.float64)
        velocity = self.desired[1].copy() if self.playing else np.zeros_like(target)
        spline = accepted(
            points, self.limits, Start(target, velocity, self._measured.astype(np.float64))
        )
        self._end(Ending(Code.INVALID_GOAL, "another trajectory came in its place"))
        self._spline, self._tolerances, self._ended = spline, tolerances, ended
        self._ticks, self.time, self.playing = 0, 0.0, True
        self.desired[0][...] = target

    def cancel(self, ending: Ending | None = None) -> None:
        """End what is played; the joints hold the targets that were sent last."""
        self._spline = None
        self._position[...] = self._velocity[...] = np.nan
        self._end(ending or Ending(Code.SUCCESSFUL, "canceled", canceled=True))

    # -- in ticks -------------------------------------------------------------------------------

    def __call__(self) -> None:
        """Write the commands of this tick."""
        count = self._follows()
        self._followed, self._count = count == self._count + 1, count
        if self._spline is None:
            return
        if not self._followed:
            reason = "nobody follows any more: the flow went on, or the run ends"
            self.cancel(Ending(Code.INVALID_GOAL, reason))
            return
        if self.playing and not self._on_the_way():
            return
        self._ticks += 1
        self.time = self._ticks * self._period
        self._spline.sample(self.time, *self.desired)
        self._position[...], self._velocity[...] = self.desired

    def _on_the_way(self) -> bool:
        """Compare what was measured with the last commands; False where it is over."""
        tolerances = self._tolerances
        assert self._spline is not None
        arrived = self.time >= self._spline.end
        if tolerances is None:
            if arrived:
                self._end(Ending(Code.SUCCESSFUL))
            return True
        np.subtract(self.desired[0], self._measured, out=self._off)
        np.abs(self._off, out=self._off)
        if not arrived:
            if (self._off > tolerances.path).any():
                self._violated(Code.PATH_TOLERANCE_VIOLATED, tolerances.path, "its path")
                return False
            return True
        if not (self._off > tolerances.goal).any():
            self._end(Ending(Code.SUCCESSFUL))
        elif 0.0 < tolerances.time < self.time - self._spline.end:
            self._violated(Code.GOAL_TOLERANCE_VIOLATED, tolerances.goal, "the goal")
            return False
        return True

    def _violated(self, code: Code, allowed: Float64, what: str) -> None:
        worst = int(np.argmax(self._off - allowed))
        reason = (
            f"{self.limits.joints[worst]} was {self._off[worst]:.3f} rad from {what} after "
            f"{self.time:.3g} s; allowed are {allowed[worst]:g}"
        )
        self.cancel(Ending(code, reason))

    def _end(self, ending: Ending) -> None:
        ended, self._ended = self._ended, bool
        self.playing = False
        ended(ending)
