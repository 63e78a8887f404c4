"""Controls: what services, keys and a viewer start, stop, reset, pause and step of a workflow."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Protocol

from unicon_core.platforms.platform import Pausable
from unicon_core.runtime import Runner

Answer = tuple[bool, str]
"""Success, and a line for the caller."""


class StopLatch(Protocol):
    """An emergency stop, as seen during a pause and before a start."""

    def refusal(self) -> str:
        """Return why nothing may start, or ""."""
        ...

    def look(self) -> object:
        """Take a request, if there is one; raise where it is pressed."""
        ...


class Controls:
    """Acts on one runner; every method returns success and a line for the caller.

    Args:
        serve: serves callbacks for up to a time in [s]; keeps services alive during a pause.
        estop: the emergency stop, which ends a pause too; None where the host has none.

    Attributes:
        runner: the run; None before `attach`.
        paused: ticks are paused.
        others: looked at during a pause too, when no block is.
    """

    def __init__(self, serve: Callable[[float], None], estop: StopLatch | None = None) -> None:
        self.runner: Runner | None = None
        self.paused = False
        self.others: list[Callable[[], object]] = []
        self._steps = 0
        self._serve = serve
        self._estop = estop

    def stop(self) -> Answer:
        """End the run after the present tick: wind-down, then damping."""
        if self.runner is None:
            return False, "nothing runs"
        self.paused = False
        self.runner.stop()
        soft = self.runner.program.wind_down is not None
        return True, f"stopping: {'it winds down, then ' if soft else ''}the platform damps"

    def start(self) -> Answer:
        """Say the operator's go; go on after a pause."""
        if self.runner is None:
            return False, "nothing runs"
        refusal = self._estop.refusal() if self._estop else ""
        if refusal:
            return False, refusal
        if self.runner.go():
            return True, "go"
        if waits_for := self.runner.waits_for:
            return False, f"not yet: it waits for {waits_for}"
        if not self.paused:
            return False, "it runs already"
        self.paused = False
        return True, "going on"

    def reset(self) -> Answer:
        """Bring a simulator and the flow back to their beginning."""
        refusal = self._only_simulators("reset")
        if refusal or self.runner is None:
            return False, refusal
        self.runner.call_soon(self.runner.reset)
        return True, "reset before the next tick"

    def pause(self) -> Answer:
        """Let a simulator stand still until `start` or `step`."""
        refusal = self._only_simulators("pause")
        if refusal or self.runner is None:
            return False, refusal
        if not self.paused:
            self.paused, self._steps = True, 0
            self.runner.call_soon(self._stand_still)
        return True, "paused; ~/start goes on, ~/step ticks once"

    def step(self) -> Answer:
        """Run one tick of a paused simulator."""
        refusal = self._only_simulators("step")
        if refusal:
            return False, refusal
        if not self.paused:
            return False, "it is not paused; call ~/pause first"
        self._steps += 1
        return True, "one tick"

    def _only_simulators(self, what: str) -> str:
        if self.runner is None:
            return "nothing runs"
        platform = self.runner.program.platform
        if not platform.facts.simulated:
            return (
                f"platform {platform.facts.name!r} is a real robot, which has no {what}; use ~/stop"
            )
        return ""

    def _stand_still(self) -> None:
        runner = self.runner
        assert runner is not None
        platform = runner.program.platform
        pause = platform.pause if isinstance(platform, Pausable) else bool
        pause()
        while self.paused and not runner.stopping:
            self._serve(0.005)
            if self._estop is not None:
                self._estop.look()
            for look in self.others:
                look()
            if self._steps:
                self._steps -= 1
                if runner.tick(time.perf_counter_ns()):
                    runner.stop()
                pause()
        self.paused = False
