"""Slack: serves a node's services, parameters, timers and events between ticks, never in their way.

A block after `send`. It looks at the executor 20 to 200 times a second, as there is work (an empty
look costs about 150 µs, as rclpy builds a wait set of all services for it), and only when the time
until the next deadline is longer than what a look has cost lately plus the runner's warm-up.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from unicon_core.runtime import Runner
from unicon_ros import compat

__all__ = ["SlackServer"]

INTERVAL_NS = 50_000_000
"""Look every 50 ms where nobody asks for anything: 0.3 % of a core, and a service waits no more."""
BUSY_NS = 5_000_000
"""After a look that found something to do, look again after 5 ms, and then ever less often."""
PATIENCE_NS = 250_000_000
"""After so long without enough slack, the warm-up's share is used too."""
LAST_NS = 1_000_000_000
"""After so long, look once whatever the slack: an overloaded loop must still hear its services."""
ROUNDS = 16
"""Callbacks served in one look at most."""


class SlackServer:
    """Serves an executor in the slack.

    Args:
        executor: rclpy executor with the node in it; None for none yet.
        warn: takes warnings.

    Attributes:
        runner: whose deadlines count; None until it is known.
        served: callbacks run.
        forced: looks that were due to `LAST_NS`.
        always: look in every tick; where subscriptions cannot be polled.
    """

    name = "ros services"

    def __init__(self, executor: Any, warn: Callable[[str], None]) -> None:
        self.runner: Runner | None = None
        self.served = self.forced = 0
        self.always = False
        self._warn = warn
        self.use(executor)
        self._last_ns = time.perf_counter_ns()
        self._cost_ns = 300_000.0
        self._interval_ns = INTERVAL_NS
        self._dead = False

    def use(self, executor: Any) -> None:
        """Serve this executor from now on; None for none."""
        self._executor = executor
        self._serve = _nothing if executor is None else compat.serve_one(executor)
        self.responses = compat.Responses()

    def __call__(self) -> None:
        now = time.perf_counter_ns()
        waited = now - self._last_ns
        if waited < self._interval_ns and not self.always:
            return
        runner = self.runner
        due = 0 if runner is None else runner.next_due_ns
        until = 1 << 62
        if due and runner is not None:
            period = runner.period_ns
            until = due - round(min(self._cost_ns, 0.25 * period))
            if waited < PATIENCE_NS:
                until -= round(1e3 * (runner.pacing.dry_run_us + runner.pacing.spin_us))
            if now >= until:
                if waited < LAST_NS:
                    return
                self.forced += 1
        self._look(now, until)

    def _look(self, now: int, until: int) -> None:
        self._last_ns = now
        self._interval_ns = min(2 * self._interval_ns, INTERVAL_NS)
        if self._dead or self._executor is None:
            return
        for node in self._executor.get_nodes():
            self.responses.watch(node)
        self.responses.retry()
        for _ in range(ROUNDS):
            began = now
            try:
                more = self._serve()
            except Exception as error:  # a callback's mistake, or the context is gone
                more = True
                self._failed(error)
            now = time.perf_counter_ns()
            # Fast up and slowly down, so that one slow callback makes the next look wait.
            cost = now - began
            self._cost_ns = cost if cost > self._cost_ns else 0.95 * self._cost_ns + 0.05 * cost
            if not more or self._dead:
                return
            self.served += 1
            self._interval_ns = BUSY_NS
            if now >= until:
                return

    def _failed(self, error: Exception) -> None:
        if type(error).__name__ in ("ExternalShutdownException", "InvalidHandle"):
            self._dead = True
            self._warn("the ROS context was shut down; services and parameters are served no more")
        else:
            self._warn(f"a ROS callback failed: {type(error).__name__}: {error}")

    def rest(self) -> None:
        """Ticks have ended: what answers from now on may block."""
        self.responses.release()

    def spin(self, timeout: float) -> None:
        """Serve one callback, waiting up to `timeout` in [s]: while ticks are paused."""
        try:
            if self._executor is None:
                time.sleep(timeout)
            else:
                self._executor.spin_once(timeout)
        except Exception as error:
            self._failed(error)
            time.sleep(timeout if self._dead else 0.0)


def _nothing() -> bool:
    return False
