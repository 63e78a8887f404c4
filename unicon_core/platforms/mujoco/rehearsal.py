"""A physics step ahead of its time that leaves nothing behind but warm caches, for `warm_up`."""

from __future__ import annotations

import time
from typing import Any

from unicon_core.platforms.mujoco.reader import Reader

LONGEST_NS = 400_000
"""Of a rehearsal: before a deadline there is a millisecond for all of them, and where a step takes
that long it is hardly slower for cold caches."""

RUNNING = 4
"""So many longer ones running, and rehearsals rest: the first before a deadline is itself cold."""

REST = 256
"""Rehearsals that are then left out; each time twice as many."""


class Rehearsal:
    """Simulates one physics step in place, under the last command, and sets everything back.

    `mj_copyData` brings back all there is: contacts, forces, warm start, sensors, counters. A
    step blows up where the real one would; what MuJoCo says of that is not said.

    Args:
        mujoco: the module.
        model: the `MjModel`.
        data: the robot's `MjData`.
        read: what `recv` does, but into arrays that nobody sees.
        split: the step is `mj_step2` and `mj_step1`, else `mj_step`.
    """

    def __init__(self, mujoco: Any, model: Any, data: Any, read: Reader, split: bool) -> None:
        self._mujoco, self._model, self._data = mujoco, model, data
        self._read, self._split, self._kept = read, split, None
        # What a plugin remembers is its own.
        self._able = not model.nplugin
        self._long = self._rest = 0
        self._next_rest = REST

    def __call__(self) -> None:
        if self._rest or not self._able:
            self._rest = max(self._rest - 1, 0)
            return
        mujoco, model, data, now = self._mujoco, self._model, self._data, time.perf_counter_ns
        if self._kept is None:  # 0.5 ms, enough for once
            self._kept = mujoco.MjData(model)
            return
        begin = now()
        mujoco.mj_copyData(self._kept, model, data)
        try:
            data.warning.number[:] += 1  # MuJoCo tells the first one of each kind only
            if self._split:
                mujoco.mj_step2(model, data)
                mujoco.mj_step1(model, data)
            else:
                mujoco.mj_step(model, data)
        finally:
            mujoco.mj_copyData(data, model, self._kept)
        self._read()
        if now() - begin <= LONGEST_NS:
            self._long, self._next_rest = 0, REST
            return
        self._long += 1
        if self._long == RUNNING:
            self._long, self._rest = 0, self._next_rest
            self._next_rest *= 2
