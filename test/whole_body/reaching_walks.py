"""How far a robot's hands are from their targets while it walks, seed by seed."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from unicon_core.flow import Amends, Block, Reads, Stage, Tick
from unicon_core.models.frames import Frames
from unicon_core.models.load import load_model
from unicon_core.platforms.mujoco.platform import MujocoPlatform
from unicon_core.runtime import Report, Runner, RunOptions
from unicon_core.workflow import Program, load_workflow
from unicon_core.workflow.document import load_document

HANDS = ("left_hand", "right_hand")
BEGUN = 3.0
"""In [s]: arms have come to their targets, and circles have their size."""
NOISE = (
    "scene.noise={joint_pos: 0.002, joint_vel: 0.1, base_ang_vel: 0.05, projected_gravity: 0.02}"
)


def under(policy: str) -> list[str]:
    """Return what makes `g1_reach` walk under the policy of another workflow."""
    said = load_document(policy).values["policies"]["walk"]
    return [f"policies.walk={json.dumps(said)}"]


def lost(
    left_hand_target: Amends, right_hand_target: Amends, tick: Reads, *, begin: int, end: int
) -> Tick:
    """Take the targets away between two ticks."""

    def lose() -> None:
        if begin <= tick < end:
            left_hand_target[...] = right_hand_target[...] = np.nan

    return lose


class TrueErrors:
    """Looks where the simulated hands are, in every tick behind the targets, without noise."""

    def __init__(self, program: Program) -> None:
        platform, robot = program.platform, program.robot
        assert isinstance(platform, MujocoPlatform)
        loaded = load_model(platform.model_path, robot, quiet=True)
        self._frames = Frames(loaded, robot, {hand: robot.end_effectors[hand] for hand in HANDS})
        self._qpos, self._joints = platform.data.qpos, loaded.addresses
        self._targets = [program.states[f"{hand}_target"] for hand in HANDS]
        self.found: list[list[float]] = []

    def __call__(self) -> None:
        poses = self._frames.of(self._qpos[self._joints]).values()
        off = [pose[:3] - target[:3] for pose, target in zip(poses, self._targets)]
        self.found.append([float(np.linalg.norm(each)) for each in off])


@dataclass(frozen=True)
class Walk:
    """A run and the errors of both hands in [m] since `BEGUN`, shape (ticks, 2)."""

    report: Report
    errors: NDArray[np.float64]

    @property
    def figures(self) -> tuple[float, float, float]:
        """p50, p95 and the largest in [mm]."""
        p50, p95, most = np.percentile(self.errors * 1e3, (50.0, 95.0, 100.0))
        return float(p50), float(p95), float(most)


def walk(overrides: Sequence[str] = (), duration: float = 20.0, seed: int = 0) -> Walk:
    """Run `g1_reach`, with noise, and look at the hands."""
    kept: list[TrueErrors] = []

    def look(program: Program) -> Mapping[Stage, Sequence[Block]]:
        kept.append(TrueErrors(program))
        return {Stage.INPUT: [Block("look", kept[0], endless=True)]}

    more = [NOISE, f"scene.seed={seed}", *overrides]
    program = load_workflow("g1_reach", more, hooks=[look])
    options = RunOptions(duration=duration, speed="max", warn=lambda _: None)
    report = Runner(program, options).run()
    errors = np.array(kept[0].found)[round(BEGUN / program.period) :]
    return Walk(report, errors)
