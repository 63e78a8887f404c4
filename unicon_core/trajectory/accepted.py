"""What is accepted as a trajectory: nothing that would make a robot jump; for `Player`.

The order of the checks and the codes are joint_trajectory_controller's; what it takes on trust
(limits, speeds, numbers that are not finite) is checked too.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from unicon_base import alternatives
from unicon_base.arrays import Float64, Index


class Spline:
    """A path of n joints through m knots.

    Args:
        times: of the knots in [s], shape (m,), increasing.
        positions: in [rad], shape (m, n).
        velocities: in [rad/s], shape (m, n); rows of NaN where a knot has none.
        accelerations: in [rad/s²], shape (m, n); rows of NaN where a knot has none.

    Attributes:
        times: of the knots in [s], shape (m,).
        end: the last of them.
        straight: all of it are lines.
    """

    def __init__(
        self, times: Float64, positions: Float64, velocities: Float64, accelerations: Float64
    ) -> None:
        self.times, self.end = times, float(times[-1])
        self._starts: list[float] = times.tolist()
        spans = np.diff(times)[:, None]
        way = np.diff(positions, axis=0)
        c = np.zeros((len(spans), 6, positions.shape[1]))
        c[:, 0] = positions[:-1]
        v0, v1, a0, a1 = velocities[:-1], velocities[1:], accelerations[:-1], accelerations[1:]
        cubic = ~np.isnan(v0 + v1).any(axis=1)
        quintic = cubic & ~np.isnan(a0 + a1).any(axis=1)
        cubic &= ~quintic
        linear = ~(cubic | quintic)
        self.straight = bool(linear.all())
        c[linear, 1] = (way / spans)[linear]
        t, d = spans[cubic], way[cubic]
        u0, u1 = v0[cubic], v1[cubic]
        c[cubic, 1] = u0
        c[cubic, 2] = (3.0 * d - (2.0 * u0 + u1) * t) / t**2
        c[cubic, 3] = (-2.0 * d + (u0 + u1) * t) / t**3
        t, d = spans[quintic], way[quintic]
        u0, u1, b0, b1 = v0[quintic], v1[quintic], a0[quintic], a1[quintic]
        c[quintic, 1], c[quintic, 2] = u0, 0.5 * b0
        c[quintic, 3] = (20 * d - (8 * u1 + 12 * u0) * t - (3 * b0 - b1) * t**2) / (2 * t**3)
        c[quintic, 4] = (-30 * d + (14 * u1 + 16 * u0) * t + (3 * b0 - 2 * b1) * t**2) / (2 * t**4)
        c[quintic, 5] = (12 * d - 6 * (u1 + u0) * t + (b1 - b0) * t**2) / (2 * t**5)
        self._c = c
        self._last = positions[-1].copy()

    def sample(self, time: float, position: Float64, velocity: Float64) -> None:
        """Write position [rad] and velocity [rad/s] at a time in [s], each of shape (n,).

        Behind the end both are those of rest at the last knot.
        """
        if time >= self.end:
            position[...] = self._last
            velocity[...] = 0.0
            return
        i = max(bisect_right(self._starts, time) - 1, 0)
        t, c = time - self._starts[i], self._c[i]
        position[...] = c[5]
        velocity[...] = 0.0
        for k in (4, 3, 2, 1, 0):  # Horner's scheme, the derivative beside it
            velocity *= t
            velocity += position
            position *= t
            position += c[k]

    def within(self, shares: Float64) -> tuple[Float64, Float64]:
        """Return positions and velocities inside of every segment.

        Args:
            shares: of a segment's time, 0 to 1, shape (s,).

        Returns:
            Positions [rad] and velocities [rad/s], each of shape (m - 1, s, n).
        """
        t = np.diff(self.times)[:, None, None] * shares[None, :, None]
        position = np.broadcast_to(self._c[:, None, 5], (*t.shape[:2], self._c.shape[2])).copy()
        velocity = np.zeros_like(position)
        for k in (4, 3, 2, 1, 0):
            velocity = velocity * t + position
            position = position * t + self._c[:, None, k]
        return position, velocity


MOST_POINTS = 1000
"""In one trajectory: it is checked between two ticks, 100 points of 12 joints in 1 to 2 ms."""
LONGEST = 3600.0
"""From now to a trajectory's end in [s]."""
FARTHEST = 60.0
"""From now to its start in [s]: a later one is of another clock, such as the wall's."""
SHARES = np.linspace(0.0, 1.0, 5)
"""Of each segment, where speeds and positions are looked at: a cubic from rest to rest is fastest
at 1/2. The follower bounds what lies between."""
ROUNDING = 1e-4
"""In [rad] and as a share of a speed: figures of messages are rounded."""


