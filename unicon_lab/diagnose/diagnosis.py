"""Diagnosis of a record: causes with probability, size and remedy; and a fit of its joints.

found = diagnose(open_record("real.mcap"), "real.mcap")
for cause in found.causes:
    print(cause.name, cause.probability, cause.size, cause.remedy)
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from unicon_base.arrays import Float64
from unicon_base.errors import UniconError, alternatives
from unicon_core.platforms.kit.scene import Scene
from unicon_core.policies import PolicyContract
from unicon_core.robots import Robot, load_robot, robot_names
from unicon_core.robots.load import JOINT_PHYSICS, joints_like
from unicon_core.signals import SIGNALS, Interrupted
from unicon_lab.diagnose import Cause, Diagnosis, name_of
from unicon_lab.diagnose.contract import contract_causes
from unicon_lab.diagnose.motion import HUNG_HEIGHT, Motion, motion_of
from unicon_lab.diagnose.plant import KINDS, OF_BASE, Place
from unicon_lab.diagnose.replays import Replays
from unicon_lab.diagnose.search import Found, Search
from unicon_lab.recording import Record
from unicon_lab.replay.workflow import recorded_workflow, robot_of

MOST = {16: 100, 200: 60}
"""Windows that are replayed, by the number of joints up to which: a G1's take three times as
long."""

HELD_OUT = 4
"""Every fourth window is left out of `fit_record`, and tells whether the fit holds."""

Tell = Callable[..., object]
"""Takes a line of progress; with a share from 0 to 1, how much of that is done."""


def diagnose(
    record: Record,
    where: str,
    *,
    contracts: Sequence[PolicyContract] | None = None,
    robot: Robot | None = None,
    reference: Record | None = None,
    hung: bool = False,
    window: float = 0.2,
    processes: int = 0,
    tell: Tell = lambda *_: None,
) -> Diagnosis:
    """Return what differs from the contract, then the causes in the plant.

    Args:
        record: with the command states and what was measured.
        where: the record's name, for messages.
        contracts: that are given; None for those of the recorded workflow, as their files are now.
        robot: whose simulator is compared; None for the record's.
        reference: of the same robot without the trouble: what its simulator lacks in both is no
            cause. None where the simulator is like the healthy robot.
        hung: the robot hung in the air, or its base was fixed.
        window: of a replay in [s].
        processes: at once; 0 for as many as there are cores.
        tell: takes lines of progress, and the share that is done of what a line says.

    Raises:
        UniconError: a record lacks something, or is of another robot.
    """
    robot, scene = _simulated(record, where, robot)
    causes, notes = list[Cause](), list[str]()
    for contract in [None] if contracts is None else contracts:
        found, more = contract_causes(record, where, contract, tell)
        causes, notes = causes + found, notes + more
    motion, scene = _motion(record, where, window, hung, robot, scene)
    healthy = None
    if reference is not None:
        _simulated(reference, "the reference", robot)
        healthy, _ = _motion(reference, "the reference", window, hung, robot, scene)
        if healthy.has_base != motion.has_base:
            raise UniconError(
                f"one of {where} and the reference has no base_quat and base_ang_vel; record both"
            )
    plant = plant_causes(motion, robot, scene, healthy, processes, tell)
    return replace(plant, causes=(*causes, *plant.causes), notes=(*notes, *plant.notes))


def plant_causes(
    motion: Motion,
    robot: Robot,
    scene: Scene,
    healthy: Motion | None = None,
    processes: int = 0,
    tell: Tell = lambda *_: None,
) -> Diagnosis:
    """Return the causes in the plant alone.

    Args:
        motion: of the robot.
        robot: whose simulator is compared.
        scene: in which it is simulated.
        healthy: motion of the same robot without the trouble, or None.
        processes, tell: as of `diagnose`.
    """
    notes = [] if motion.has_base else [_NO_BASE]
    places = _places(motion, robot, range(robot.num_joints), KINDS)
    found, own, count = Found(), dict[str, Float64](), _processes(processes)
    base, wider = dict[Place, float](), 1.0
    with SIGNALS.guard():
        try:
            if healthy is not None:
                progress = _share(tell, "the reference")
                with Replays(robot, scene, healthy, count, progress) as replays:
                    limbs = replays.plant.limbs
                    base = Search(healthy, places, limbs, replays, tell).level()
                wider = math.sqrt(1.0 + len(motion.starts) / len(healthy.starts))
            with Replays(robot, scene, motion, count, _share(tell, "the plant")) as replays:
                replays.base, own = base, replays.plant.own
                search = Search(motion, places, replays.plant.limbs, replays, tell, wider)
                found = search.found
                search.go()
        except Interrupted:
            notes.append("interrupted: causes that come later are not known")
    causes = (_cause(found, place, alike, robot, own) for place, alike in found.causes)
    return Diagnosis(tuple(causes), tuple(notes), len(motion.starts), found.complete)


def _share(tell: Tell, what: str) -> Callable[[float], None]:
    return lambda share: tell(what, share)


_NO_BASE = (
    "attitude and turn rate of the base were not recorded: payload, centre of mass, inertia, gyro "
    "and IMU mounting are not examined"
)


def _motion(
    record: Record, where: str, window: float, hung: bool, robot: Robot, scene: Scene
) -> tuple[Motion, Scene]:
    """Return the motion of a record, and the scene in which it is replayed."""
    motion = _thinned(motion_of(record, where, window), robot)
    if not hung:
        return motion, scene
    return motion.hung_up(), replace(scene, gantry=True, initial_height=HUNG_HEIGHT)


def _thinned(motion: Motion, robot: Robot) -> Motion:
    most = next(most for joints, most in MOST.items() if robot.num_joints <= joints)
    count = len(motion.starts)
    if count <= most:
        return motion
    return replace(
        motion, starts=motion.starts[np.linspace(0, count - 1, most).round().astype(int)]
    )


def _processes(asked: int) -> int:
    return asked or len(os.sched_getaffinity(0))


def _places(
    motion: Motion, robot: Robot, joints: Sequence[int], kinds: Sequence[str] | Any
) -> list[Place]:
    """Return what may differ: all joints alike, each, and the base where it was measured."""
    kinds = [kind for kind in kinds if motion.has_base or kind not in OF_BASE]
    whole = [(kind, -1) for kind in kinds if len(joints) == robot.num_joints]
    return whole + [(kind, joint) for kind in kinds if KINDS[kind].each for joint in joints]


def _cause(
    found: Found, place: Place, alike: Sequence[Place], robot: Robot, own: dict[str, Float64]
) -> Cause:
    kind, joint = place
    size, half = found.change[place], found.deviation[place]
    before = float(own[kind][max(joint, 0)]) if kind in own else 1.0
    explained = 1.0 - found.after / max(found.before, 1e-30)
    words = {"size": size, "after": before + size, "joint": _where(joint, robot) or "*"}
    return Cause(
        kind=kind,
        where=_where(joint, robot),
        layer="plant",
        probability=found.probability[place],
        size=size,
        low=size - half,
        high=size + half,
        unit=KINDS[kind].unit,
        evidence=f"replays of {found.before**0.5:.2g} rad RMS error in the joints; all causes "
        f"together explain {explained:.0%} of its square",
        remedy=KINDS[kind].remedy.format(**words),
        alike=tuple(name_of(other, _where(j, robot)) for other, j in alike),
    )


def _where(joint: int, robot: Robot) -> str:
    return robot.joint_names[joint] if joint >= 0 else ""


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
    robot, scene = _simulated(record, where, robot)
    which = sorted({i for pattern in joints for i in joints_like(pattern, robot)})
    if not which or not words:
        raise UniconError("nothing to estimate; name joints and parameters")
    motion, scene = _motion(record, where, window, hung, robot, scene)
    held = np.arange(len(motion.starts)) % HELD_OUT == HELD_OUT - 1
    seen = replace(motion, starts=motion.starts[~held])
    apart = replace(motion, starts=motion.starts[held])
    others = [kind for kind in KINDS if not KINDS[kind].each]
    places = _places(motion, robot, which, words)
    places += [(kind, -1) for kind in others if motion.has_base or kind not in OF_BASE]
    with SIGNALS.guard(), Replays(robot, scene, seen, _processes(processes)) as replays:
        found = Search(seen, list(dict.fromkeys(places)), replays.plant.limbs, replays, tell).go()
        own = replays.plant.own
    with Replays(robot, scene, apart, 1) as replays:
        real = apart.answers[..., : robot.num_joints]
        held_before, held_after = (
            float(((real - answers[..., : robot.num_joints]) ** 2).mean())
            for answers in replays([{}, found.change])
        )
    parameters, causes = [], []
    for (kind, joint), alike in found.causes:
        if kind not in JOINT_PHYSICS:
            causes.append(_cause(found, (kind, joint), alike, robot, own))
            continue
        before = float(own[kind][max(joint, 0)])
        after = before + found.change[kind, joint]
        half = found.deviation[kind, joint]
        parameters.append(Parameter(_where(joint, robot) or "*", kind, before, after, half))

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


def _simulated(record: Record, where: str, robot: Robot | None) -> tuple[Robot, Scene]:
    """Return the robot whose simulator a record is compared with, and its scene.

    Raises:
        UniconError: the record is of another robot, or of several in one.
    """
    recorded = recorded_workflow(record)
    said: dict[str, Any] = recorded.value if recorded and isinstance(recorded.value, dict) else {}
    if robot is None and isinstance(said.get("robot"), dict):
        raise UniconError(
            f"{record.facts.get('robot')} is made of {', '.join(map(str, said['robot']))}, and an "
            "overlay extends one file: record a run of that robot alone"
        )
    try:
        robot = robot or load_robot(robot_of(record))
    except UniconError as error:
        raise UniconError(f"{error}; give the robot with --robot") from error
    specs = record.layout.specs
    names = specs["joint_pos"].names if "joint_pos" in specs else ()
    if tuple(names) != robot.joint_names:
        raise UniconError(
            f"{where} is of {record.facts.get('robot') or 'another robot'} with {len(names)} "
            f"joints, and robot {robot.name} has others: give that robot's file with --robot"
        )
    scene = said.get("scene") or {}
    path = record.facts.get("workflow_path")
    model = scene.get("model") if isinstance(scene, dict) else None
    return robot, Scene(model=model, folder=Path(path).parent if path else None)
