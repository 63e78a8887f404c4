"""Block `leg_odometry`: how a legged robot moves, of its IMU and the legs that carry it.

`Standing` says which feet stand, and how much what they say of the velocity is worth.
"""

from __future__ import annotations

import math
from typing import Annotated, Any

import numpy as np

from unicon_base.arrays import Array
from unicon_base.errors import WorkflowError
from unicon_base.schema.marks import positive
from unicon_core.blocks.odometry.velocity_filter import VelocityFilter
from unicon_core.blocks.postures import single
from unicon_core.flow.block import Reads, Writes
from unicon_core.models.feet import GRAVITY, Feet
from unicon_core.platforms.kit.base import rotation_of
from unicon_core.robots import Robot
from unicon_core.states import StateSpec
from unicon_core.workflow.autowire import BuildContext

# Of an equal share of the weight: what a foot bears that surely hangs, and surely stands. A leg
# that swings asks its joints for up to a third of it.
_LEAST = 0.4
_SURE = 0.8
# Over the lowest foot in [m]: a foot so high surely stands, and surely hangs, of an even floor.
_NEAR = 0.01
_FAR = 0.04
# What an accelerometer reads at most in the air, [m/s²].
_FALLS = 0.3 * GRAVITY
# What a foot moves though it stands, at its touchdown in [m/s], and the time in [s] in which that
# goes: rubber and ground give way, and the foot slides until it bears.
_TOUCH = 0.25
_SETTLES = 0.05


class Standing:
    """Tells of each foot whether it stands.

    The variance of a velocity that a leg tells is that of its joints' velocities times its length,
    the more the less surely the foot stands (Camurri et al., "Probabilistic Contact Estimation and
    Impact Detection for State Estimation of Quadruped Robots", RA-L 2017).

    Args:
        feet: of the robot, at any posture.
        robot: names them.
        joint_noise: standard deviation of the joints' velocities in [rad/s].
        threshold: of the feet's force sensors, or None.

    Attributes:
        contact: from 0 to 1, how surely each foot of the robot file stands, shape (len(feet),).
        any: whether one of them stands at all.
        height: of the base over the feet that stand in [m], None where none does.
    """

    memory = ("contact", "any", "height", "_since")

    def __init__(
        self, feet: Feet, robot: Robot, joint_noise: float, threshold: float | None
    ) -> None:
        self._feet = feet
        self._threshold = threshold
        self._share = feet.weight / len(feet.names)
        self._rank = np.array([robot.feet.index(name) for name in feet.names], np.intp)
        pose = np.nan_to_num(robot.default_joint_pos)
        none = np.zeros(3)
        feet(np.array((1.0, 0.0, 0.0, 0.0)), none, pose, np.zeros_like(pose), None)
        lengths = np.linalg.norm(feet.position, axis=1)
        self._variances = ((joint_noise * lengths) ** 2).tolist()
        self.contact = np.zeros(len(robot.feet), np.float32)
        self.reset()

    def reset(self) -> None:
        """Begin anew: no foot has stood."""
        self._since = [0.0] * len(self._variances)
        self.any = False
        self.height: float | None = None
        self.contact[:] = 0.0

    def __call__(self, dt: float, pull: float, sensed: Array | None, torques: bool) -> list[float]:
        """Look at the feet.

        Args:
            dt: since the last look in [s].
            pull: what the accelerometer reads, its length squared in [m²/s⁴].
            sensed: by the feet's force sensors, in the order of the robot file, or None.
            torques: whether the feet's `force` is of now.

        Returns:
            The variance of each foot's velocity along an axis in [m²/s²], infinite for one that
            does not stand.
        """
        heights = self._feet.position[:, 2].tolist()
        sure = self._surely(heights, pull, sensed, torques)
        variances = []
        whole = 0.0
        height = 0.0
        for foot, share in enumerate(sure):
            if not share > 0.0:  # nor where it is not a number
                self._since[foot] = sure[foot] = 0.0
                variances.append(math.inf)
                continue
            touch = _TOUCH**2 * math.exp(-self._since[foot] / _SETTLES)
            variances.append(self._variances[foot] / (share * share) + touch)
            self._since[foot] += dt
            whole += share
            height -= share * heights[foot]
        self.any = whole > 0.0
        self.height = height / whole if self.any else None
        self.contact[self._rank] = sure
        return variances

    def _surely(
        self, heights: list[float], pull: float, sensed: Array | None, torques: bool
    ) -> list[float]:
        """Return how surely each foot stands, from 0 to 1."""
        if sensed is not None and self._threshold is not None:
            return [float(f >= self._threshold) for f in sensed[self._rank].tolist()]
        if torques:
            least = _LEAST * self._share
            span = (_SURE - _LEAST) * self._share
            return [min(max((f - least) / span, 0.0), 1.0) for f in self._feet.force.tolist()]
        if pull < _FALLS**2:
            return [0.0] * len(heights)
        high = min(heights) + _FAR
        return [min(max((high - at) / (_FAR - _NEAR), 0.0), 1.0) for at in heights]


