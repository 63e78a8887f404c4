"""Motion: a recorded run cut into windows; its open-loop replays in MuJoCo with given joints."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from unicon_base.arrays import Array, Bool, Float64, Int64
from unicon_base.errors import Fault, UniconError
from unicon_core.platforms.kit.disturbances import PLACE, Beside
from unicon_core.platforms.kit.scene import Scene
from unicon_core.platforms.platform import Resettable
from unicon_core.robots import Robot
from unicon_core.states.standard import COMMAND_STATES

FEWEST = 8
"""Windows: with less there is nothing to hold a fit against."""
FALLEN = 0.5
"""Lean in [rad] from which on a walking robot falls: what comes then is not its joints' doing."""


@dataclass(frozen=True, eq=False)
class Motion:
    """A recorded run.

    Attributes:
        period: of a tick in [s].
        measured: of `PLACE`, those that were measured, each of shape (ticks, …).
        commands: the command states, each of shape (ticks, n).
        starts: first tick of each window, shape (windows,).
        length: ticks of a window; `measured` has one more behind it, of the same run.
    """

    period: float
    measured: Mapping[str, Array]
    commands: Mapping[str, Array]
    starts: Int64
    length: int

    @staticmethod
    def of(
        states: Mapping[str, Array],
        period: float,
        usable: Bool,
        window: float = 0.2,
        most: int = 200,
    ) -> Motion:
        """Cut a run into windows that overlap by half.

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
                f"identification needs {lacking[0]}, which was not recorded; record with "
                "unicon run --record"
            )
        length = max(round(window / period), 2)
        measured = {name: states[name] for name in PLACE if name in states}
        for name in PLACE[2:]:  # what nobody measured stands still, to the bit
            if name in measured and np.ptp(measured[name], axis=0).max(initial=0.0) == 0.0:
                del measured[name]
        commands = {name: states[name] for name in COMMAND_STATES}
        good = usable & ~_fallen(states)
        for values in (*measured.values(), *commands.values()):
            good &= np.isfinite(values).reshape(len(values), -1).all(axis=1)
        moved = np.ptp(states["joint_pos"][good], axis=0).max(initial=0.0) if good.any() else 0.0
        runs = np.convolve(good, np.ones(length + 2), "valid") > length + 1.5
        starts = np.flatnonzero(runs)[:: max(length // 2, 1)] + 1  # a tick before, for delays
        if len(starts) < FEWEST or moved < 0.02:
            raise UniconError(
                f"identification needs at least {FEWEST} windows of {length * period:g} s in which "
                f"joints move; the run has {len(starts)}, and joints move by {moved:.3f} rad; "
                "record a longer run, or one with excite"
            )
        if len(starts) > most:
            starts = starts[np.linspace(0, len(starts) - 1, most).round().astype(int)]
        return Motion(period, measured, commands, starts, length)

    @property
    def answers(self) -> Float64:
        """Measured joint positions in [rad] after each tick of each window, shape (w, l, n)."""
        rows = self.starts[:, None] + np.arange(1, self.length + 1)
        return np.asarray(self.measured["joint_pos"][rows], np.float64)


def _fallen(states: Mapping[str, Array]) -> Bool:
    gravity = states.get("projected_gravity")
    if gravity is None or np.ptp(gravity) == 0.0:
        return np.zeros(len(states["joint_pos"]), np.bool_)
    fallen: Bool = np.maximum.accumulate(-gravity[:, 2] < np.cos(FALLEN))
    return fallen


Joints = Mapping[str, Mapping[str, float]]
"""Joint to figures, as of `scene.joints`."""

# In [rad]: how far off a joint counts whose physics blew up.
_WORST = np.pi


def replayed(robot: Robot, scene: Scene, motion: Motion, joints: Joints) -> Float64:
    """Return the joint positions after each tick of each window, [rad], shape (w, l, n).

    A window begins where the robot was measured, with the command of the tick before on its way.
    """
    from unicon_core.platforms.mujoco import make

    beside = Beside(make, robot, motion.period, replace(scene, joints=joints))
    found = np.empty((len(motion.starts), motion.length, robot.num_joints))
    try:
        for window, start in enumerate(motion.starts):
            _replay(beside, motion, int(start), found[window])
    finally:
        beside.close()
    return found


def _replay(beside: Beside, motion: Motion, start: int, out: Float64) -> None:
    def commands(row: int) -> dict[str, Array]:
        return {name: values[row] for name, values in motion.commands.items()}

    def put() -> None:
        beside.put({name: values[start] for name, values in motion.measured.items()})

    try:
        put()
        beside.step(commands(start - 1))
        put()
        for tick in range(motion.length):
            out[tick] = beside.step(commands(start + tick))
    except Fault:
        out[...] = motion.measured["joint_pos"][start] + _WORST
        assert isinstance(beside.platform, Resettable)
        beside.platform.reset()


_given: tuple[Robot, Scene, Motion] | None = None


def _begin(robot: Robot, scene: Scene, motion: Motion) -> None:
    global _given
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's, which ends this one
    _given = robot, scene, motion


def _work(joints: Joints) -> Float64:
    assert _given is not None
    return replayed(*_given, joints)


class Replays:
    """Replays many sets of joints; a context, which ends its processes.

    Args:
        robot: the robot.
        scene: its model.
        motion: what is replayed.
        processes: at once; 1 stays in this one.
    """

    def __init__(self, robot: Robot, scene: Scene, motion: Motion, processes: int) -> None:
        self._given = robot, scene, motion
        self._pool: ProcessPoolExecutor | None = None
        if processes > 1:
            # Not forked: this process may have threads, of ROS or of a network's runtime.
            context = multiprocessing.get_context("spawn")
            self._pool = ProcessPoolExecutor(processes, context, _begin, self._given)

    def __call__(self, sets: Sequence[Joints]) -> list[Float64]:
        """Return what `replayed` returns for each set of joints."""
        if self._pool is None:
            return [replayed(*self._given, joints) for joints in sets]
        return list(self._pool.map(_work, sets))

    def __enter__(self) -> Replays:
        return self

    def __exit__(self, *_: object) -> None:
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)
