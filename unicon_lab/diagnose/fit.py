"""A fit of a record's joints: an overlay for the robot file, with intervals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from unicon_base import UniconError, alternatives
from unicon_core.robots import Robot, robot_names
from unicon_core.robots.load import JOINT_PHYSICS, joints_like
from unicon_core.signals import SIGNALS
from unicon_lab.diagnose import Cause
from unicon_lab.diagnose.diagnosis import (
    Tell,
    cause_of,
    motion_in,
    places_of,
    processes_of,
    simulated,
    where_of,
)
from unicon_lab.diagnose.motion import MOVING
from unicon_lab.diagnose.plant import KINDS
from unicon_lab.diagnose.replays import Replays
from unicon_lab.diagnose.search import Search
from unicon_lab.recording import Record

HELD_OUT = 4
"""Every fourth window is left out of `fit_record`, and tells whether the fit holds."""


@dataclass(frozen=True)
class Parameter:
    """One parameter of one joint.

    Attributes:
        joint: its name; `*` for all.
        word: `strength`, `friction`, `armature` or `delay`.
        before: as the robot's simulator has it.
        after: as it was estimated.
        deviation: half of the 95 % interval.
    """

    joint: str
    word: str
    before: float
    after: float
    deviation: float


@dataclass(frozen=True)
class Fit:
    """What was found of joints.

    Attributes:
        parameters: those that explain the motion; all others stay as they are.
        causes: what explains it besides, which is no parameter of joints.
        before, after: mean square error of the joints' replays in [rad²], windows of the fit.
        held_before, held_after: the same over windows that the fit has not seen.
        windows: of the fit, and held out.
    """

    parameters: tuple[Parameter, ...]
    causes: tuple[Cause, ...]
    before: float
    after: float
    held_before: float
    held_after: float
    windows: tuple[int, int]

    @property
    def better(self) -> bool:
        """Whether it holds for what the fit has not seen."""
        return self.held_after < self.held_before


def fit_record(
    record: Record,
    where: str,
    *,
    robot: Robot | None = None,
    hung: bool = False,
    words: Sequence[str] = tuple(JOINT_PHYSICS),
    joints: Sequence[str] = ("*",),
    window: float = 0.2,
    processes: int = 0,
    tell: Tell = lambda *_: None,
) -> tuple[Fit, str]:
    """Estimate parameters of joints from a record; return the fit and the text of a robot overlay.

    What is not a parameter of joints, such as a payload, is fitted beside them, so that no joint
    answers for it.

    Args:
        record: with the command states and what was measured.
        where: the record's name, for messages and the overlay's comment.
        robot: whose simulator is fitted; None for the record's.
        hung: the robot hung in the air, or its base was fixed.
        words: of `JOINT_PHYSICS`.
        joints: names and patterns.
        window: of a replay in [s].
        processes: at once; 0 for as many as there are cores.
        tell: takes lines of progress.

    Raises:
        UniconError: the record lacks something, or is of another robot; no such word or joint.
    """
    for word in words:
        if word not in JOINT_PHYSICS:
            known = alternatives(word, JOINT_PHYSICS)
            raise UniconError(f"no parameter {word!r} of joints; {known}")
    robot, scene = simulated(record, where, robot)
    which = sorted({i for pattern in joints for i in joints_like(pattern, robot)})
    if not which or not words:
        raise UniconError("nothing to estimate; name joints and parameters")
    motion, scene = motion_in(record, where, window, hung, robot, scene)
    if motion.still:
        raise UniconError(f"{where}: no joint moves by {MOVING} rad; record excite or a walk")
    held = np.arange(len(motion.starts)) % HELD_OUT == HELD_OUT - 1
    seen = replace(motion, starts=motion.starts[~held])
    apart = replace(motion, starts=motion.starts[held])
    others = [kind for kind in KINDS if not KINDS[kind].each]
    places = places_of(motion, robot, which, dict.fromkeys([*words, *others]))
    with SIGNALS.guard(), Replays(robot, scene, seen, processes_of(processes)) as replays:
        found = Search(seen, places, replays.plant.limbs, replays, tell).go()
        own = replays.plant.own
    with Replays(robot, scene, apart, 1) as replays:
        real = apart.answers[..., : robot.num_joints]
        held_before, held_after = (
            float(((real - answers[..., : robot.num_joints]) ** 2).mean())
            for change in ({}, found.change)
            for answers in replays([change], [replays.settle(change)])
        )
    parameters, causes = [], []
    for (kind, joint), alike in found.causes:
        if kind not in JOINT_PHYSICS:
            causes.append(cause_of(found, (kind, joint), alike, robot, own, seen))
            continue
        before = float(own[kind][max(joint, 0)])
        after = before + found.change[kind, joint]
        half = found.deviation[kind, joint]
        parameters.append(Parameter(where_of(joint, robot) or "*", kind, before, after, half))

    result = Fit(
        parameters=tuple(parameters),
        causes=tuple(causes),
        before=found.before,
        after=found.after,
        held_before=held_before,
        held_after=held_after,
        windows=(len(seen.starts), len(apart.starts)),
    )
    extends = robot.name if robot.name in robot_names() else str(robot.path)
    return result, overlay_text(robot, extends, result, where)


def overlay_text(robot: Robot, extends: str, found: Fit, where: str) -> str:
    """Return the text of an overlay.

    Args:
        robot: that was fitted; what it says under `simulated` stays.
        extends: name or path of the robot file that is extended.
        found: the fit.
        where: from which it was made, for a comment.
    """
    joints = {name: dict(words) for name, words in robot.simulated.items()}
    intervals: dict[str, list[str]] = {}
    for each in found.parameters:
        joints.setdefault(each.joint, {})[each.word] = each.after
        intervals.setdefault(each.joint, []).append(f"{each.word} ±{each.deviation:.2g}")
    lines = [
        f"# Written by unicon analyze --fit {where}",
        "# mean square error of windows that the fit has not seen: "
        f"{found.held_before:.4g} before, {found.held_after:.4g} rad² after",
        "schema: unicon.robot/1",
        f"extends: {extends}",
        "simulated:" if joints else "simulated: {}",
    ]
    for name, words in joints.items():
        said = ", ".join(f"{word}: {value:.4g}" for word, value in words.items())
        comment = f"   # 95 %: {', '.join(intervals[name])}" if name in intervals else ""
        lines.append(f'  "{name}": {{{said}}}{comment}')
    return "\n".join(lines) + "\n"
