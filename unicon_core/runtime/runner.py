"""Runner: ticks a workflow until it is done, stopped or at fault, and damps at the end."""

from __future__ import annotations

import signal
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType
from typing import Any, Literal

import numpy as np

from unicon_core.errors import Fault, PlatformError, UniconError
from unicon_core.flow import Deferred, Zip, as_block, compile_graph
from unicon_core.runtime.arrivals import Arrivals
from unicon_core.runtime.pacing import (
    DryRun,
    Pacing,
    WallClock,
    prepare_process,
    process_age_s,
)
from unicon_core.runtime.report import Monitor, Report
from unicon_core.runtime.statistics import TickStatistics
from unicon_core.workflow import Workflow

__all__ = ["RunOptions", "Runner"]


@dataclass(frozen=True)
class RunOptions:
    """How to run.

    Attributes:
        duration: end after this time in [s] of ticks; None: until the flow is done.
        speed: `real` paces to the wall clock; `max` ticks as fast as it can (simulators).
        capacity: ticks whose time stamps are kept.
        warn: takes warnings, one line each.
        status: called about once a second with facts for a status line, or None.
    """

    duration: float | None = None
    speed: Literal["real", "max"] = "real"
    capacity: int = 32_768
    warn: Callable[[str], None] = print
    status: Callable[[dict[str, Any]], None] | None = None


