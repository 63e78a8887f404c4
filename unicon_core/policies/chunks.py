"""Action chunks: a network that answers with the actions of the next rows, and what runs of them.

A row is the action from `i · period` to `(i + 1) · period` after the observation of its chunk. So
the age of the observation is counted: rows that passed while the network was at work are skipped,
not sent late. A plan holds an action for each tick of the workflow, whatever the two periods are.
The network runs in the tick, or beside it in a process of its own or at a server.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, e
from pathlib import Path
from typing import Annotated, Literal

import numpy as np

from unicon_base import AnyDict
from unicon_base.arrays import Float32
from unicon_base.schema.marks import Core, Matches, Within, positive
from unicon_base.schema.types import Here

PREFIX, DELAY = "action_prefix", "action_delay"
"""States that a network may take: the rows that were planned, from its observation on, with the
last one repeated, shape (size · m,); and how many of them run until it answers, by the slowest of
the last answers."""

_DELAYS = 10  # answers whose delay counts, as in Black et al. 2025
_ROUNDING = 1e-6  # of a row


@dataclass(frozen=True, kw_only=True)
class LateSpec:
    """How late the actions of a network may be that runs beside the ticks.

    Attributes:
        delay: ticks of the workflow from an observation to its action; more where it comes late.
        timeout: an action whose observation is older ends the run, in [s]; None: twice the age
            that actions have by their delay, at least 0.25.
    """

    delay: Annotated[int, Within(1, 1000, "ticks")] = 1
    timeout: Annotated[float | None, Within(0.001, 60.0, "s")] = None


@dataclass(frozen=True, kw_only=True)
class ChildSpec(LateSpec):
    """How a network runs in a process of its own, which the workflow says.

    Attributes:
        cpu: core that the process stays on, or None.
        threads: of the network.
    """

    key = "child"  # of the workflow's options
    cpu: Core | None = None
    threads: Annotated[int, Within(1, 64)] = 1


@dataclass(frozen=True)
class RemoteSpec(LateSpec):
    """How a server runs a network (`unicon serve`).

    Attributes:
        address: of the server.
        keys: folder with its CURVE key and ours, from the workflow's folder on; None: without.
    """

    key, threads = "remote", 1  # threads: of a network that a tool opens here
    address: Annotated[
        str, Matches(r"tcp://[^\s/*]+:[0-9]{1,5}|ipc://\S+", "tcp://HOST:PORT, or ipc://PATH")
    ]
    keys: Annotated[Path | None, Matches(r".+", "the folder of its keys")] = None


@dataclass(frozen=True)
class ChunkSpec:
    """What the rows of an action mean, and how they are executed.

    Attributes:
        size: rows of an answer, H.
        period: from row to row in [s]; None: the policy's.
        steps: rows from one inference to the next; None: as soon as the last is answered.
        execution: what runs where chunks overlap: `receding`, the newest one (Chi et al. 2023,
            Diffusion Policy); `ensemble`, the mean of all with weights exp(-weight · i), i = 0 the
            oldest (Zhao et al. 2023, ACT); `real_time`, rows that run during the inference stay
            and later ones are blended (the soft mask of Black et al. 2025, Real-Time Execution of
            Action Chunking Flow Policies). Its guidance inside the sampler is the network's: one
            that takes `action_prefix` is not blended.
        weight: m of the ensemble.
        hold: for so long in [s] the last row is held where no newer chunk is there.
        underrun: what follows, and where the network's process fails: a `fault`, or the policy is
            `done` and the flow goes on, such as to `hold`.
    """

    size: Annotated[int, Within(1, 1000, "rows")]
    period: Annotated[float | None, positive(10.0, "s")] = None
    steps: Annotated[int | None, Within(1, 1000, "rows")] = None
    execution: Literal["receding", "ensemble", "real_time"] = "receding"
    weight: Annotated[float, Within(0.0, 10.0)] = 0.01
    hold: Annotated[float, Within(0.0, 10.0, "s")] = 0.25
    underrun: Literal["fault", "done"] = "fault"

    @staticmethod
    def between(found: AnyDict, here: Here) -> None:
        """Note more steps than rows."""
        size, steps = found.get("size"), found.get("steps")
        if size is not None and steps is not None and steps > size:
            here.value(f"is {steps}, and a chunk has {size} rows; give at most as many", "steps")


def note_chunk(found: AnyDict, here: Here) -> None:
    """Note what does not go with chunks: a filter, and more than a minute."""
    chunk, period = found.get("chunk"), found.get("period")
    if chunk is None:
        return
    if getattr(found.get("action"), "filter", None) is not None:
        text = "goes over the policy's ticks, and rows of a chunk are none; leave it out"
        here.value(text, "action", "filter")
    seconds = chunk.size * (chunk.period or period or 0.0)
    if seconds > 60.0:
        here.value(f"has {chunk.size} rows, {seconds:g} s; a minute is the most", "chunk", "size")


class Plan:
    """The actions of the coming ticks, made of chunks.

    Args:
        spec: of the chunks.
        row: period of a row in [s].
        tick: period of the workflow in [s].
        moved: elements of an action, m.
        conditioned: the network takes the planned rows itself, so they are not blended here.

    Attributes:
        ticks: of a chunk.
        steps: ticks from one inference to the next at least.
    """

    memory = ("_actions", "_norm", "_count", "_of", "_delays")

    def __init__(
        self, spec: ChunkSpec, row: float, tick: float, moved: int, conditioned: bool
    ) -> None:
        self._per_tick = tick / row
        self.ticks = ceil(spec.size / self._per_tick - _ROUNDING)
        self.steps = ceil((spec.steps or 0) / self._per_tick - _ROUNDING)
        rows = np.arange(self.ticks) * self._per_tick + _ROUNDING
        self._row = rows.astype(np.intp)
        starts = np.ceil(np.arange(spec.size) / self._per_tick - _ROUNDING)
        self._starts = starts.astype(np.intp)
        blends = spec.execution == "real_time" and not conditioned
        self._blend = blends, spec.execution == "ensemble"
        self._spec = spec
        self._actions = np.zeros((self.ticks, moved), np.float32)
        self._norm, self._count = np.zeros((2, self.ticks, 1), np.float32)
        self._delays = np.zeros(_DELAYS)
        self._of = -1

    def add(self, chunk: Float32, of: int, tick: int) -> None:
        """Take an answer.

        Args:
            chunk: shape (H, m).
            of: tick of its observation.
            tick: the present one.
        """
        actions, (real_time, ensemble) = self._actions, self._blend
        new, passed, first = chunk[self._row], of - self._of, self._of < 0
        delay, self._of = (tick - of) * self._per_tick, of
        self._delays[:-1] = self._delays[1:]
        self._delays[-1] = delay
        kept = 0 if first else max(self.ticks - passed, 0)
        if ensemble:
            for array in (actions, self._norm, self._count):
                array[:kept] = array[self.ticks - kept :]
                array[kept:] = 0.0
            weight = np.exp(-self._spec.weight * self._count)
            actions *= self._norm
            self._norm += weight
            self._count += 1.0
            new = (actions + weight * new) / self._norm
        elif real_time and kept:
            share = self._soft_mask(ceil(delay - _ROUNDING), passed)[:kept]
            new[:kept] = share * actions[self.ticks - kept :] + (1.0 - share) * new[:kept]
        actions[...] = new

    def _soft_mask(self, delay: int, passed: int) -> Float32:
        """Return the weight of the plan so far in each tick of a chunk, shape (ticks, 1).

        W = 1 for rows i < d, else c (exp(c) - 1) / (e - 1) with c = (n - i) / (n - d + 1), where n
        rows overlap (Black et al. 2025, soft masking).
        """
        overlap = self._spec.size - passed * self._per_tick
        share = (overlap - self._row) / max(overlap - delay + 1.0, 1.0)
        share = np.where(self._row < delay, 1.0, np.clip(share, 0.0, 1.0))
        weight: Float32 = (share * np.expm1(share) / (e - 1.0)).astype(np.float32)[:, None]
        return weight

    def at(self, tick: int) -> Float32:
        """Return the action of a tick, the last row behind the last; shape (m,)."""
        action: Float32 = self._actions[min(tick - self._of, self.ticks - 1)]
        return action

    def expect(self, tick: int, prefix: Float32 | None, delay: Float32 | None) -> None:
        """Write the states that a network may take: see `PREFIX` and `DELAY`; None: it does not."""
        if prefix is not None:
            rows = self._actions.take(self._starts + (tick - max(self._of, 0)), 0, mode="clip")
            prefix[...] = rows.reshape(-1)
        if delay is not None:
            delay[...] = np.ceil(self._delays.max() - _ROUNDING)

    def reset(self) -> None:
        """Forget all chunks."""
        for array in (self._actions, self._norm, self._count, self._delays):
            array[...] = 0.0
        self._of = -1