class Code(IntEnum):
    """`error_code` of control_msgs/action/FollowJointTrajectory."""

    SUCCESSFUL = 0
    INVALID_GOAL = -1
    INVALID_JOINTS = -2
    OLD_HEADER_TIMESTAMP = -3
    PATH_TOLERANCE_VIOLATED = -4
    GOAL_TOLERANCE_VIOLATED = -5


class Refusal(Exception):
    """A trajectory that is not played.

    Args:
        reason: one line.
        code: of the action's result.
    """

    def __init__(self, reason: str, code: Code = Code.INVALID_GOAL) -> None:
        super().__init__(reason)
        self.code, self.reason = code, reason


@dataclass(frozen=True)
class Points:
    """A trajectory as it came.

    Attributes:
        joints: names, length k.
        times: from its start in [s], length m.
        positions: m lists of k in [rad].
        velocities: m lists of k in [rad/s], or empty ones.
        accelerations: m lists of k in [rad/s²], or empty ones.
        efforts: m lists, which have to be empty.
        wait: from now to its start in [s]; negative: it has begun already. None: it begins now.
    """

    joints: Sequence[str]
    times: Sequence[float]
    positions: Sequence[Sequence[float]]
    velocities: Sequence[Sequence[float]]
    accelerations: Sequence[Sequence[float]]
    efforts: Sequence[Sequence[float]] = ()
    wait: float | None = None


@dataclass(frozen=True)
class Limits:
    """Of the robot, in its joint order, each of shape (n,), infinite where unknown.

    Attributes:
        joints: names, length n.
        lower: in [rad].
        upper: in [rad].
        speed: in [rad/s].
        partial: whether a trajectory may leave joints out, which then hold.
        start: how far the first point may be from where the joints are in [rad], if it is to be
            there at once.
    """

    joints: tuple[str, ...]
    lower: Float64
    upper: Float64
    speed: Float64
    partial: bool = False
    start: float = 0.1


@dataclass(frozen=True)
class Start:
    """Where the joints are, each of shape (n,).

    Attributes:
        target: in [rad], what was commanded last.
        velocity: of that target in [rad/s].
        measured: in [rad].
    """

    target: Float64
    velocity: Float64
    measured: Float64


def accepted(points: Points, limits: Limits, start: Start) -> Spline:
    """Return the path from where the joints are through all points.

    Raises:
        Refusal: it is not one to be followed; with a code and one line.
    """
    place = _places(points, limits)
    times = _times(points)
    full = _filled(points, limits, place, start)
    ahead = times > 0.0
    if not ahead[0] and (points.wait is None or points.wait >= 0.0):
        _begins_here(full[0][0], limits, place, start)
    spline = Spline(
        np.concatenate([[0.0], times[ahead]]),
        np.concatenate([start.target[None], full[0][ahead]]),
        np.concatenate([start.velocity[None], full[1][ahead]]),
        np.concatenate([np.full((1, len(limits.joints)), np.nan), full[2][ahead]]),
    )
    _within_limits(spline, limits, place, start)
    return spline


def _places(points: Points, limits: Limits) -> Index:
    """Return where the joints of a trajectory stand in the robot's order, shape (k,)."""
    names = list(points.joints)
    if not names:
        raise Refusal("the trajectory names no joints", Code.INVALID_JOINTS)
    own = {name: i for i, name in enumerate(limits.joints)}
    for name in names:
        if name not in own:
            known = alternatives(name[:60], limits.joints, limit=6)
            raise Refusal(f"the robot has no joint {name[:60]!r}; {known}", Code.INVALID_JOINTS)
    if len(set(names)) != len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise Refusal(f"joint {twice!r} stands twice in the trajectory", Code.INVALID_JOINTS)
    if not limits.partial and len(names) < len(own):
        lacking = [name for name in limits.joints if name not in names]
        raise Refusal(
            f"the trajectory lacks joint {lacking[0]!r} ({len(lacking)} joints); name all, or say "
            "missing: hold in the map",
            Code.INVALID_JOINTS,
        )
    return np.array([own[name] for name in names])


def _times(points: Points) -> Float64:
    """Return when each point is to be reached, from now in [s], shape (m,)."""
    if not points.times:
        raise Refusal("the trajectory has no points")
    if len(points.times) > MOST_POINTS:
        raise Refusal(
            f"the trajectory has {len(points.times)} points; at most {MOST_POINTS} are read"
        )
    times = np.array(points.times, np.float64)
    if not np.isfinite(times).all() or times[0] < 0.0:
        raise Refusal(f"the first point has the time {times[0]:g} s; give 0 or more")
    falling = np.flatnonzero(np.diff(times) <= 0.0)
    if len(falling):
        i = int(falling[0])
        raise Refusal(
            f"times of points have to increase: point {i} is at {times[i]:g} s, point {i + 1} at "
            f"{times[i + 1]:g} s"
        )
    wait = points.wait or 0.0
    if not wait <= FARTHEST:
        raise Refusal(
            f"the trajectory begins {wait:g} s from now; at most {FARTHEST:g} are waited. Stamps "
            "are of /clock where a simulator runs (use_sim_time), else of the wall clock; 0 is now"
        )
    times += wait
    if not times[-1] > 0.0:
        raise Refusal(
            f"the trajectory ended {-times[-1]:g} s ago"
            if points.wait is not None
            else "the trajectory ends at 0 s: its joints would have to jump; give it a time",
            Code.INVALID_GOAL if points.wait is None else Code.OLD_HEADER_TIMESTAMP,
        )
    if times[-1] > LONGEST:
        raise Refusal(f"the trajectory takes {times[-1]:g} s; at most {LONGEST:g} are played")
    return times


