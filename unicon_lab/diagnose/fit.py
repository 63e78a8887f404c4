"""What stands on a diagnosis: a fit of a record's joints, and warnings beside a run.

A fit is an overlay for the robot file, with intervals. `unicon run --diagnose` finds causes in the
plant: a process of the lowest priority looks at the last ten seconds, and warns of a cause once. It
only warns: nothing of it goes into a command. Its parent is the run, with which it ends.
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from unicon_base import AnyDict, Fault, UniconError, alternatives, one_line
from unicon_core.platforms.kit.disturbances import Beside
from unicon_core.platforms.kit.scene import Scene
from unicon_core.robots import Robot, robot_names
from unicon_core.robots.load import JOINT_PHYSICS, joints_like
from unicon_core.runtime import Runner
from unicon_core.signals import SIGNALS
from unicon_lab.diagnose import Cause
from unicon_lab.diagnose.diagnosis import (
    Tell,
    cause_of,
    motion_in,
    places_of,
    plant_causes,
    processes_of,
    simulated,
    where_of,
)
from unicon_lab.diagnose.motion import MOVING, Motion, recorded_names
from unicon_lab.diagnose.plant import KINDS
from unicon_lab.diagnose.replays import Replays
from unicon_lab.diagnose.search import Search
from unicon_lab.recording import Record
from unicon_lab.view.shown import Shown
from unicon_lab.view.source import Remote, Source
from unicon_lab.view.view import Fed
from unicon_ros.attachments import Asked

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


NAME, SINK = "diagnose", "unicon_lab.diagnose.fit:Live"
SPAN = 10.0
"""Of the ticks that a verdict is about, in [s]; so long it also waits before it looks."""
PATIENCE = 60.0
"""For a verdict in [s]; after as long without one a line says why."""
WINDOWS = 25
"""That are replayed, every other one: a Go2's take 3 to 9 s of a core, and of 12 not all is found.
"""
SURE = 0.9
"""Probability from which on a cause is told."""
_BUSY = "this machine is too slow or too busy"


class Diagnosed(Fed):
    """Lets a process of its own diagnose a run; who made it closes it.

    Args:
        asked: of the run, whose simulator is as its robot file says, whatever the scene changes of
            joints, payload and friction. Of a batch the first robot is diagnosed.
    """

    label, interval, kept = NAME, 1.0, SPAN

    def __init__(self, asked: Asked) -> None:
        super().__init__(asked.warn, asked.session)
        model = asked.document.get("scene", {}).get("model")
        self._scene = Scene(model=model, folder=asked.document.path.parent)

    def attach(self, runner: Runner) -> None:
        """Start the process, before the first tick.

        Raises:
            UniconError: the robot cannot be simulated.
        """
        self.warn = runner.program.tell  # the lines of a viewer, too
        self._start(runner, {"sink": SINK, "scene": self._scene}).heard = self._heard

    def _heard(self, words: AnyDict) -> None:
        told = self._session and self._session.diagnostics
        if told:
            told.causes = words["causes"]


class Live:
    """The sink of `--diagnose`: one verdict after the other, in a thread; see the module.

    Args:
        shown: the run.
        source: its ticks.
        remote: nothing is sent by it.
        options: `scene` that is simulated, and `feed` that takes what is found.

    Raises:
        UniconError: the robot cannot be simulated.
    """

    address = "warns of causes that make it unlike its simulation"

    def __init__(self, shown: Shown, source: Source, remote: Remote, options: AnyDict) -> None:
        from unicon_core.platforms.mujoco import make

        self._shown, self._source = shown, source
        self._scene, self._feed = options["scene"], options["feed"]
        self._names = "tick", *recorded_names(shown.layout)
        # Says before the run what cannot be simulated.
        Beside(make, shown.robot, shown.period, self._scene).close()
        self._told: dict[str, Cause] = {}
        self._since, self._why = time.monotonic(), _BUSY
        self._pool = ThreadPoolExecutor(1, initializer=_yield_to_all)
        self._verdict = self._pool.submit(self._look)

    def poll(self) -> None:
        """Tell of a verdict that is there, or that there has been none for long."""
        now = time.monotonic()
        if self._verdict.done():
            try:
                self._tell(self._verdict.result())
                self._since, self._why = max(now, self._since), _BUSY
            except (Fault, UniconError) as error:
                self._why = one_line(error)
            self._verdict = self._pool.submit(self._look)
        if now - self._since > PATIENCE:
            self._since = math.inf  # once in a run
            self._feed.tell(f"{NAME}: no verdict within {PATIENCE:g} s: {self._why}")

    def close(self) -> None:
        """See `Sink`; the process ends at once, whatever its thread is at."""

    def _look(self) -> Sequence[Cause]:
        """Return the causes of what comes next.

        Raises:
            UniconError: the robot falls, or its ticks say too little.
        """
        time.sleep(SPAN)
        rows = [
            [each.states[name].copy() for name in self._names] for each in self._source.since(0)
        ]
        if not rows:
            raise UniconError("no tick came")
        states = {name: np.array(values) for name, values in zip(self._names, zip(*rows))}
        # No window bridges ticks that were overwritten.
        follows = np.diff(states["tick"].ravel(), prepend=-1) == 1
        motion = Motion.of(states, self._shown.period, follows, most=WINDOWS)
        return plant_causes(motion, self._shown.robot, self._scene, processes=1).causes

    def _tell(self, causes: Sequence[Cause]) -> None:
        words = dict[str, str]()
        for cause in causes:
            if cause.probability <= SURE:
                continue
            size, interval = cause.figures()
            names = " or ".join((cause.name, *cause.alike))
            words[f"cause {names}"] = text = f"{size} (95 %: {interval})"
            before = self._told.get(cause.name)
            if before is None or before.high < cause.low or cause.high < before.low:
                self._told[cause.name] = cause
                self._feed.tell(f"{NAME}: {names}: {text} from the simulation")
        self._feed.words(causes=words)


def _yield_to_all() -> None:
    with suppress(OSError, AttributeError):  # this thread alone: the other one answers the run
        os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
