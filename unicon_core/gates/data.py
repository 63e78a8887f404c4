"""Gates on the data themselves: they are there, new in every tick, not frozen; the IMU's agree."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Collection, Mapping, Sequence

import numpy as np

from unicon_base.arrays import Array, Bool, Float64
from unicon_core.gates.gate import StartGate
from unicon_core.states import States


class Told:
    """Gate `data`: everything that the command depends on has been told, and is finite.

    Whether a state was written is not seen in its value: a joint may be at rest at its initial 0.
    So each element is moved by the smallest step a float has; who writes it takes the step back.

    Args:
        states: of the workflow.
        readers: float states that the platform tells, each with the block that reads it.
        source: who tells them, for messages.
    """

    name = "data"

    def __init__(self, states: States, readers: Mapping[str, str], source: str) -> None:
        self._states, self._readers, self._source = states, dict(readers), source
        self._marks: dict[str, Array] = {}
        self._untold: dict[str, Bool] = {}
        self.about = f"{', '.join(readers)}: told since the start, and finite"

    def __call__(self) -> str:
        """Look at every state."""
        first = not self._marks
        said = ""
        for name, reader in self._readers.items():
            view = self._states[name]
            wrong = ~np.isfinite(view)
            if wrong.any():
                said = said or self._of(name, wrong, reader, f"is {view[wrong].flat[0]}")
            if first:
                np.nextafter(view, np.inf, out=view)
                self._marks[name] = view.copy()
                self._untold[name] = np.ones(view.shape, np.bool_)
                said = said or f"{name} is being waited for, which block {reader!r} reads"
                continue
            untold = self._untold[name]
            untold &= view == self._marks[name]
            if untold.any():
                said = said or self._of(name, untold, reader, "has not been told")
        return said

    def _of(self, name: str, wrong: Bool, reader: str, what: str) -> str:
        index = tuple(map(int, np.argwhere(wrong)[0]))
        names = self._states.spec(name).names
        of = f" of {names[index[-1]]}" if index and len(names) == wrong.shape[-1] else ""
        return (
            f"{name}{of} {what}, and block {reader!r} reads it; see whether "
            f"{self._source} is on, and tells it"
        )


class Rate:
    """Gate `rate`: new data come as often as is promised.

    It counts in how many of the last ticks there were new data, so that a busy machine, on which
    ticks come late, does not blame the robot.

    Args:
        count: grows with new data: a stamp in [ns], or a number of arrivals.
        period: of a tick in [s].
        promised: what the robot file says in [Hz], or None.
        source: who tells them, for messages.

    Attributes:
        count: as given.
    """

    name = "rate"

    SHARE = 0.8
    """Of the promise that must be kept: data and ticks of one rate miss each other at times."""
    WINDOW = 0.5
    """Time that is looked at in [s]."""

    def __init__(
        self, count: Callable[[], int], period: float, promised: float | None, source: str
    ) -> None:
        self.count, self._source, self._tick_hz = count, source, 1.0 / period
        self._promised = min(promised or self._tick_hz, self._tick_hz)
        self._fresh: deque[bool] = deque(maxlen=max(round(self.WINDOW / period), 10))
        self._last: int | None = None
        said = f"{promised:g} Hz promised, " if promised else ""
        self.about = f"new data at {self._needed:.3g} Hz or more ({said}tick {self._tick_hz:.3g})"

    @property
    def _needed(self) -> float:
        return self.SHARE * self._promised

    @property
    def hz(self) -> float:
        """New data of the last half second in [Hz], at most the tick's rate; 0 before."""
        return self._tick_hz * sum(self._fresh) / len(self._fresh) if self._fresh else 0.0

    def __call__(self) -> str:
        """Count once more."""
        count = self.count()
        if self._last is not None:
            self._fresh.append(count > self._last)
        self._last = count
        if len(self._fresh) < (self._fresh.maxlen or 0):
            return f"the rate of the data is being measured, which takes {self.WINDOW:g} s"
        if self.hz >= self._needed:
            return ""
        return (
            f"new data come at {self.hz:.3g} Hz, needed are {self._needed:.3g} Hz; see whether "
            f"{self._source} sends more often and nothing is lost on the way, or lower rate:"
        )


