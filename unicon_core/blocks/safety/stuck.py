"""Stops for sensors that stand still: `encoder_stop`, `imu_stop`.

A frozen sensor sends the same bytes; a real one never does for long, for it has noise. A simulation
without noise may, when nothing moves, so each detector waits for motion that the sensor would have
to see.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from unicon_core.blocks.joint_command import ticks_of
from unicon_core.bounds import POSITION, STALE, within
from unicon_core.errors import Fault, WorkflowError
from unicon_core.flow.block import Reads
from unicon_core.flow.stage import Stage
from unicon_core.robots import Robot

__all__ = ["EncoderStop", "ImuStop", "encoder_stop", "imu_stop"]

Float = NDArray[np.float32]


def encoder_stop(
    joint_pos: Reads,
    joint_pos_target: Reads,
    joint_stiffness: Reads,
    *,
    robot: Robot,
    period: float,
    timeout: float = 0.1,
    motion: float = 0.1,
) -> EncoderStop:
    """Stop where a joint's position has the same bits for some time though its target moves.

    Args:
        timeout: in [s] of ticks with the same bits.
        motion: by which the target has moved meanwhile, in [rad].
    """
    timeout = within(timeout, "timeout", "s", STALE, what="encoder_stop")
    motion = within(motion, "motion", "rad", POSITION, what="encoder_stop")
    ticks = ticks_of(timeout, period, "timeout") or 1
    return EncoderStop(
        joint_pos, joint_pos_target, joint_stiffness, robot.joint_names, max(ticks, 2), motion
    )


class EncoderStop:
    """The tick of `encoder_stop`."""

    stage = Stage.SAFETY

    def __init__(
        self,
        pos: Float,
        target: Float,
        stiffness: Float,
        joint_names: tuple[str, ...],
        ticks: int,
        motion: float,
    ) -> None:
        self._pos, self._target, self._stiffness = pos, target, stiffness
        self._names, self._ticks, self._motion = joint_names, ticks, motion
        self._last, self._reference = np.full_like(pos, np.nan), np.zeros_like(pos)
        self._moves = np.ones(pos.shape, np.bool_)
        self._same = np.zeros(pos.shape, np.int32)

    def __call__(self) -> None:
        """Look.

        Raises:
            Fault: a joint's position stands still.
        """
        moves, same = self._moves, self._same
        np.not_equal(self._pos, self._last, out=moves)
        same += 1
        if moves.all():  # the usual tick
            same[...] = 0
            self._last[...] = self._pos
            self._reference[...] = self._target
            return
        np.copyto(same, 0, where=moves)
        np.copyto(self._reference, self._target, where=moves)
        self._last[...] = self._pos
        if same.max() >= self._ticks:
            self._look()

    def _look(self) -> None:
        asked = np.abs(self._target - self._reference) > self._motion
        stuck = (self._same >= self._ticks) & asked & (self._stiffness > 0.0)
        if stuck.any():
            index = tuple(int(i) for i in np.argwhere(stuck)[0])
            who = f"robot {index[0]}, " if len(index) > 1 else ""
            moved = float(abs(self._target - self._reference)[index])
            raise Fault(
                f"{who}joint {self._names[index[-1]]} is stuck: its position has been "
                f"{self._pos[index]:.6g} rad for {self._same[index]} ticks while its target moved "
                f"by {moved:.2f} rad; is its encoder there?"
            )

    def reset(self) -> None:
        """Look anew."""
        self._last[...] = np.nan
        self._same[...] = 0


def imu_stop(
    base_quat: Reads,
    base_ang_vel: Reads,
    projected_gravity: Reads,
    joint_pos: Reads,
    *,
    period: float,
    timeout: float = 0.2,
    motion: float = 0.3,
    angle: float = 0.35,
) -> ImuStop:
    """Stop where the IMU stands still while the joints move, or contradicts itself.

    The gyroscope turns the direction of gravity in the base frame, dg/dt = -w x g (R. Featherstone,
    Rigid Body Dynamics Algorithms, 2008, section 2.7, of a vector that is constant in the world).
    What it foretells is drawn to what was measured within 0.5 s; a quaternion that is frozen, or
    the identity, stays behind by `angle` where the base turns.

    Args:
        base_quat: w, x, y, z, base to world, shape (4,).
        base_ang_vel: in the base frame in [rad/s], shape (3,).
        projected_gravity: unit vector of gravity in the base frame, shape (3,).
        joint_pos: in [rad], shape (n,).
        timeout: in [s] of ticks with the same bits.
        motion: of all joints together since then, in [rad].
        angle: between foretold and measured gravity, and between that of the quaternion and
            `projected_gravity`, in [rad].

    Raises:
        WorkflowError: an option is not plausible, or the states are of a batch.
    """
    if base_quat.ndim != 1:
        raise WorkflowError("it looks at one robot; leave num_robots out, or leave it out")
    timeout = within(timeout, "timeout", "s", STALE, what="imu_stop")
    motion = within(motion, "motion", "rad", 100.0, what="imu_stop")
    angle = within(angle, "angle", "rad", 0.5 * math.pi, what="imu_stop")
    ticks = max(ticks_of(timeout, period, "timeout") or 1, 2)
    return ImuStop(
        (base_quat, base_ang_vel, projected_gravity, joint_pos), period, ticks, motion, angle
    )


class ImuStop:
    """The tick of `imu_stop`."""

    stage = Stage.SAFETY

    DRAWN = 0.5
    """Time in which the foretold direction is drawn to the measured one, [s]."""

    def __init__(
        self, views: tuple[Float, ...], period: float, ticks: int, motion: float, angle: float
    ) -> None:
        self._quat, self._gyro, self._gravity, self._joints = views
        self._period, self._ticks, self._motion, self._angle = period, ticks, motion, angle
        self._draw = min(period / self.DRAWN, 1.0)
        self._allowed = 2.0 * math.sin(0.5 * angle)  # chord between two unit vectors
        self._bits: tuple[float, ...] = ()
        self._foretold: tuple[float, float, float] | None = None
        self._same = self._apart = 0
        self._reference = self._joints.copy()

    def __call__(self) -> None:
        """Look.

        Raises:
            Fault: the IMU stands still or contradicts itself.
        """
        w, x, y, z = self._quat.tolist()
        gx, gy, gz = self._gravity.tolist()
        wx, wy, wz = self._gyro.tolist()
        bits = (w, x, y, z, gx, gy, gz, wx, wy, wz)
        if bits == self._bits:
            self._frozen()
        else:
            self._bits, self._same = bits, 0
        # Gravity as the quaternion has it: the third row of its matrix, with the sign of "down".
        qx, qy, qz = 2 * (w * y - x * z), -2 * (w * x + y * z), 2 * (x * x + y * y) - 1
        if not abs(qx - gx) + abs(qy - gy) + abs(qz - gz) <= 3 * self._allowed:
            raise Fault(
                "the IMU contradicts itself: gravity by base_quat is "
                f"({qx:.2f}, {qy:.2f}, {qz:.2f}), projected_gravity ({gx:.2f}, {gy:.2f}, {gz:.2f})"
            )
        px, py, pz = self._foretold or (gx, gy, gz)
        step, draw = self._period, self._draw
        px, py, pz = (
            px - step * (wy * pz - wz * py),
            py - step * (wz * px - wx * pz),
            pz - step * (wx * py - wy * px),
        )
        ex, ey, ez = gx - px, gy - py, gz - pz
        self._foretold = (px + draw * ex, py + draw * ey, pz + draw * ez)
        if ex * ex + ey * ey + ez * ez <= self._allowed**2:
            self._apart = 0
            return
        self._apart += 1
        if self._apart >= self._ticks:
            raise Fault(
                f"the IMU contradicts itself: for {self._apart} ticks gravity has not turned as "
                f"the gyroscope says ({wx:.1f}, {wy:.1f}, {wz:.1f} rad/s); is base_quat frozen?"
            )

    def _frozen(self) -> None:
        if self._same == 0:
            self._reference = self._joints.copy()
        self._same += 1
        if self._same < self._ticks:
            return
        moved = float(np.abs(self._joints - self._reference).sum())
        if moved > self._motion:
            raise Fault(
                f"the IMU stands still: the same bits for {self._same} ticks while the joints "
                f"moved by {moved:.2f} rad; is it there?"
            )

    def reset(self) -> None:
        """Look anew."""
        self._bits, self._foretold = (), None
        self._same = self._apart = 0
