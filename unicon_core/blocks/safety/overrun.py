"""Stop for a machine that does not keep its ticks: `overrun_stop`."""

from __future__ import annotations

import time
from collections import deque
from typing import Annotated

from unicon_base.errors import Fault, WorkflowError
from unicon_base.schema.marks import Within, positive
from unicon_core.flow.block import Stage
from unicon_core.workflow.autowire import BuildContext

LONGEST = 60.0
"""Largest window in [s]."""

PAUSE_NS = 250_000_000
"""A longer time between two ticks is a pause that somebody asked for: a tick that hangs for so long
on a robot is a fault of its own (`pacing.hang`)."""


class OverrunStop:
    """Stop where too many ticks were missed within a time, by the machine's clock.

    A simulator has no deadlines where it runs at full speed, so there it never trips.

    Args:
        count: missed ticks that are too many; no more than the window has.
        window: in [s].

    Raises:
        WorkflowError: the window has fewer ticks.
    """

    memory = ()

    stage = Stage.SAFETY
    pure = False  # a dry run would be a tick too

    def __init__(
        self,
        context: BuildContext,
        *,
        count: Annotated[int, Within(1)] = 10,
        window: Annotated[float, positive(LONGEST, "s")] = 1.0,
    ) -> None:
        period, platform = context.period, context.platform
        ticks = round(window / period)
        if count > ticks:
            raise WorkflowError(
                f"count is {count}; give 1 to {max(ticks, 1)}, the ticks of window: {window:g} s"
            )
        self._period_ns, self._window_ns = period * 1e9, round(window * 1e9)
        self._paced = platform is None or not platform.facts.simulated
        self._late_ns = 1.5 * self._period_ns
        self._pause_ns = max(PAUSE_NS, 5.0 * self._period_ns)
        self._window = window
        self._missed: deque[int] = deque(maxlen=count)
        self._last = 0

    def __call__(self) -> None:
        """Look.

        Raises:
            Fault: too many ticks were missed.
        """
        now = time.perf_counter_ns()
        took, self._last = now - self._last, now
        if took < self._late_ns or took > self._pause_ns or not self._paced:
            return
        missed = self._missed
        missed.extend([now] * (round(took / self._period_ns) - 1))
        if len(missed) == missed.maxlen and now - missed[0] <= self._window_ns:
            raise Fault(
                f"{len(missed)} ticks were missed within {self._window:g} s: the machine does not "
                "keep the rate; give it less to do, or a lower rate"
            )

    def reset(self) -> None:
        """Count anew."""
        self._missed.clear()
        self._last = 0
