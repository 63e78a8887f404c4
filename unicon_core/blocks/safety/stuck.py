"""Stops for sensors that stand still: `encoder_stop`, `imu_stop`.

A frozen sensor sends the same bytes; a real one never does for long, for it has noise. A simulation
without noise may, when nothing moves, so each detector waits for motion that the sensor would have
to see.
"""

from __future__ import annotations

import math
from typing import Annotated, Any

import numpy as np

from unicon_base.arrays import Float32
from unicon_base.errors import Fault
from unicon_base.schema.marks import positive
from unicon_core.blocks.postures import single, ticks_of
from unicon_core.blocks.safety.limits import first_of
from unicon_core.blocks.safety.stops import PATIENT
from unicon_core.bounds import Motion, Timeout
from unicon_core.flow.block import Reads, Stage
from unicon_core.robots import Robot


class EncoderStop:
    """Stop where a joint's position keeps its bits for some time after its target has moved.

    A joint that takes positions and closes the loop itself is not looked at: the fingers of a hand
    are meant to stop at what they grip, and tell the same position until they let go.

    Args:
        timeout: in [s] of ticks with the same bits, from the one on in which the target was first
            so far away.
        motion: by which the target has moved since the position last changed, in [rad].
    """

    memory = ("_last", "_reference", "_since", "_asked_at", "_tick", "_all", "_began")

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
        timeout: Timeout = 0.1,
        motion: Motion = 0.1,
    ) -> None:
        self._ticks = max(ticks_of(timeout, period), 2)
        self._motion = motion
        self.patient = self._ticks >= PATIENT
        pos, target = self._pos, self._target = joint_pos, joint_pos_target
        self._stiffness = joint_stiffness
        self._robot = robot
        self._looked_at = ~robot.by_position
        self._last = np.full_like(pos, np.nan)
        self._reference = np.zeros_like(pos)
        self._moves = np.ones(pos.shape, np.bool_)
        self._since, self._asked_at = (np.zeros(pos.shape, np.int64) for _ in range(2))
        self._tick = self._all = self._began = 0
        self._asked = np.zeros_like(pos)
        # As bytes, 29 numbers are copied in 0.1 µs; as arrays in 0.25.
        self._into_last = _bytes(self._last)
        self._from_pos = _bytes(pos)
        self._into_reference = _bytes(self._reference)
        self._from_target = _bytes(target)

    def __call__(self) -> None:
        """Look.

        Raises:
            Fault: a joint's position stands still.
        """
        moves = self._moves
        self._tick += 1
        np.not_equal(self._pos, self._last, moves)
        if 0 not in moves.tobytes():  # the usual tick
            self._into_last[:] = self._from_pos
            self._into_reference[:] = self._from_target
            self._all = self._tick
            return
        self._into_last[:] = self._from_pos
        if self._all > self._began:  # they moved, all of them, in the tick before
            self._began = self._all
            self._since[...] = self._all
        np.copyto(self._since, self._tick, where=moves)
        np.copyto(self._reference, self._target, where=moves)
        asked = np.subtract(self._target, self._reference, out=self._asked).reshape(-1)
        if not asked.dot(asked) <= self._motion**2:
            self._look()

    def _look(self) -> None:
        over = ~(np.abs(self._asked) <= self._motion) & (self._stiffness > 0.0) & self._looked_at
        # A joint that rested before has no less time to follow.
        np.copyto(self._asked_at, self._tick, where=over & (self._asked_at <= self._since))
        same = self._tick - self._since
        stuck = over & (self._tick - self._asked_at + 1 >= self._ticks)
        if stuck.any():
            index, who = first_of(stuck, self._robot)
            raise Fault(
                f"{who} is stuck: its position has been "
                f"{self._pos[index]:.6g} rad for {same[index]} ticks while its target moved "
                f"by {abs(self._asked[index]):.2f} rad; is its encoder there?"
            )

    def reset(self) -> None:
        """Look anew."""
        self._last[...] = np.nan


