"""CommandLog: what an emulated robot saw of its commands, as JSON lines, for tests and users.

| kind | says |
|---|---|
| `ready` | it is there: robot, rate [Hz], model, posture, `command` that reaches it or `refused` |
| `first` | how far the first command, and each after a silence, was from where joints were, [rad] |
| `command` | every command, where that was asked for, with its largest stiffness, [N·m/rad] |
| `commands` | after every 50 of them: how many, the largest distance and step between two, [rad] |
| `ignored` | the first command of some that came while the robot does not obey |
| `refused` | the same of commands that are not finite |
| `silence` | no command has come for a while |
| `late` | frames of the last second that a busy machine missed; the robot's time stood still then |
| `let go` | the gantry holds it no longer |
| `damping` | no joint has stiffness any more, `by` a command or the robot's own dead man |
| `ended` | frames that were, those that a busy machine missed, and how far the base moved, [m] |

`after` is the time of Python's `time.monotonic`, `silent` how long no command has come, in [s].
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from unicon_base.arrays import Float32
from unicon_core.states import States

Say = Callable[..., None]

TOLD_EVERY = 50


def say(kind: str, **facts: Any) -> None:
    """Say a JSON line on standard output."""
    print(json.dumps({"kind": kind, **facts}), flush=True)


class CommandLog:
    """Follows the commands of one robot.

    Args:
        states: whose command states are those that act.
        names: of the joints.
        say: takes kind and facts of a line.
        each: say every command.

    Attributes:
        count: commands that acted.
    """

    def __init__(
        self, states: States, names: Sequence[str], say: Say, *, each: bool = False
    ) -> None:
        self._target, self._stiffness = states["joint_pos_target"], states["joint_stiffness"]
        self._names, self._say, self._each = tuple(names), say, each
        self._before = np.zeros_like(self._target)
        self.count, self._worst, self._step = 0, 0.0, 0.0
        self._watched = self._stiff = False
        self._left: set[str] = set()

    def command(self, now: float, pos: Float32) -> None:
        """Take note of a command that acts; the joints are at `pos` in [rad], shape (n,)."""
        away = np.abs(self._target - pos)
        worst = float(away.max())
        self.count += 1
        self._worst = max(self._worst, worst)
        self._left.clear()
        if self._each:
            stiffness = float(self._stiffness.max())
            target = self._target.tolist()
            self._say("command", stamp=now, distance=worst, stiffness=stiffness, target=target)
        if not self._watched:
            self._say("first", distance=worst, joint=self._names[int(away.argmax())])
        else:
            self._step = max(self._step, float(np.abs(self._target - self._before).max()))
        self._watched = True
        self._before[...] = self._target
        stiff = bool(self._stiffness.any())
        if self._stiff and not stiff:
            self._say("damping", by="command", after=now, silent=0.0, moved=worst)
        self._stiff = stiff
        if self.count % TOLD_EVERY == 0:
            self.total()
            self._step = 0.0

    def left(self, kind: str) -> None:
        """Take note of a command that does not act: `ignored` or `refused`; the first is told."""
        if kind not in self._left:
            self._left.add(kind)
            self._say(kind, count=self.count)

    def silence(self, now: float, silent: float) -> None:
        """Take note that no command comes, once."""
        if self._watched:
            self._watched = False
            self._say("silence", after=now, silent=silent)

    def dead_man(self, now: float, silent: float) -> None:
        """Take note that the robot damps by itself."""
        self._stiff = False
        self._say("damping", by="dead man", after=now, silent=silent, moved=0.0)

    def total(self) -> None:
        """Say how many commands there were."""
        self._say("commands", count=self.count, worst=self._worst, step=self._step)
