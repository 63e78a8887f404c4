"""Slack: serves a node's services, parameters, timers and events between ticks, never in their way.

A block after `send`. All of them are asked in rounds, 25 to 200 a second, as there is work. A round
is made of pieces of some 10 µs, one for each service; a piece is done where it ends before the next
tick's warm-up begins, else in a later tick. So a tick pays for a piece and not for a round, and one
with little slack still hears its services.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from typing import Any

from unicon_core.runtime import Runner
from unicon_ros import compat

INTERVAL_NS = 40_000_000
"""A round every 40 ms where nobody asks for anything: 0.3 % of a core."""
BUSY_NS = 5_000_000
"""After a round that found something to do the next one after 5 ms, and then ever less often."""
PATIENCE_NS = 20_000_000
"""A round that is late by so much uses the warm-up's share too."""
LAST_NS = 1_000_000_000
"""So late, it is done whatever the slack: an overloaded loop must still hear its services."""
TAIL_NS = 50_000
"""Left for the blocks behind this one, such as a recorder's."""
CALLBACKS = 16
"""Callbacks served in one tick at most."""
FIRST_COST_NS = 200_000
"""Taken for the cost of a piece before one of its kind was done: the first is cold."""


class SlackServer:
    """Serves an executor in the slack.

    Args:
        executor: rclpy executor with the node in it; None for none yet.
        warn: takes warnings.

    Attributes:
        runner: whose deadlines count; None until it is known.
        served: callbacks run.
        forced: rounds that were due to `LAST_NS`.
        always: begin a round in every tick; where subscriptions cannot be polled.
    """

    name = "ros services"

    def __init__(self, executor: Any, warn: Callable[[str], None]) -> None:
        self.runner: Runner | None = None
        self.served = self.forced = 0
        self.always = False
        self._warn = warn
        self.use(executor)
        self._due_ns = time.perf_counter_ns() + INTERVAL_NS
        self._interval_ns = INTERVAL_NS
        self._costs: dict[str, float] = {}
        self._dead = False

    def use(self, executor: Any) -> None:
        """Serve this executor from now on; None for none."""
        self._executor = executor
        self.responses = compat.Responses()
        self._serving = None if executor is None else compat.Serving(executor, self.responses.watch)
        self._round: Iterator[compat.Piece] | None = None
        self._piece: compat.Piece | None = None
        self._found = False

    def look(self) -> None:
        """See what the nodes have, before ticks begin: that takes longer than their slack."""
        if self._serving is not None:
            self._serving.look()

    def __call__(self) -> None:
        now = time.perf_counter_ns()
        late = now - self._due_ns
        if (late < 0 and not self.always) or self._dead or self._serving is None:
            return
        end, forced = self._end(late), late >= LAST_NS
        served = 0
        while served < CALLBACKS:
            piece = self._piece or self._next()
            if piece is None:
                return
            fits = now + self._cost(piece.kind) <= end
            if not fits and not forced:
                self._piece = piece
                return
            if not fits and end:
                self.forced += 1
                end = 0  # once told, the round goes to its end
            self._piece = None
            served += self._done(piece)
            began, now = now, time.perf_counter_ns()
            # Fast up and slowly down, so that one slow callback makes the next one wait.
            cost, known = now - began, self._costs.get(piece.kind, 0.0)
            self._costs[piece.kind] = cost if cost > known else 0.95 * known + 0.05 * cost

    def _end(self, late: int) -> int:
        """Return until when pieces may take, in [ns] of `time.perf_counter_ns`."""
        runner = self.runner
        due = 0 if runner is None else runner.next_due_ns
        if not due or runner is None:
            return 1 << 62
        lead = runner.lead_ns if late < PATIENCE_NS else 0
        return due - max(lead, round(1e3 * runner.pacing.spin_us), TAIL_NS)

    def _cost(self, kind: str) -> float:
        cost = self._costs.get(kind, FIRST_COST_NS)
        return cost if self.runner is None else min(cost, 0.5 * self.runner.period_ns)

    def _next(self) -> compat.Piece | None:
        """Return the next piece of the round, None at its end; a round begins with the first."""
        try:
            if self._round is None:
                assert self._serving is not None
                self.responses.retry()
                self._round = self._serving.round()
                self._found = False
            piece = next(self._round, None)
        except Exception as error:  # the context is gone
            self._failed(error)
            piece = None
        if piece is None:
            self._round = None
            wider = min(2 * self._interval_ns, INTERVAL_NS)
            self._interval_ns = BUSY_NS if self._found else wider
            self._due_ns = time.perf_counter_ns() + self._interval_ns
        return piece

    def _done(self, piece: compat.Piece) -> bool:
        try:
            ran = piece.run()
        except Exception as error:  # a callback's mistake, or the context is gone
            ran = True
            self._failed(error)
        self.served += ran
        self._found |= ran
        return ran

    def _failed(self, error: Exception) -> None:
        if type(error).__name__ in ("ExternalShutdownException", "InvalidHandle"):
            self._dead = True
            self._warn("the ROS context was shut down; services and parameters are served no more")
        else:
            self._warn(f"a ROS callback failed: {type(error).__name__}: {error}")

    def _call_found(self) -> None:
        """Call what a round has found and ticks had no time for."""
        for piece in () if self._serving is None else self._serving.callbacks():
            self._done(piece)

    def rest(self) -> None:
        """Ticks have ended: what answers from now on may block."""
        self._call_found()
        self.responses.release()

    def spin(self, timeout: float) -> None:
        """Serve one callback, waiting up to `timeout` in [s]: while ticks are paused."""
        self._call_found()
        try:
            if self._executor is None:
                time.sleep(timeout)
            else:
                self._executor.spin_once(timeout)
        except Exception as error:
            self._failed(error)
            time.sleep(timeout if self._dead else 0.0)