class Changing:
    """Gate `changing`: no sensor repeats the same bytes while others have their noise.

    What has no noise at all, as a simulation behind topics, proves nothing and holds. Encoders at
    rest may repeat themselves; measured velocities that are not zero do not.

    Args:
        imu: views of the inertial sensor.
        joints: views of the joints' sensors.
        velocity: the joints' velocities, one of these; or None.
        period: of a tick in [s].
    """

    name = "changing"

    FROZEN = 1.0
    """Time with the same bytes that is too long, in [s]."""
    OTHERS = 5
    """Changes of the others meanwhile that prove noise."""

    def __init__(
        self, imu: Sequence[Array], joints: Sequence[Array], velocity: Array | None, period: float
    ) -> None:
        self._sides = {"the IMU": list(imu), "the joints' sensors": list(joints)}
        self._velocity = velocity
        self._ticks = max(round(self.FROZEN / period), 10)
        self._bytes = dict.fromkeys(self._sides, b"")
        self._same = dict.fromkeys(self._sides, 0)
        self._others = dict.fromkeys(self._sides, 0)
        self.about = f"IMU and encoders do not repeat the same bytes for {self.FROZEN:g} s"

    def __call__(self) -> str:
        """Compare with the tick before."""
        changed = {}
        for side, views in self._sides.items():
            now = b"".join(view.tobytes() for view in views)
            changed[side] = now != self._bytes[side]
            self._bytes[side] = now
        said = ""
        for side, moves in changed.items():
            if moves or not self._sides[side]:
                self._same[side] = self._others[side] = 0
                continue
            self._same[side] += 1
            self._others[side] += any(changed.values())
            if self._same[side] >= self._ticks and self._others[side] >= self.OTHERS:
                said = said or self._frozen(side)
        return said

    def _frozen(self, side: str) -> str:
        if side != "the IMU" and (self._velocity is None or not self._velocity.any()):
            return ""
        return (
            f"{side} sent the same bytes for {self._same[side]} ticks while others changed: frozen "
            "or not connected; start the robot's driver anew"
        )


GRAVITY = 9.81
"""In [m/s²]."""
ACCELERATION = 1.5
"""How far |accelerometer| may be from it at rest in [m/s²]: MEMS sensors are off by up to 0.5."""
NONSENSE = 500.0
"""No accelerometer of a robot shows more, [m/s²]; it would stay in the average for ever."""
ANGLE = 0.2
"""Largest angle between measured and reported gravity at rest, [rad]; a wrong axis gives π/2."""
TURNING = 0.5
"""A base that turns faster is not at rest, [rad/s]."""
NORM = 0.01
"""How far a quaternion's length may be from 1."""
SMOOTH = 0.2
"""Time over which the accelerometer is averaged in [s]: feet and fans shake it."""


class Imu:
    """See the module. What the platform does not tell is not looked at.

    Args:
        views: those of `base_quat` (wxyz), `projected_gravity`, `base_ang_vel` [rad/s] and
            `base_lin_acc` [m/s²] that are told, of one robot.
        needed: those of them that the command depends on. An accelerometer that is not, and says
            0 in all axes, is none.
        period: of a tick in [s].
        stop: tells of contradictions that a safety block looks for, or None.
    """

    name = "imu"

    def __init__(
        self,
        views: Mapping[str, Array],
        needed: Collection[str],
        period: float,
        stop: StartGate | None,
    ) -> None:
        self._quat, self._down = views.get("base_quat"), views.get("projected_gravity")
        self._gyro, self._acceleration = views.get("base_ang_vel"), views.get("base_lin_acc")
        self._need_acceleration = "base_lin_acc" in needed
        self._stop, self._draw = stop, min(period / SMOOTH, 1.0)
        self._mean: Float64 | None = None
        self.about = f"{', '.join(views)} agree at rest, gravity is {GRAVITY} m/s²"

    def __call__(self) -> str:
        """Look at what is told."""
        gyro = 0.0 if self._gyro is None else _norm(self._gyro)
        if not gyro <= TURNING:
            self._mean = None
            return (
                f"the base turns at {gyro:.2f} rad/s by base_ang_vel, at most {TURNING} rad/s are "
                "rest; hold the robot still, or correct the gyroscope's unit"
            )
        return self._orientation() or self._gravity()

    def _orientation(self) -> str:
        if self._quat is not None:
            norm = _norm(self._quat)
            if not abs(norm - 1.0) <= NORM:
                return (
                    f"base_quat has length {norm:.3f} instead of 1; correct the map's fields, or "
                    "wait until the IMU has found its orientation"
                )
        return "" if self._stop is None else self._stop()

    def _gravity(self) -> str:
        measured = self._acceleration
        if measured is None or not (measured.any() or self._need_acceleration):
            return ""
        now = _norm(measured)
        if not now <= NONSENSE:
            self._mean = None
            return (
                f"|base_lin_acc| is {now:g} m/s², which no sensor measures; correct the driver or "
                "the unit in the map"
            )
        if self._mean is None:
            self._mean = measured.astype(np.float64)
        self._mean += self._draw * (measured - self._mean)
        size = _norm(self._mean)
        if not abs(size - GRAVITY) <= ACCELERATION:
            return (
                f"|base_lin_acc| is {size:.2f} m/s² at rest, gravity is {GRAVITY} ± "
                f"{ACCELERATION}; hold the robot still, or correct what the sensor tells: 1 is in "
                "units of g, 0 has gravity taken out"
            )
        if self._down is None:
            return ""
        cosine = -float(self._mean @ self._down) / (size * _norm(self._down) or 1.0)
        angle = math.acos(max(-1.0, min(cosine, 1.0))) if math.isfinite(cosine) else math.pi
        if angle <= ANGLE:
            return ""
        return (
            f"gravity by base_lin_acc is {angle:.2f} rad away from projected_gravity, at most "
            f"{ANGLE} rad are plausible; correct axes and signs of the IMU in the driver or the map"
        )


def _norm(vector: Array) -> float:
    """Return the length; in double precision, which a float's garbage does not overflow."""
    return float(np.linalg.norm(vector.astype(np.float64)))
