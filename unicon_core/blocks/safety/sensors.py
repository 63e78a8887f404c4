"""Block `joint_sensor_stop`: positions and velocities of the joints have to agree."""

from __future__ import annotations

import numpy as np

from unicon_base.errors import Fault
from unicon_core.blocks.postures import single
from unicon_core.bounds import Motion
from unicon_core.flow.block import Reads, Stage
from unicon_core.robots import Robot

NEVER = -(1 << 62)


class JointSensorStop:
    """Stop where joints move otherwise than their velocities say.

    Between two frames a joint has to move by a distance that lies between dt times the lower and
    dt times the higher of its two velocities. What lies outside is what it is off by:

    - in one frame by half of a bound, and by all of it from dt times their mean. The bound is
      `step` + ACCELERATION dt^2 / 4 + JITTER |v|: the second is the largest error of the mean where
      the velocity changes by ACCELERATION and comes back within dt, the third what stamps may be
      wrong by. Walks of all shipped policies reach 0.11 and 0.14 rad at 50 Hz, where it is 0.2.
    - added up for each joint, with a decay within `DRAWN`, and over all joints as a Euclidean norm,
      by at most `drift`. Walks of all shipped policies with the noise of their training (up to
      1.5 rad/s and 0.012 rad) and pushes of 0.5 m/s reach 0.13 rad with 12 joints and 0.22 with 29.
      Of a frame that comes behind a longer time than a tick's, ACCELERATION (dt^2 - T^2) / 8 is
      left out: how far a joint may have swung out of the interval and back. Where the frame was
      only stamped late, the next frames are off by as much in the other direction, and that is
      left out, too.

    Velocities that have the same bits, all of them, for `FROZEN` while the joints moved by `MOTION`
    are a fault, too.

    Joints that take positions, and those that turn without end, such as wheels, are not looked at.

    Args:
        joint_pos: in [rad], shape (n,).
        joint_vel: in [rad/s], shape (n,).
        stamp_ns: source time of the data in [ns], shape ().
        step: in [rad].
        drift: in [rad]; None for 0.075 sqrt(n), at least 0.3.

    Raises:
        WorkflowError: the states are of a batch.
    """

    memory = ("_at", "_doubtful", "_last", "_was", "_start", "_same", "_sum", "_excused", "_late")

    stage = Stage.SAFETY
    patient = True  # one frame more is no harm

    DRAWN = 0.2
    """Time in which what has been added up decays, [s]."""

    ACCELERATION = 1000.0
    """Of a joint whose foot hits the ground, [rad/s^2]."""

    JITTER = 0.004
    """Between a stamp and the moment of the measurement, [s]."""

    # In [s], and of all joints together in [rad].
    FROZEN = 0.2
    MOTION = 0.3

    LONGEST = 0.05
    """Between two frames, [s], or 2.5 ticks: of a longer pause nobody knows how the joints moved in
    it, nor when its first frame was measured: a burst that a network held back begins with an old
    one. Neither is judged."""

    HELD_BACK = 1.0
    """So long may a network do that, [s]."""

    def __init__(
        self,
        joint_pos: Reads,
        joint_vel: Reads,
        stamp_ns: Reads,
        *,
        robot: Robot,
        period: float,
        step: Motion = 0.1,
        drift: Motion | None = None,
    ) -> None:
        single(joint_pos)
        pos, vel = self._pos, self._vel = joint_pos, joint_vel
        self._stamp = stamp_ns
        self._names = robot.joint_names
        self._drift = max(0.075 * len(pos) ** 0.5, 0.3) if drift is None else drift
        self._step = step
        self._at = NEVER
        self._period2 = (1.1 * period) ** 2  # frames come a little apart
        self._longest = max(self.LONGEST, 2.5 * period)
        self._doubtful = False
        self.looked_at = (~robot.endless & ~robot.by_position).astype(np.float32)
        self._last = np.full_like(pos, np.nan)
        self._was = np.zeros_like(vel)
        self._start = np.zeros_like(pos)
        self._same = 0.0
        self._low = np.zeros_like(pos)
        self._high = np.zeros_like(pos)
        self._moved, self._off, self._sum = (np.zeros_like(pos) for _ in range(3))
        self._excused, self._late = np.zeros_like(pos), False  # of late frames, until it comes back

    def __call__(self) -> None:
        """Look.

        Raises:
            Fault: positions and velocities contradict each other.
        """
        pos = self._pos
        vel = self._vel
        last = self._last
        was = self._was
        if pos.tobytes() == last.tobytes():
            return  # no frame, or nothing moves: what comes next is judged from there
        now = int(self._stamp)
        dt = (now - self._at) * 1e-9
        self._at = now
        low = self._low
        high = self._high
        moved = self._moved
        off = self._off
        total = self._sum
        np.subtract(pos, last, out=moved)
        np.minimum(vel, was, out=low)
        np.maximum(vel, was, out=high)
        frozen = vel.tobytes() == was.tobytes()
        last[...], was[...] = pos, vel
        paused = not 0.0 < dt <= self._longest
        if paused or self._doubtful:
            total[...], self._start[...], self._same = 0.0, pos, 0.0
            self._excused[...], self._late = 0.0, False
            self._doubtful = paused and 0.0 < dt < self.HELD_BACK
            return
        if not frozen:
            self._start[...], self._same = pos, 0.0
        else:
            self._same += dt
            if self._same >= self.FROZEN:
                self._look_at_motion()
        low *= dt
        high *= dt
        np.maximum(moved, low, out=off)
        np.minimum(off, high, out=off)
        np.subtract(moved, off, out=off)
        off *= self.looked_at
        slack = 0.125 * self.ACCELERATION * (dt * dt - self._period2)
        if slack > 0.0 or self._late:
            self._excuse(slack, dt)
        total *= max(1.0 - dt / self.DRAWN, 0.0)
        total += off
        step = self._step + 0.25 * self.ACCELERATION * dt * dt
        if not (off.dot(off) <= 0.25 * step * step and total.dot(total) <= self._drift**2):
            self._look(dt, step)

    def _excuse(self, slack: float, dt: float) -> None:
        off = self._off
        excused = self._excused
        excused *= max(1.0 - dt / self.DRAWN, 0.0)
        back = np.clip(-excused, np.minimum(off, 0.0), np.maximum(off, 0.0))
        off -= back
        excused += back
        if slack > 0.0:  # a frame was late or lost
            left_out = np.clip(off, -slack, slack)
            off -= left_out
            excused += left_out
        self._late = bool(np.abs(excused).max() > 1e-3)

    def _look_at_motion(self) -> None:
        moved = float((np.abs(self._pos - self._start) * self.looked_at).sum())
        if moved > self.MOTION:
            raise Fault(
                f"joint velocities stand still: the same bits for {self._same:.2f} s while the "
                f"joints moved by {moved:.2f} rad; are they measured?"
            )

    def _look(self, dt: float, step: float) -> None:
        off = self._off
        total = self._sum
        if not np.isfinite(total).all():  # what is NaN is `range_stop`'s
            total[...] = self._excused[...] = 0.0
            return
        slip = self.JITTER * np.maximum(np.abs(self._low), np.abs(self._high)) / dt
        mean = np.abs(self._moved - 0.5 * (self._low + self._high)) * self.looked_at
        beyond = np.minimum(2.0 * np.abs(off), mean) - slip
        k = int(beyond.argmax())
        if beyond[k] > step:
            raise Fault(
                f"joint {self._names[k]} went from {self._pos[k] - self._moved[k]:.3f} to "
                f"{self._pos[k]:.3f} rad in {dt * 1e3:.0f} ms, and its velocity was "
                f"{self._low[k] / dt:.2f} to {self._high[k] / dt:.2f} rad/s; is its encoder sound?"
            )
        sum_of = float(np.linalg.norm(total))
        if sum_of > self._drift + float(np.linalg.norm(slip)):
            k = int(np.abs(total).argmax())
            raise Fault(
                f"joints move otherwise than their velocities say: by {sum_of:.2f} rad together "
                f"within {self.DRAWN} s, most {self._names[k]}, by {total[k]:.2f} rad at "
                f"{self._vel[k]:.2f} rad/s; are velocities frozen, of another sign or scale?"
            )

    def reset(self) -> None:
        """Look anew."""
        self._last[...] = np.nan
        self._sum[...] = self._excused[...] = 0.0
