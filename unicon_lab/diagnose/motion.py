"""Motion: a recorded run cut into windows, and what was measured in each of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from unicon_base.arrays import Array, Bool, Float64, Int64
from unicon_base.errors import UniconError
from unicon_core.platforms.kit.base import rotation
from unicon_core.platforms.kit.disturbances import PLACE
from unicon_core.states import Layout
from unicon_core.states.standard import COMMAND_STATES
from unicon_lab.recording import Record

FEWEST = 8
"""Windows: with less there is nothing to hold a fit against."""
MOVING = 0.15
"""Of the joint that moves most, in [rad]: noise of joints that stand still seems friction."""
FALLEN = 0.5
"""Lean in [rad] from which on a walking robot falls: what comes then is not its plant's doing."""
HUNG_HEIGHT = 3.0
"""Of a base that is held in the air in [m]: no robot's legs reach the ground from there."""
BASE_ANSWERS = (
    *("gravity x", "gravity y", "turn rate x", "turn rate y", "turn rate z"),
    *(f"turn rate {axis} against base_quat" for axis in "xyz"),
)
"""What a window answers of a base beside the joints: unit gravity, turn rates [rad/s], and what
these are above the rates by which the attitude turns [rad/s], in its frame."""


def gravity_xy(quat: Array) -> Float64:
    """Return x and y of unit gravity in the base frame of attitudes (wxyz), shape (…, 2)."""
    gravity: Float64 = -rotation(quat)[..., 2, :2]
    return gravity


@dataclass(frozen=True, eq=False)
class Motion:
    """A recorded run.

    Attributes:
        period: of a tick in [s].
        measured: of `PLACE`, those that were measured, each of shape (ticks, …).
        commands: the command states, each of shape (ticks, n).
        starts: first tick of each window, shape (windows,).
        length: ticks of a window; `measured` has one more behind it, of the same run.
        hung: whether the base is held in the air, and what was measured of it does not count.
    """

    period: float
    measured: Mapping[str, Array]
    commands: Mapping[str, Array]
    starts: Int64
    length: int
    hung: bool = False

    @staticmethod
    def of(
        states: Mapping[str, Array],
        period: float,
        usable: Bool,
        window: float = 0.2,
        most: int = 200,
    ) -> Motion:
        """Cut a run into windows that follow each other.

        Args:
            states: at the end of each tick, by name, shape (ticks, …): what was measured at its
                beginning and what was sent.
            period: of a tick in [s].
            usable: ticks that ended and follow the one before, shape (ticks,).
            window: in [s].
            most: windows; of more, as many are taken, evenly.

        Raises:
            UniconError: something is missing, or there are too few windows.
        """
        lacking = [n for n in ("joint_pos", "joint_vel", *COMMAND_STATES) if n not in states]
        if lacking:
            raise UniconError(
                f"a diagnosis needs {lacking[0]}, which was not recorded; record with "
                "unicon run --record"
            )
        length = max(round(window / period), 2)
        measured = {name: states[name] for name in PLACE if name in states}
        for name in PLACE[2:]:  # a state without any change was not measured
            if name in measured and np.ptp(measured[name], axis=0).max(initial=0.0) == 0.0:
                del measured[name]
        if "base_lin_vel" not in measured:  # where the base is, is found with its velocity
            measured.pop("base_pos_w", None)
        commands = {name: states[name] for name in COMMAND_STATES}
        good = usable & ~_fallen(states)
        for values in (*measured.values(), *commands.values()):
            good &= np.isfinite(values).reshape(len(values), -1).all(axis=1)
        moved = np.ptp(states["joint_pos"][good], axis=0).max(initial=0.0) if good.any() else 0.0
        whole = np.convolve(good, np.ones(length + 2), "valid") > length + 1.5
        starts, tick = list[int](), 0
        while tick < len(whole):  # one tick more in front, for commands on their way
            if whole[tick]:
                starts.append(tick + 1)
                tick += length
            else:
                tick += 1
        if len(starts) < FEWEST or moved < 0.02:
            raise UniconError(
                f"a diagnosis needs at least {FEWEST} windows of {length * period:g} s in which "
                f"joints move; the run has {len(starts)}, and joints move by {moved:.3f} rad; "
                "record a longer run, or one with excite"
            )
        chosen = np.array(starts)
        if len(chosen) > most:
            chosen = chosen[np.linspace(0, len(chosen) - 1, most).round().astype(int)]
        return Motion(period, measured, commands, chosen, length)

    @property
    def still(self) -> bool:
        """Whether joints move too little to tell anything of them."""
        rows = np.unique(self.starts[:, None] + np.arange(self.length))
        return bool(np.ptp(self.measured["joint_pos"][rows], axis=0).max() < MOVING)

    @property
    def has_base(self) -> bool:
        """Whether attitude and turn rate of a base were measured."""
        names = "base_quat", "base_ang_vel"
        return not self.hung and all(name in self.measured for name in names)

    @property
    def sought(self) -> bool:
        """Whether the base's velocity at the beginning of windows is to be found."""
        return self.has_base and "base_lin_vel" not in self.measured

    @property
    def velocity_noise(self) -> Float64:
        """Standard deviation of the noise of each joint's velocity in [rad/s], shape (n,).

        From what three ticks in a row say that does not change evenly, or that positions do not.
        """
        pos, vel = (
            np.asarray(self.measured[f"joint_{word}"], np.float64) for word in ("pos", "vel")
        )
        bent = (vel[2:] - 2.0 * vel[1:-1] + vel[:-2]) / np.sqrt(6.0)
        apart = vel[1:-1] - (pos[2:] - pos[:-2]) / (2.0 * self.period)
        found = [1.48 * np.nanmedian(np.abs(each), axis=0) for each in (bent, apart)]
        return np.asarray(np.minimum(*found) + 1e-3)

    def hung_up(self) -> Motion:
        """Return the same run of a robot whose base is held upright at `HUNG_HEIGHT`."""
        still = {
            "base_quat": (1.0, 0.0, 0.0, 0.0),
            "base_ang_vel": (0.0, 0.0, 0.0),
            "base_pos_w": (0.0, 0.0, HUNG_HEIGHT),
            "base_lin_vel": (0.0, 0.0, 0.0),
        }
        count = len(self.measured["joint_pos"])
        held = {name: np.tile(value, (count, 1)) for name, value in still.items()}
        return replace(self, measured={**self.measured, **held}, hung=True)

    @cached_property
    def answers(self) -> Float64:
        """What was measured after each tick of each window, shape (w, l, m).

        Joint positions in [rad], and `BASE_ANSWERS` where the base was measured.
        """
        rows = self.starts[:, None] + np.arange(1, self.length + 1)
        parts = [np.asarray(self.measured["joint_pos"][rows], np.float64)]
        if self.has_base:
            rate = np.asarray(self.measured["base_ang_vel"], np.float64)
            here, before = (rotation(self.measured["base_quat"][each]) for each in (rows, rows - 1))
            turn = before.swapaxes(-1, -2) @ here
            turn = 0.5 * (turn - turn.swapaxes(-1, -2))[..., [2, 0, 1], [1, 2, 0]] / self.period
            parts += [gravity_xy(self.measured["base_quat"][rows]), rate[rows]]
            above = 0.5 * (rate[rows] + rate[rows - 1]) - turn
            # Within a window it swings with the gait.
            parts += [np.broadcast_to(above.mean(axis=1, keepdims=True), above.shape)]
        return np.concatenate(parts, axis=-1)


