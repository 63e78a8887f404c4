"""Spline: positions and velocities between points in time, as joint_trajectory_controller's.

Between two points with positions alone the path is linear, with velocities cubic, with
accelerations quintic: https://control.ros.org, joint_trajectory_controller, "Trajectory
Representation". A point's velocities count where both ends of a segment have some.
"""

from __future__ import annotations

from bisect import bisect_right

import numpy as np

from unicon_base.arrays import Float64


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
