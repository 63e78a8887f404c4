"""`unicon run --diagnose`: causes in the plant, found in a process beside the run.

A process of the lowest priority looks at the last ten seconds, and warns of a cause once. It only
tells: nothing of it goes into a command. Its parent is the run, with which it ends.
"""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import suppress
from typing import Any

import numpy as np

from unicon_base.errors import Fault, UniconError, one_line
from unicon_core.handles import FrameRing
from unicon_core.platforms.kit.disturbances import Beside
from unicon_core.platforms.kit.scene import Scene
from unicon_core.runtime import Runner
from unicon_core.states import States
from unicon_lab.diagnose import Cause
from unicon_lab.diagnose.diagnosis import plant_causes
from unicon_lab.diagnose.motion import Motion, recorded_names
from unicon_lab.view.process import NICE
from unicon_lab.view.shown import Shown
from unicon_lab.view.source import LiveSource
from unicon_lab.view.view import Fed
from unicon_ros.attachments import Asked
from unicon_ros.peripheral import Peripheral, peripheral_states
from unicon_ros.peripheral_process import SLICE, Feed, end, serve

NAME = "diagnose"
SPAN = 10.0
"""Of the ticks that a verdict is about, in [s]; so long it also waits before it looks."""
PATIENCE = 60.0
"""For a verdict in [s]; after as long without one a line says why."""
WINDOWS = 25
"""That are replayed, every other one: a Go2's take 3 to 9 s of a core, and of 12 not all is found.
"""
MOVING = 0.15
"""Of the joint that moves most, in [rad]: noisy sensors of a robot that stands seem friction."""
SURE = 0.9
"""Probability from which on a cause is told."""
_BUSY = "this machine is too slow, or too busy with other work"
_STILL = "the robot stands or has fallen, or the run ticks too slowly"


class Diagnosed(Fed):
    """Lets a process of its own diagnose a run; who made it closes it.

    Args:
        asked: of the run, whose simulator is as its workflow and robot file say, but for what a
            workflow's scene changes of joints, payload and friction.
    """

    label, interval, kept, module = NAME, 1.0, SPAN, __name__

    def __init__(self, asked: Asked) -> None:
        super().__init__(asked.warn, asked.session)
        model = asked.document.get("scene", {}).get("model")
        self._scene = Scene(model=model, folder=asked.document.path.parent)

    def attach(self, runner: Runner) -> None:
        """Start the process, before the first tick.

        Raises:
            UniconError: the robot cannot be simulated, or there are many.
        """
        if runner.program.states.num_robots is not None:
            raise UniconError("--diagnose is for one robot; leave it or num_robots out")
        self.warn = runner.program.tell  # the lines of a viewer, too
        told, options = States(peripheral_states(NAME, {})), {"scene": self._scene}
        process = self._start(runner, NAME, told, options, self, self, self.interval, self.interval)
        process.heard = self._heard

    def _heard(self, words: dict[str, Any]) -> None:
        if self._session is not None and self._session.diagnostics is not None:
            self._session.diagnostics.causes = words["causes"]

    def _tell(self, peripheral: Peripheral) -> bool:
        return peripheral()


class Live:
    """The device of `serve`: a verdict after the other, in a thread; see the module."""

    def __init__(self, feed: Feed) -> None:
        from unicon_core.platforms.mujoco import make

        os.setpriority(os.PRIO_PGRP, 0, NICE)  # libraries may have threads already
        shown: Shown = feed.data["shown"]
        self._feed, self._shown, self._scene = feed, shown, feed.options["scene"]
        self._source = LiveSource(shown.layout, FrameRing.attach(feed.data["ring"]))
        self._names = "tick", *recorded_names(shown.layout)
        # Says before the run what cannot be simulated.
        Beside(make, shown.robot, shown.period, self._scene).close()
        self._told, self._late = dict[str, Cause](), {""}
        self._words: dict[str, str] = {}
        self._since = self._began = time.monotonic()
        self._pool = ThreadPoolExecutor(1, initializer=_yield_to_all)
        self._verdict = self._pool.submit(self._look)

    def first(self) -> dict[str, Any]:
        """Return what the operator's line says."""
        return {"address": f"warns within {PATIENCE:g} s of what becomes unlike the simulation"}

    def poll(self) -> None:
        """Tell of a verdict that is there, or that there has been none for long."""
        wait([self._verdict], SLICE)
        now = time.monotonic()
        why = _BUSY if now - self._began > PATIENCE else ""
        if self._verdict.done():
            try:
                self._tell(self._verdict.result())
                self._since = now
            except (Fault, UniconError) as error:
                why = one_line(error)
            self._began, self._verdict = now, self._pool.submit(self._look)
        if why not in self._late and now - self._since > PATIENCE:
            self._late.add(why)
            self._feed.tell(f"{NAME}: no verdict within {PATIENCE:g} s: {why}")

    def close(self) -> None:
        """See `Device`; the process ends at once, whatever its thread is at."""

    def _look(self) -> Sequence[Cause]:
        """Return the causes of what comes next.

        Raises:
            UniconError: the robot stands, or falls.
        """
        time.sleep(SPAN)
        rows = [
            [each.states[name].copy() for name in self._names] for each in self._source.since(0)
        ]
        states = {name: np.array(values) for name, values in zip(self._names, zip(*rows))}
        if not rows or np.ptp(states["joint_pos"], axis=0).max() < MOVING:
            raise UniconError(_STILL)
        # No window bridges ticks that were overwritten.
        follows = np.diff(states["tick"].ravel(), prepend=-1) == 1
        try:
            motion = Motion.of(states, self._shown.period, follows, most=WINDOWS)
        except UniconError as error:
            raise UniconError(_STILL) from error
        return plant_causes(motion, self._shown.robot, self._scene, processes=1).causes

    def _tell(self, causes: Sequence[Cause]) -> None:
        words = dict[str, str]()
        for cause in causes:
            if cause.probability <= SURE:
                continue
            size, interval = cause.figures()
            names = " or ".join((cause.name, *cause.alike))
            words[names] = text = f"{size} (95 %: {interval})"
            before = self._told.get(cause.name)
            if before is None or before.high < cause.low or cause.high < before.low:
                self._told[cause.name] = cause
                self._feed.tell(f"{NAME}: {names}: {text} from the simulation")
        if words != self._words:  # a run that pauses hears nothing, and a pipe gets full
            self._words = words
            self._feed.words(causes=words)


def _yield_to_all() -> None:
    with suppress(OSError, AttributeError):  # this thread alone: the other one answers the run
        os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))


if __name__ == "__main__":
    end(serve(Live))
