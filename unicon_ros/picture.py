"""Picture: what a run looked like, as one PNG beside its report, for `unicon run --picture`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.errors import MissingDependencyError, UniconError
from unicon_core.flow import Block, Stage

if TYPE_CHECKING:
    from unicon_core.workflow import Program

__all__ = ["Picture"]

CAPACITY = 200_000  # ticks, the first ones
_KEPT = ("base_pos_w", "base_lin_vel", "base_ang_vel", "velocity_command", "joint_pos")


class Picture:
    """Keeps a few states of every tick and draws them at the end.

    Args:
        path: of the PNG.

    Raises:
        MissingDependencyError: matplotlib is not installed.
    """

    def __init__(self, path: str | Path) -> None:
        try:
            import matplotlib  # noqa: F401 - said before the run, not after it
        except ModuleNotFoundError as error:
            raise MissingDependencyError(
                "--picture", "matplotlib", "pip install matplotlib"
            ) from error
        self.path = Path(path)
        self._rows: NDArray[np.float32] = np.zeros((0, 0), np.float32)
        self._count = 0
        self._columns: dict[str, slice] = {}
        self._joints: tuple[str, ...] = ()
        self._period = 0.0

    def hook(self, program: Program) -> dict[Stage, list[Block]]:
        """Return the block that keeps the states."""
        states = program.states
        views = [states[name] if states.num_robots is None else states[name][0] for name in _KEPT]
        start = 0
        for name, view in zip(_KEPT, views):
            self._columns[name] = slice(start, start + view.size)
            start += view.size
        self._rows = np.zeros((4096, start), np.float32)
        self._joints = program.robot.joint_names
        self._period = program.period
        places = [(self._columns[name], view) for name, view in zip(_KEPT, views)]

        def keep() -> None:
            if self._count == len(self._rows):
                if self._count >= CAPACITY:
                    return
                self._rows = np.concatenate([self._rows, np.zeros_like(self._rows)])
            row = self._rows[self._count]
            for place, view in places:
                row[place] = view
            self._count += 1

        return {Stage.OBSERVE: [Block("picture", keep, reads=_KEPT)]}

    def draw(self, title: str) -> None:
        """Write the PNG: base path, commanded and measured velocity, joint positions.

        Raises:
            UniconError: the file cannot be written.
        """
        from matplotlib import colormaps
        from matplotlib.figure import Figure

        rows = self._rows[: self._count]
        time = np.arange(self._count) * self._period

        def kept(name: str) -> Any:
            return rows[:, self._columns[name]]

        figure = Figure(figsize=(11.0, 7.5), layout="constrained")
        figure.suptitle(title)
        path, speeds, joints = figure.subplot_mosaic(
            [["path", "speeds"], ["joints", "joints"]], height_ratios=[1.2, 1.0]
        ).values()
        pos = kept("base_pos_w")
        path.plot(pos[:, 0], pos[:, 1])
        path.plot(pos[:1, 0], pos[:1, 1], "o", label="start")
        path.plot(pos[-1:, 0], pos[-1:, 1], "s", label="end")
        path.set(title="path of the base", xlabel="x [m]", ylabel="y [m]")
        path.set_aspect("equal", adjustable="datalim")
        path.legend()
        command, linear = kept("velocity_command"), kept("base_lin_vel")
        measured = (linear[:, 0], linear[:, 1], kept("base_ang_vel")[:, 2])
        for i, (label, values) in enumerate(zip(("vx [m/s]", "vy [m/s]", "wz [rad/s]"), measured)):
            speeds.plot(time, values, color=f"C{i}", linewidth=0.8, label=label)
            speeds.plot(time, command[:, i], color=f"C{i}", linestyle="--", linewidth=1.5)
        speeds.set(title="velocity: measured, dashed as commanded", xlabel="time [s]")
        speeds.legend(loc="upper right")
        # Matplotlib's own ten colours repeat: two joints would look like one.
        joints.set_prop_cycle(color=colormaps["turbo"](np.linspace(0.0, 1.0, len(self._joints))))
        joints.plot(time, kept("joint_pos"), linewidth=0.8, label=self._joints)
        joints.set(title="joint positions", xlabel="time [s]", ylabel="[rad]")
        if len(self._joints) <= 32:
            columns = 1 + (len(self._joints) - 1) // 16
            joints.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=7, ncols=columns)
        for axes in (path, speeds, joints):
            axes.grid(alpha=0.3)
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            figure.savefig(self.path, dpi=100)
        except OSError as error:
            raise UniconError(
                f"cannot write {self.path}: {error.strerror}; give a path in a writable folder"
            ) from error