def _bytes(view: Float32) -> memoryview:
    """Return a contiguous view as bytes."""
    flat: Any = view.reshape(-1).view(np.uint8)
    return memoryview(flat)


class ImuStop:
    """Stop where the IMU stands still while the joints move, or contradicts itself.

    From one tick to the next the quaternion turns by 2 vec(conj(q0) q1), small angles, and the
    gyroscope by w dt (J. Sola, Quaternion kinematics for the error-state Kalman filter, 2017,
    sections 4.6.1 and 2.4). What lies between them is added up for each axis, and decays within
    `DRAWN`: an offset of 2 rad/s reaches 0.35 rad after 0.22 s, and a sign that is wrong once the
    base has turned by 0.18 rad. Walks of all shipped policies with their training's noise
    (0.2 rad/s, 0.05 rad) and pushes of 0.5 m/s reach 0.15 rad. A quaternion that is frozen, or the
    identity, has the same bits while the gyroscope turns by `angle`, however slowly.

    Args:
        base_quat: w, x, y, z, base to world, shape (4,).
        base_ang_vel: in the base frame in [rad/s], shape (3,).
        projected_gravity: unit vector of gravity in the base frame, shape (3,).
        joint_pos: in [rad], shape (n,).
        stamp_ns: source time of the data in [ns], shape ().
        timeout: in [s] of ticks with the same bits.
        motion: of all joints together since then, in [rad].
        angle: between what the quaternion and what the gyroscope turned by, and between gravity of
            the quaternion and `projected_gravity`, in [rad].

    Raises:
        WorkflowError: the states are of a batch.
    """

    memory = (
        "_at",
        "_wait",
        "_last_gyro",
        "_last_rest",
        "_last_quat",
        "_turned",
        "_from_quat",
        "_from_gyro",
        "_error",
        "_apart",
        "_same",
        "_reference",
    )

    stage = Stage.SAFETY

    DRAWN = 0.5
    """Time in which what lies between quaternion and gyroscope decays, [s]."""

    PERSISTS = 0.05
    """So long it is beyond the angle before it is a fault, [s]: one wrong frame is none."""

    LONGEST = 0.1
    """Between two frames, [s]: of a longer pause nobody knows how the base turned in it."""

    NOISE = 0.05
    """What a gyroscope may tell of a base at rest, [rad/s]: noise and offset, with room."""

    def __init__(
        self,
        base_quat: Reads,
        base_ang_vel: Reads,
        projected_gravity: Reads,
        joint_pos: Reads,
        stamp_ns: Reads,
        *,
        period: float,
        timeout: Timeout = 0.2,
        motion: Annotated[float, positive(100.0, "rad")] = 0.3,
        angle: Annotated[float, positive(0.5 * math.pi, "rad")] = 0.35,
    ) -> None:
        single(base_quat)
        ticks = self._ticks = max(ticks_of(timeout, period), 2)
        self.patient = ticks >= PATIENT
        self._quat = base_quat
        self._gyro = base_ang_vel
        self._gravity = projected_gravity
        self._joints = joint_pos
        self._period = period
        self._motion = motion
        self._angle = angle
        self._stamp = stamp_ns
        self._allowed = 2.0 * math.sin(0.5 * angle)  # chord between two unit vectors
        self._every = max(ticks // 4, 1)  # what is compared without a history needs no haste
        self._at = -1
        self._from_gyro: list[float] = []
        self._error = [0.0] * 3
        self._reference = joint_pos.copy()
        self.reset()

    def reset(self) -> None:
        """Look anew."""
        self._last_gyro: list[float] = []
        self._last_rest: list[float] = []
        self._last_quat: list[float] = []
        self._from_quat: list[float] = []
        self._same = self._wait = 0
        self._turned = self._apart = 0.0

    def __call__(self) -> None:
        """Look.

        Raises:
            Fault: the IMU stands still or contradicts itself.
        """
        # Numbers of Python: 60 products of them take 2 µs, ten operations on arrays of three 5.
        gravity, gyro, quat = self._gravity.tolist(), self._gyro.tolist(), self._quat.tolist()
        self._integrate(gyro, quat)
        if quat != self._last_quat:
            self._last_quat = quat
            self._turned = 0.0
        elif gyro != self._last_gyro:  # what stands still as a whole may be late, and is below
            self._turn(gyro)
        if gyro != self._last_gyro:
            self._last_gyro = gyro
            self._last_rest = []
            self._same = 0
        else:
            rest = [*gravity, *quat]
            if self._last_rest and rest != self._last_rest:
                self._same = 0
            else:
                self._frozen()
            self._last_rest = rest
        self._wait -= 1
        if self._wait <= 0:
            self._wait = self._every
            self._compare(gravity)

    def _integrate(self, gyro: list[float], quat: list[float]) -> None:
        """Add up what lies between the turns of the quaternion and of the gyroscope."""
        now = int(self._stamp)
        before = self._from_quat
        was = self._from_gyro
        if now == self._at:  # the same frame, or of the IMU's topic alone
            return
        dt = (now - self._at) * 1e-9
        self._at = now
        self._from_quat = quat
        self._from_gyro = gyro
        if not before or not 0.0 < dt <= self.LONGEST:
            self._error = [0.0] * 3
            self._apart = 0.0
            return
        w, x, y, z = quat
        pw, px, py, pz = before
        twice = 2.0 if pw * w + px * x + py * y + pz * z >= 0.0 else -2.0
        turned = (
            twice * (pw * x - px * w - py * z + pz * y),
            twice * (pw * y + px * z - py * w - pz * x),
            twice * (pw * z - px * y + py * x - pz * w),
        )
        kept = max(1.0 - dt / self.DRAWN, 0.0)
        half = 0.5 * dt
        ex, ey, ez = self._error = [
            kept * e + t - half * (g + h) for e, t, g, h in zip(self._error, turned, gyro, was)
        ]
        if not ex * ex + ey * ey + ez * ez > self._angle**2:
            self._apart = 0.0
            return
        self._apart += dt
        if self._apart >= self.PERSISTS:
            raise Fault(
                "the IMU contradicts itself: base_quat turned otherwise than the gyroscope says "
                f"({', '.join(f'{g:.1f}' for g in gyro)} rad/s), by {ex:.2f}, {ey:.2f}, {ez:.2f} "
                "rad about x, y, z; is one of them frozen, biased or of another sign?"
            )

    def _turn(self, gyro: list[float]) -> None:
        """Add up what the gyroscope says of the time in which the quaternion has the same bits."""
        rate = math.hypot(*gyro)
        if rate < self.NOISE:
            return
        self._turned += rate * self._period
        if self._turned > self._angle:
            raise Fault(
                f"the IMU contradicts itself: base_quat has the same bits while the gyroscope "
                f"turned by {self._turned:.2f} rad; is base_quat frozen?"
            )

    def _compare(self, gravity: list[float]) -> None:
        """Compare gravity with what the quaternion says of it."""
        w, x, y, z = self._quat.tolist()
        gx, gy, gz = gravity
        # The third row of the quaternion's matrix, with the sign of "down".
        qx = 2 * (w * y - x * z)
        qy = -2 * (w * x + y * z)
        qz = 2 * (x * x + y * y) - 1
        if not abs(qx - gx) + abs(qy - gy) + abs(qz - gz) <= 3 * self._allowed:
            raise Fault(
                "the IMU contradicts itself: gravity by base_quat is "
                f"({qx:.2f}, {qy:.2f}, {qz:.2f}), projected_gravity ({gx:.2f}, {gy:.2f}, {gz:.2f})"
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