def _fallen(states: Mapping[str, Array]) -> Bool:
    gravity = states.get("projected_gravity")
    if gravity is None or np.ptp(gravity) == 0.0:
        return np.zeros(len(states["joint_pos"]), np.bool_)
    fallen: Bool = np.maximum.accumulate(-gravity[:, 2] < np.cos(FALLEN))
    return fallen


def recorded_names(layout: Layout) -> list[str]:
    """Return the states that a motion takes, as far as a layout has them and none is estimated."""
    names = (*PLACE, *COMMAND_STATES, "projected_gravity")
    estimated = {"base_lin_vel"} if "base_lin_vel_variance" in layout.slots else set[str]()
    return [name for name in names if name in layout.slots and name not in estimated]


def motion_of(record: Record, where: str, window: float = 0.2) -> Motion:
    """Return the motion of a record.

    Raises:
        UniconError: it is of many robots, or has too few ticks in which joints move.
    """
    layout = record.layout
    if layout.num_robots is not None:
        raise UniconError(f"{where} is of {layout.num_robots} robots; record one on its own")
    period = record.period
    if period > 1.0:
        raise UniconError(f"{where} ticks every {period:g} s; a fit needs ticks of at most 1 s")
    states = {name: record.states(name) for name in recorded_names(layout)}
    ticks = np.asarray(record.ticks)
    usable = np.asarray(record.ended, np.bool_).copy()
    usable[1:] &= np.diff(ticks) == 1
    try:
        return Motion.of(states, period, usable, window)
    except UniconError as error:
        raise UniconError(f"{where}: {error}") from error