def _filled(
    points: Points, limits: Limits, place: Index, start: Start
) -> tuple[Float64, Float64, Float64]:
    """Return positions, velocities and accelerations of all joints, each of shape (m, n)."""
    count, size = len(points.times), len(limits.joints)
    held = np.ones(size, np.bool_)
    held[place] = False
    found = []
    for what, rows in (
        ("positions", points.positions),
        ("velocities", points.velocities),
        ("accelerations", points.accelerations),
        ("effort", points.efforts),
    ):
        full = np.full((count, size), np.nan)
        said = np.array([len(given) > 0 or what == "positions" for given in rows], np.bool_)
        if what == "effort" and said.any():
            i = int(said.argmax())
            raise Refusal(f"point {i} has efforts, which are not followed; leave them empty")
        for i, given in enumerate(rows):
            if said[i] and len(given) != len(place):
                raise Refusal(f"point {i} has {len(given)} {what} for {len(place)} joints")
        if said.any():
            values = np.array([given for given, there in zip(rows, said) if there], np.float64)
            if not np.isfinite(values).all():
                row, column = np.argwhere(~np.isfinite(values))[0]
                i, name = int(np.flatnonzero(said)[row]), points.joints[int(column)]
                raise Refusal(f"point {i} has {what} that are not finite ({name})")
            full[np.ix_(said, place)] = values
            full[np.ix_(said, held)] = start.target[held] if what == "positions" else 0.0
        found.append(full)
    last = found[1][-1, place]
    if np.abs(last).max() > ROUNDING:
        joint = points.joints[int(np.nanargmax(np.abs(last)))]
        raise Refusal(f"the last point has a velocity ({joint}); a trajectory ends at rest")
    return found[0], found[1], found[2]


def _begins_here(first: Float64, limits: Limits, place: Index, start: Start) -> None:
    """Refuse a first point that is to be there at once, and is not."""
    off = np.fmin(np.abs(first - start.target), np.abs(first - start.measured))[place]
    if off.max() > limits.start:
        worst = int(place[int(off.argmax())])
        raise Refusal(
            f"the first point, at 0 s, is {off.max():.3f} rad from where {limits.joints[worst]} is "
            f"({start.target[worst]:.3f} rad); allowed are {limits.start:g} (start_tolerance): "
            "begin where the robot is, or give the first point a time"
        )


def _within_limits(spline: Spline, limits: Limits, place: Index, start: Start) -> None:
    shares = SHARES[[0, -1]] if spline.straight else SHARES
    positions, speeds = spline.within(shares)
    # A joint that is beyond a limit may come back from there.
    lower = np.minimum(limits.lower, start.target) - ROUNDING
    upper = np.maximum(limits.upper, start.target) + ROUNDING
    beyond = np.fmax(lower - positions, positions - upper)[..., place]
    if beyond.max() > 0.0:
        i, k, j = np.unravel_index(int(beyond.argmax()), beyond.shape)
        joint = int(place[int(j)])
        at = spline.times[i] + float(shares[k]) * (spline.times[i + 1] - spline.times[i])
        raise Refusal(
            f"{limits.joints[joint]} would be at {positions[i, k, joint]:.3f} rad after {at:.3g} "
            f"s; allowed are {limits.lower[joint]:.3f} to {limits.upper[joint]:.3f}"
        )
    most = limits.speed * (1.0 + ROUNDING) + ROUNDING
    # What moves already may be slowed down.
    most = np.maximum(most, np.abs(start.velocity) * (1.0 + ROUNDING))
    over = (np.abs(speeds) - most)[..., place]
    if over.max() > 0.0:
        i, k, j = np.unravel_index(int(over.argmax()), over.shape)
        joint = int(place[int(j)])
        to = f"from {spline.times[i]:.3g} to {spline.times[i + 1]:.3g} s"
        raise Refusal(
            f"{limits.joints[joint]} would have to move at {abs(speeds[i, k, joint]):.3g} rad/s "
            f"{to}; allowed are {limits.speed[joint]:.3g}: give it more time"
        )