ACCELERATION_NOISE = 1.5
JOINT_NOISE = 0.4
LONGEST = 0.1
"""Between two data in [s], over which an acceleration tells nothing any more."""
HANGS = 0.5
"""Time without a foot that stands in [s], after which the robot is taken to hang, not to jump."""
DRIFT = 0.03
"""Of the position, as a share of the way."""
# Squared, in [m²/s²], [rad²/s²] and [m²/s⁴]: a base that moves at 100 m/s, turns at 100 rad/s, or
# feels 100 g is one that a sensor makes up.
_FASTEST = 1e4
_QUICKEST = 1e4
_HARDEST = 1e6
_FORCE = "foot_force"
_POS_VARIANCE = "base_pos_w_variance"


class LegOdometry:
    """Estimate the velocity of the base, and its position from the beginning on.

    A foot that stands tells the base's velocity by the kinematics of its leg, the accelerometer
    what it is in between. Which feet stand follows from the state `foot_force` where there is one,
    else from the torques of the joints, else from the height of the feet.

    What is estimated takes the place of what a simulator measures.

    Args:
        base_quat: unit quaternion wxyz, base to world, shape (4,).
        base_ang_vel, base_lin_acc: gyroscope in [rad/s], accelerometer in [m/s²], shape (3,).
        joint_pos, joint_vel: in [rad] and [rad/s], shape (n,).
        base_lin_vel: of the base's origin, in its axes, [m/s], shape (3,).
        base_lin_vel_variance: along each axis, [m²/s²], shape ().
        foot_contact: from 0 to 1, how surely each foot of the robot file stands.
        position: write `base_pos_w` [m] and `base_pos_w_variance` [m²] as well: x and y from the
            beginning on, z over the feet that stand; None: where the platform tells none.
        foot_force: reading of the state `foot_force` from which a foot stands, in its unit.
        joint_noise: standard deviation of joint velocities, with what feet slip and the ground
            gives way, in [rad/s].
        acceleration_noise: of the mean acceleration between two ticks at 50 Hz in [m/s²].

    Raises:
        WorkflowError: the states are of a batch, or nobody says from which force a foot stands.
        ModelError: the robot's model has no feet, or there is none.
        MissingDependencyError: MuJoCo, which computes the kinematics, is not installed.
    """

    memory = ("_standing", "_filter", "_last", "_hanging", "_way", "_rotation", "_told", "_place")

    estimates = True  # what it writes takes the place of what a platform measures

    def __init__(
        self,
        base_quat: Reads,
        base_ang_vel: Reads,
        base_lin_acc: Reads,
        joint_pos: Reads,
        joint_vel: Reads,
        base_lin_vel: Writes,
        base_lin_vel_variance: Writes,
        foot_contact: Writes,
        *,
        context: BuildContext,
        position: bool | None = None,
        foot_force: float | None = None,
        joint_noise: Annotated[float, positive(20.0, "rad/s")] = JOINT_NOISE,
        acceleration_noise: Annotated[float, positive(100.0, "m/s²")] = ACCELERATION_NOISE,
    ) -> None:
        single(base_quat)
        platform = context.platform
        states = context.states
        robot = context.robot
        told = () if platform is None else platform.facts.writes
        if platform is not None and _FORCE in told and foot_force is None:
            raise WorkflowError(
                f"platform {platform.facts.name!r} tells {_FORCE!r}; say from which "
                "reading on a foot stands, as in foot_force: 30, or do not declare that state"
            )
        more = {n: states[n] for n in ("joint_effort", "stamp_ns", _FORCE) if n in told}
        if position is None:
            position = "base_pos_w" not in told
        self.reads = tuple(more)
        self.writes = ("base_pos_w", _POS_VARIANCE) if position else ()
        feet = Feet(context.model("leg_odometry"), robot)
        self._feet = feet
        self._standing = Standing(feet, robot, joint_noise, foot_force)
        self._filter = VelocityFilter(acceleration_noise)
        self._imu = base_quat, base_ang_vel, base_lin_acc
        self._effort = more.get("joint_effort")
        self._force = more.get(_FORCE)
        self._joints = joint_pos, joint_vel
        self._stamp = more.get("stamp_ns")
        self._period = context.period
        self._velocity = base_lin_vel
        self._variance = base_lin_vel_variance
        self._contact = foot_contact
        outs = {name: states[name] for name in self.writes}
        self._position = outs.get("base_pos_w")
        self._of_position = outs.get(_POS_VARIANCE)
        imu = robot.imu  # a filter of the IMU's place has no lever arm to mind
        self._arm = [0.0] * 3 if imu is None else np.nan_to_num(imu.position).tolist()
        self.reset()

    @staticmethod
    def declares(robot: Robot, **_: Any) -> dict[str, StateSpec]:
        """Return the states of what is estimated, but for the standard ones.

        Raises:
            WorkflowError: the robot has no feet.
        """
        if not robot.walks or not robot.feet:
            raise WorkflowError(
                f"block 'leg_odometry': robot {robot.name} ({robot.kind}) has no feet; leave it "
                "out, or name bodies of the model under feet in the robot file"
            )
        return {
            "base_lin_vel_variance": StateSpec(
                (), unit="m²/s²", description="of base_lin_vel along each axis"
            ),
            _POS_VARIANCE: StateSpec((), unit="m²", description="of base_pos_w along x and y"),
            "foot_contact": StateSpec(
                (len(robot.feet),), names=robot.feet, description="0 to 1: how surely it stands"
            ),
        }

    def reset(self) -> None:
        """Begin anew: at rest, at the origin."""
        self._filter.reset()
        self._standing.reset()
        self._last: int | None = None
        self._hanging = self._way = 0.0
        self._rotation: list[float] = np.eye(3).ravel().tolist()
        self._told, self._place = [0.0] * 3, [0.0] * 3

    def again(self) -> None:
        """Tick as if the present data were new, one period later than the last: to warm up."""
        self._last = None if self._stamp is None else int(self._stamp) - round(self._period * 1e9)
        self()

    def __call__(self) -> None:
        dt = self._since()
        if dt > 0.0:
            self._update(dt)
        self._velocity[:] = self._told
        if self._position is not None:
            self._position[:] = self._place

    def _since(self) -> float:
        """Return the time since the last data in [s], 0 where there are no new ones."""
        if self._stamp is None:
            return self._period
        stamp = int(self._stamp)
        last = self._last
        self._last = stamp
        if last is None:
            return self._period
        if stamp < last:  # a simulator that was put back
            self.reset()
            self._last = stamp
            return self._period
        return 1e-9 * (stamp - last)

    def _update(self, dt: float) -> None:
        feet = self._feet
        motion = self._filter
        quat, rates, force = self._imu
        w, x, y, z = quat.tolist()
        wx, wy, wz = rates.tolist()
        felt = force.tolist()
        length = w * w + x * x + y * y + z * z
        steady = 0.25 < length < 4.0 and wx * wx + wy * wy + wz * wz < _QUICKEST
        legs = steady and feet(quat, rates, *self._joints, self._effort)
        if steady:
            self._rotation = [*rotation_of(w, x, y, z, length)]
        else:
            wx = wy = wz = 0.0
        rotation = self._rotation
        pull = felt[0] * felt[0] + felt[1] * felt[1] + felt[2] * felt[2]
        if steady and dt <= LONGEST and pull < _HARDEST:
            motion.predict(dt, rotation, felt)
        else:
            motion.skip(dt)
        dt = min(dt, LONGEST)
        # The velocity of the IMU's place against the base's origin, in the base and in the world.
        x, y, z = self._arm
        x, y, z = wy * z - wz * y, wz * x - wx * z, wx * y - wy * x
        a, b, c, d, e, f, g, h, i = rotation
        sx = a * x + b * y + c * z
        sy = d * x + e * y + f * z
        sz = g * x + h * y + i * z
        if legs:
            variances = self._standing(dt, pull, self._force, self._effort is not None)
            told = [(sx - u, sy - v, sz - w) for u, v, w in feet.velocity.tolist()]
            motion.correct(dt, rotation, told, variances)
            self._contact[:] = self._standing.contact
        self._hanging = 0.0 if legs and self._standing.any else self._hanging + dt
        if self._hanging > HANGS:
            motion.rest(dt, rotation)
        u, v, w = motion.velocity
        u -= sx
        v -= sy
        w -= sz
        if not u * u + v * v + w * w < _FASTEST:
            self.reset()
            return
        self._told = [a * u + d * v + g * w, b * u + e * v + h * w, c * u + f * v + i * w]
        self._variance[...] = motion.variance
        if self._position is not None:
            self._move(dt, u, v, w)

    def _move(self, dt: float, u: float, v: float, w: float) -> None:
        """Move the position on by a velocity in the world's axes."""
        place = self._place
        place[0] += dt * u
        place[1] += dt * v
        height = self._standing.height
        place[2] = place[2] + dt * w if height is None else height
        self._way += dt * math.hypot(u, v)
        self._of_position[...] = (DRIFT * self._way) ** 2  # type: ignore[index]
