"""`unicon run --diagnose`: causes in the plant, found in a process beside the run.

A process of the lowest priority looks at the last ten seconds, and warns of a cause once. It only
tells: nothing of it goes into a command. Its parent is the run, with which it ends.
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress

import numpy as np

from unicon_base import AnyDict, Fault, UniconError, one_line
from unicon_core.platforms.kit.disturbances import Beside
from unicon_core.platforms.kit.scene import Scene
from unicon_core.runtime import Runner
from unicon_lab.diagnose import Cause
from unicon_lab.diagnose.diagnosis import plant_causes
from unicon_lab.diagnose.motion import Motion, recorded_names
from unicon_lab.view.shown import Shown
from unicon_lab.view.source import Remote, Source
from unicon_lab.view.view import Fed
from unicon_ros.attachments import Asked

NAME, SINK = "diagnose", "unicon_lab.diagnose.live:Live"
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
        self._watch(runner, {"sink": SINK, "scene": self._scene}).heard = self._heard

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
