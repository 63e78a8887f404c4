"""Identification from a record of ours: the joints under which its simulator does as the robot did.

found, text = fit_record(open_record("real.mcap"), "real.mcap")     # a Fit, and a robot overlay
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from unicon_base.errors import UniconError
from unicon_core.platforms.kit.disturbances import PLACE
from unicon_core.platforms.kit.scene import Scene
from unicon_core.robots import Robot, load_robot, robot_names
from unicon_core.robots.load import JOINT_PHYSICS
from unicon_core.states.standard import COMMAND_STATES
from unicon_lab.identify.fit import fit
from unicon_lab.identify.found import Fit, overlay_text
from unicon_lab.identify.replays import Motion
from unicon_lab.recording import Record
from unicon_lab.replay.workflow import recorded_workflow, robot_of


def fit_record(
    record: Record,
    where: str,
    *,
    robot: Robot | None = None,
    words: Sequence[str] = tuple(JOINT_PHYSICS),
    joints: Sequence[str] = ("*",),
    window: float = 0.2,
    processes: int = 0,
    tell: Callable[[str], None] = lambda text: None,
) -> tuple[Fit, str]:
    """Estimate figures of joints from a record; return the fit and the text of a robot overlay.

    Args:
        record: with the command states and what was measured.
        where: the record's name, for messages and the overlay's comment.
        robot: whose simulator is fitted; None for the record's.
        words: of `JOINT_PHYSICS`.
        joints: names and patterns.
        window: of a replay in [s].
        processes: at once; 0 for as many as there are cores.
        tell: takes a line for each round.

    Raises:
        UniconError: the record lacks something, or is of another robot.
    """
    said, folder = _workflow(record)
    robot = robot or _robot(record, said)
    specs = record.layout.specs
    names = specs["joint_pos"].names if "joint_pos" in specs else ()
    if tuple(names) != robot.joint_names:
        raise UniconError(
            f"{where} is of {record.facts.get('robot') or 'another robot'} with {len(names)} "
            f"joints, and robot {robot.name} has others: give that robot's file with --robot"
        )
    scene = said.get("scene") or {}
    model = scene.get("model") if isinstance(scene, dict) else None
    motion = motion_of(record, where, window)
    found = fit(
        motion,
        robot,
        scene=Scene(model=model, folder=folder),
        words=words,
        joints=joints,
        processes=processes or len(os.sched_getaffinity(0)),
        tell=tell,
    )
    extends = robot.name if robot.name in robot_names() else str(robot.path)
    return found, overlay_text(robot, extends, found, where)


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
    names = (*PLACE, *COMMAND_STATES, "projected_gravity")
    states: dict[str, Any] = {n: record.states(n) for n in names if n in layout.slots}
    ticks = np.asarray(record.ticks)
    usable = np.asarray(record.ended, np.bool_).copy()
    usable[1:] &= np.diff(ticks) == 1
    try:
        return Motion.of(states, period, usable, window)
    except UniconError as error:
        raise UniconError(f"{where}: {error}") from error


def _workflow(record: Record) -> tuple[dict[str, Any], Path | None]:
    """Return what the record says of its workflow, and the folder that it was in.

    Raises:
        WorkflowError: it is not YAML, or more of it than is read.
    """
    recorded = recorded_workflow(record)
    said = None if recorded is None else recorded.value
    path = record.facts.get("workflow_path")
    return (said if isinstance(said, dict) else {}), (Path(path).parent if path else None)


def _robot(record: Record, said: dict[str, Any]) -> Robot:
    if isinstance(said.get("robot"), dict):
        raise UniconError(
            f"{record.facts.get('robot')} is made of {', '.join(map(str, said['robot']))}, and an "
            "overlay extends one file: record a run of that robot alone"
        )
    try:
        return load_robot(robot_of(record))
    except UniconError as error:
        raise UniconError(f"{error}; give the robot with --robot") from error
