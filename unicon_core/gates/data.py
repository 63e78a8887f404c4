"""Gates on the data themselves: they are there, new in every tick, and not frozen."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.states import States

Array = NDArray[Any]


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
        self._untold: dict[str, NDArray[np.bool_]] = {}
        self.about = f"{', '.join(readers)}: told since the start, and finite"

    def __call__(self) -> str:
        """Look at every state."""
        first = not self._marks
        said = ""
        for name, reader in self._readers.items():
            view = self._states[name]
            wrong = ~np.isfinite(view)
            if wrong.any():
                value = view[wrong].flat[0]
                said = said or self._of(name, wrong, reader, f"is {value}")
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

    def _of(self, name: str, wrong: NDArray[np.bool_], reader: str, what: str) -> str:
        index = tuple(int(i) for i in np.argwhere(wrong)[0])
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