class Runner:
    """Runs one workflow; `tick` and `close` may also be driven by a host such as the ROS node.

    Args:
        workflow: what to run.
        options: how.

    Attributes:
        next_due_ns: when the next tick is due, on the clock of `time.perf_counter_ns`; 0 where
            ticks are not paced. What comes after `send` may use the time until then.
        interrupted: SIGINT or SIGTERM ended the run.

    Raises:
        PlatformError: ticks shall come with the platform's data, and it has no `wait`.
    """

    def __init__(self, workflow: Workflow, options: RunOptions | None = None) -> None:
        self.workflow = workflow
        self.options = options or RunOptions()
        try:
            self.pacing = Pacing.from_dict(workflow.document.get("pacing", dict, {}))
        except UniconError as error:
            raise workflow.document.error(str(error), "pacing") from error
        self.monitor = Monitor(workflow.states)
        root = Zip(workflow.root, Deferred(as_block(self.monitor)))
        self.graph = compile_graph(root, trace=True)
        names = [block.name for block in self.graph.blocks]
        self.statistics = TickStatistics(names, self.graph.deferred_blocks, self.options.capacity)
        self.period_ns = round(workflow.period * 1e9)
        self.faults: list[str] = []
        self.done = False
        self.next_due_ns = 0
        self.interrupted = False
        self._between: deque[Callable[[], object]] = deque()
        self._platform_wait: Callable[[float], bool] | None = None
        if self.pacing.trigger == "state":
            self._platform_wait = getattr(workflow.platform, "wait", None)
            if self._platform_wait is None:
                raise PlatformError(
                    f"platform {workflow.platform.name!r} cannot tell when its data arrive; "
                    "set pacing.trigger: deadline"
                )
        self._tick = workflow.states["tick"]
        self._stop = False
        self._closed = False
        self._started_ns = 0
        self._age_s: float | None = None
        self._ended_ns = 0

    def stop(self) -> None:
        """Ask the run to end after the present tick; safe from a signal handler or a thread."""
        self._stop = True

    @property
    def stopping(self) -> bool:
        """Whether the run was asked to end."""
        return self._stop

    def call_soon(self, action: Callable[[], object]) -> None:
        """Run an action between two ticks, in the thread of the ticks; safe from any thread.

        It may take its time (a pause): ticks missed meanwhile are not overruns.
        """
        self._between.append(action)

    def reset(self) -> None:
        """Bring a simulator and the flow back to their beginning; call it between two ticks."""
        self.workflow.platform.reset()
        self.graph.reset()

    def tick(self, due_ns: int) -> bool:
        """Run one tick: step, then the deferred blocks. True when the flow is done.

        Raises:
            Fault: a block tripped; the caller must close, which damps.
        """
        graph = self.graph
        done = graph.step()
        done = graph.deferred() or done
        self._tick += 1
        self.statistics.add(due_ns, time.perf_counter_ns(), graph.stamps)
        return done

    def run(self) -> Report:
        """Run to the end and return the report; a fault is in it, the platform is closed."""
        restore = prepare_process(self.pacing, self.options.warn)
        try:
            with self._signals():
                self._started_ns, self._age_s = time.perf_counter_ns(), process_age_s()
                try:
                    self._loop()
                except Fault as fault:
                    self.faults.append(str(fault))
                finally:
                    self._ended_ns = time.perf_counter_ns()
                    self.close()
        finally:
            restore()
        return self.report()

    def close(self) -> None:
        """Damp and close, once."""
        if not self._closed:
            self._closed = True
            self.workflow.close()

    def report(self) -> Report:
        """Return the report of the run so far."""
        workflow, statistics = self.workflow, self.statistics
        end = self._ended_ns or time.perf_counter_ns()
        wall = max((end - self._started_ns) * 1e-9, 1e-9)
        ticks = statistics.count
        report = Report(workflow.name, workflow.robot.name, workflow.platform.name)
        report.ticks = ticks
        report.duration_s = round(ticks * workflow.period, 9)
        report.rate_hz = round(ticks / wall, 3)
        report.overruns = statistics.overruns
        if statistics.overruns:
            report.overrun_blocks = statistics.overrun_blocks(workflow.period * 1e6)
        if self._age_s is not None and 0 < ticks <= self.options.capacity:
            first = int(statistics.kept()[0, 2])
            report.startup_s = round(self._age_s + (first - self._started_ns) * 1e-9, 3)
        report.tick_us = statistics.tick_us()
        report.late_us = statistics.lateness_us()
        report.blocks = statistics.block_us()
        report.faults = list(self.faults)
        report.safety, report.forced = list(workflow.safety), list(workflow.forced)
        self.monitor.fill(report)
        return report

    # -- the loop -----------------------------------------------------------------------------

    def _limit(self) -> int:
        duration = self.options.duration
        if duration is None:
            duration = self.workflow.document.get("duration", (int, float))
        return 1 << 62 if duration is None else round(duration / self.workflow.period)

    def _loop(self) -> None:
        limit = self._limit()
        status_every = max(1, round(1.0 / self.workflow.period))
        if self._platform_wait is not None:
            self._triggered(limit, status_every, self._platform_wait)
            return
        if self.options.speed == "max":
            while not self._stop and self.statistics.count < limit:
                if self._between:
                    self._act()
                if self.tick(time.perf_counter_ns()):
                    self.done = True
                    break
                if self.statistics.count % status_every == 0:
                    self._status()
            return
        self._paced(limit, status_every)

    def _paced(self, limit: int, status_every: int) -> None:
        wait = self._dry_run(WallClock(round(self.pacing.spin_us * 1e3))).until
        period, skip = self.period_ns, self.pacing.overrun == "skip"
        statistics, now = self.statistics, time.perf_counter_ns
        due = now() + min(period, 10_000_000)
        while not self._stop and statistics.count < limit:
            if self._between:
                self._act()
                due = max(due, now())
            wait(due)
            self.next_due_ns = due + period
            if self.tick(due):
                self.done = True
                break
            due += period
            late = now() - due
            if late > 0:
                statistics.overruns += 1
                if skip:
                    due += -(-late // period) * period
            if statistics.count % status_every == 0:
                self._status()

    def _triggered(self, limit: int, status_every: int, wait: Callable[[float], bool]) -> None:
        """Tick when data arrive; without data at a slow pace, so that safety sees that they lack.

        Where data come more often than ticks, the one is waited for that is expected nearest to
        the deadline; what has come before is taken in as old. The state of a tick is then as fresh
        as a message can be, not up to an interval old. Deadlines are absolute there, so that early
        and late arrivals do not add up to another rate.
        """
        statistics, now, period = self.statistics, time.perf_counter_ns, self.period_ns
        platform = self.workflow.platform
        until = self._dry_run(WallClock(0)).until
        patience = 3e-9 * period
        arrivals = self._arrivals(wait, patience)
        due = last = now()
        hasty = 0
        while not self._stop and statistics.count < limit:
            if self._between:
                self._act()
                last = now()
            if arrivals is not None:
                often = 1.5 * arrivals.interval_ns < period
                due = max(due + period, now()) if often else last + round(arrivals.interval_ns)
                until(arrivals.nearest(due) - arrivals.lead_ns())
                if often:
                    platform.recv()
            came = wait(patience)
            before, last = last, now()
            if not came:
                statistics.overruns += 1
            hasty = hasty + 1 if last - before < 0.6 * period else 0
            if hasty >= 5:  # they come faster than was measured
                arrivals, hasty = self._arrivals(wait, patience), 0
                due = last = now()
            self.next_due_ns = (due if arrivals is not None else last) + period
            if self.tick(last):
                self.done = True
                break
            if came and arrivals is not None:
                arrivals.note(last)
            if statistics.count % status_every == 0:
                self._status()

    def _arrivals(self, wait: Callable[[float], bool], patience: float) -> Arrivals | None:
        """Return what tells when the data come, or None where nothing is known of them.

        Every arrival is waited for: later, a queue of one forgets those between two ticks.
        """
        platform, period = self.workflow.platform, self.period_ns
        if getattr(platform, "arrivals", None) is None:
            return None
        times: list[int] = []
        platform.recv()
        while len(times) < 10 and not self._stop:
            if not wait(patience):
                return None
            times.append(time.perf_counter_ns())
            platform.recv()
            if len(times) == 4 and min(np.diff(times)) > 0.6 * period:
                break
        if len(times) < 2:
            return None
        return Arrivals(times)

    def _dry_run(self, clock: WallClock) -> DryRun:
        able = any(block.dry_run is not None for block in self.graph.blocks)
        return DryRun(self.graph.dry, clock, round(self.pacing.dry_run_us * 1e3) if able else 0)

    def _act(self) -> None:
        for _ in range(len(self._between)):
            self._between.popleft()()

    def _status(self) -> None:
        if self.options.status is None:
            return
        statistics = self.statistics
        wall = (time.perf_counter_ns() - self._started_ns) * 1e-9
        self.options.status(
            {
                "t": f"{statistics.count * self.workflow.period:.1f} s",
                "rate": f"{statistics.count / wall:.1f} Hz",
                "overruns": statistics.overruns,
                "faults": len(self.faults),
            }
        )

    @contextmanager
    def _signals(self) -> Iterator[None]:
        """Let SIGINT and SIGTERM end the run after the present tick, where we may set handlers."""

        def handler(number: int, frame: FrameType | None) -> None:
            self.interrupted = True
            self.stop()

        before = {}
        try:
            for number in (signal.SIGINT, signal.SIGTERM):
                before[number] = signal.signal(number, handler)
        except ValueError:  # not the main thread: the host handles signals
            pass
        try:
            yield
        finally:
            for number, previous in before.items():
                signal.signal(number, previous)
