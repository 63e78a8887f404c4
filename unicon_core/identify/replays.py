"""Open-loop replays of a motion's windows in MuJoCo with given joints, in several processes."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.errors import Fault
from unicon_core.identify.motion import Motion
from unicon_core.platforms.kit.beside import Beside
from unicon_core.platforms.kit.scene import Scene
from unicon_core.platforms.platform import Resettable
from unicon_core.robots import Robot

Float = NDArray[np.float64]
Joints = Mapping[str, Mapping[str, float]]
"""Joint to figures, as of `scene.joints`."""

_WORST = np.pi
"""In [rad]: how far off a joint counts whose physics blew up."""


def replayed(robot: Robot, scene: Scene, motion: Motion, joints: Joints) -> Float:
    """Return the joint positions after each tick of each window, [rad], shape (w, l, n).

    A window begins where the robot was measured, with the command of the tick before on its way.
    """
    from unicon_core.platforms.sim.mujoco import make

    beside = Beside(make, robot, motion.period, replace(scene, joints=joints))
    found = np.empty((len(motion.starts), motion.length, robot.num_joints))
    try:
        for window, start in enumerate(motion.starts):
            _replay(beside, motion, int(start), found[window])
    finally:
        beside.close()
    return found


def _replay(beside: Beside, motion: Motion, start: int, out: Float) -> None:
    def commands(row: int) -> dict[str, NDArray[Any]]:
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


def _work(joints: Joints) -> Float:
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

    def __call__(self, sets: Sequence[Joints]) -> list[Float]:
        """Return what `replayed` returns for each set of joints."""
        if self._pool is None:
            return [replayed(*self._given, joints) for joints in sets]
        return list(self._pool.map(_work, sets))

    def __enter__(self) -> Replays:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)
