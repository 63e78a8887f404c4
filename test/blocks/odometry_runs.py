"""Runs of workflows in which `leg_odometry` is held against what the simulator knows."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from unicon_core.flow import Block, Stage
from unicon_core.runtime import Report, Runner, RunOptions
from unicon_core.workflow import HookBlocks, Program, load_workflow

Float = NDArray[np.float64]

# Standard deviations in [rad], [rad/s], [rad/s], [m/s²] and of a quaternion's elements.
NOISE = {
    "joint_pos": 0.005,
    "joint_vel": 0.25,
    "base_ang_vel": 0.05,
    "base_lin_acc": 0.3,
    "base_quat": 0.005,
}


class Odometry(NamedTuple):
    """A run: what was so, and what was estimated, tick by tick."""

    report: Report
    # Of `base_lin_vel` in [m/s], shape (ticks, 3).
    truth: Float
    estimate: Float
    # As told, in [m²/s²], shape (ticks,).
    variance: Float
    # True position in [m], shape (ticks, 3).
    place: Float
    contact: Float

    @property
    def error(self) -> Float:
        """Length of the error of each tick in [m/s], shape (ticks,)."""
        return np.asarray(np.linalg.norm(self.estimate - self.truth, axis=1))

    @property
    def rms(self) -> float:
        """Of the error's length in [m/s]."""
        return float(np.sqrt((self.error**2).mean()))


def run(workflow, changes, seconds, spoil=None):
    """Run a workflow as fast as it goes, with what spoils the sensors behind recv.

    Args:
        changes: of the workflow.
        seconds: of ticks.
        spoil: changes states before they are read; gets the number of the tick.
    """
    seen: dict[str, list[Any]] = {}

    def keep(name: str, value: Any) -> None:
        seen.setdefault(name, []).append(np.array(value, np.float64))

    def hook(program: Program) -> HookBlocks:
        states = program.states

        def before() -> None:
            keep("truth", states["base_lin_vel"])
            keep("place", states["base_pos_w"])
            if spoil is not None:
                spoil(states, int(states["tick"]))

        def after() -> None:
            keep("estimate", states["base_lin_vel"])
            keep("variance", states["base_lin_vel_variance"])
            keep("contact", states["foot_contact"])

        looked = ("base_lin_vel", "base_lin_vel_variance", "foot_contact")
        return {
            Stage.RECV: [Block("before", before, endless=True)],
            Stage.OBSERVE: [Block("after", after, reads=looked, endless=True)],
        }

    program = load_workflow(workflow, changes, hooks=[hook])
    options = RunOptions(duration=seconds, speed="max", warn=lambda _: None)
    report = Runner(program, options).run()
    ticks = len(seen["estimate"])
    return Odometry(
        report,
        *(np.array(seen[name][:ticks]) for name in ("truth", "estimate", "variance", "place")),
        np.array(seen["contact"]),
    )
