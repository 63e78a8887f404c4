"""Runner: ticks a workflow until it is done, stopped or at fault, and damps at the end."""

from __future__ import annotations

import threading
import time
import traceback
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from unicon_core.errors import Fault, PlatformError, UniconError
from unicon_core.flow import Deferred, Zip, as_block, compile_graph
from unicon_core.runtime.arrivals import Arrivals
from unicon_core.runtime.pacing import (
    CATCH_UP,
    Pacing,
    WallClock,
    WarmUp,
    prepare_process,
    process_age_s,
)
from unicon_core.runtime.report import Monitor, Report
from unicon_core.runtime.statistics import TickStatistics
from unicon_core.signals import SIGNALS, Interrupted, signal_name
from unicon_core.workflow import Workflow
from unicon_core.workflow.gate import NEVER_NS

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


CLOSING = 3.0
"""How long `close` of another thread waits for the ticking one to damp, in [s]."""


class Runner:
    """Runs one workflow; `tick` and `close` may also be driven by a host such as the ROS node.

    While `run` ticks, its thread alone may use the workflow: `stop`, `call_soon` and `close` are
    for the others.

    Args:
        workflow: what to run; not closed, and not run before.
        options: how.

    Attributes:
        next_due_ns: when the next tick is due, on the clock of `time.perf_counter_ns`; 0 where
            ticks are not paced. What comes after `send` may use the time until then.
        faults: what went wrong, one line each; the first is why the run ended.
        traceback: where the first fault came from, if it was no `Fault`; else "".
        interrupted: a signal ended the run.

    Raises:
        PlatformError: the platform cannot be paced as the workflow says.
        UniconError: the workflow is closed.
    """

    def __init__(self, workflow: Workflow, options: RunOptions | None = None) -> None:
        if workflow.gate.closed:
            raise UniconError(f"workflow {workflow.name} is closed; build it anew to run it again")
        self.workflow = workflow
        self.options = options or RunOptions()
        workflow.warn = self.options.warn
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
        self.traceback = ""
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
        if self.options.speed == "max" and not workflow.platform.simulated:
            raise PlatformError(
                f"platform {workflow.platform.name!r} is a robot, which takes its time; "
                "leave out speed max, or use a simulator"
            )
        if self.pacing.overrun == "catch_up" and not workflow.platform.simulated:
            raise PlatformError(
                f"platform {workflow.platform.name!r} is a robot, to which catch_up would send old "
                "commands in one go; set pacing.overrun: skip"
            )
        self._hang_ns = self.pacing.hang_ns(self.period_ns, workflow.platform.simulated)
        workflow.gate.hung = self._hung
        self._tick = workflow.states["tick"]
        self._stop = False
        self._closed = False
        self._thread: int | None = None
        self._ended = threading.Event()
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

        It may take its time (a pause): ticks missed meanwhile are not overruns. What it raises is
        a fault.
        """
        self._between.append(action)

    def reset(self) -> None:
        """Bring a simulator and the flow back to their beginning; call it between two ticks.

        Raises:
            UniconError: another thread ticks.
        """
        self._only_here("reset", "call_soon(runner.reset)")
        self.workflow.platform.reset()
        self.graph.reset()

    def tick(self, due_ns: int) -> bool:
        """Run one tick: step, then the deferred blocks. True when the flow is done.

        Raises:
            Fault: a block tripped; the caller must close, which damps.
            UniconError: another thread ticks.
        """
        self._only_here("tick", "call_soon")
        return self._step(due_ns)

    def _step(self, due_ns: int) -> bool:
        graph = self.graph
        done = graph.step()
        done = graph.deferred() or done
        self._tick += 1
        self.statistics.add(due_ns, time.perf_counter_ns(), graph.stamps)
        return done

    def _only_here(self, what: str, instead: str) -> None:
        if self._thread not in (None, threading.get_ident()):
            raise UniconError(f"Runner.{what}: another thread ticks this workflow; use {instead}")

    def run(self) -> Report:
        """Run to the end and return the report; whatever goes wrong is in it, the platform closed.

        Every signal whose default action ends the process ends the run after the present tick; a
        second one damps at once, in the middle of the tick.

        Raises:
            UniconError: it runs already, or has run.
        """
        if self._closed or self._thread is not None:
            state = "has ended" if self._closed else "is running"
            raise UniconError(f"Runner.run: this run {state}; build the workflow anew")
        self._thread = threading.get_ident()
        with SIGNALS, SIGNALS.guard(self.stop, self._damp_now):
            self._stop |= bool(SIGNALS.asked)
            restore: Callable[[], object] = bool
            fault: BaseException | None = None
            before = 0
            try:
                try:
                    restore = prepare_process(self.pacing, self.options.warn)
                    self._started_ns, self._age_s = time.perf_counter_ns(), process_age_s()
                    self._loop()
                except BaseException as error:  # whatever it is, no further command is sent
                    fault = error
                self._ended_ns, before = time.perf_counter_ns(), len(self.faults)
                self._close()
            except Interrupted as error:  # a second signal came just here; it has damped
                fault = fault or error
            # Damped first, told afterwards; no signal raises any more.
            if fault is not None:
                self._failed(fault, before)
            restore()
            self._thread = None
            self._ended.set()
            self.interrupted = bool(SIGNALS.asked)
            report = self.report()
            report.ended = self._why()
            SIGNALS.stop_process()
        return report

    def _damp_now(self) -> bool:
        """Close in the middle of a tick: a second signal wants it, as the tick does not end."""
        if self._closed:
            return False
        self.faults.append(
            f"{signal_name(SIGNALS.asked)} came twice: damped at once, in the middle of a tick"
        )
        self._close()
        return True

    def _failed(self, error: BaseException, place: int) -> None:
        if isinstance(error, Interrupted) and self.faults:
            return  # told by whoever damped
        try:
            reason = _reason(error)
        except Exception:  # its text cannot be had
            reason = type(error).__name__
        self.faults.insert(place, reason)  # before what closing found: the first is why
        if not isinstance(error, Fault):
            self.traceback = "".join(traceback.format_exception(error))

    def _why(self) -> str:
        """Return what ended the run, in a word or two."""
        if self.faults:
            return "fault"
        if self.done:
            return "done"
        if self.interrupted:
            return signal_name(SIGNALS.asked)
        return "stopped" if self._stop else "duration"

    def close(self) -> None:
        """Damp and close, once. From another thread: end the run, which damps, and wait for it.

        Raises:
            UniconError: the ticking thread did not end in time; nothing is sent any more.
        """
        if self._thread in (None, threading.get_ident()):
            self._close()
            return
        self.stop()
        if not self._ended.wait(CLOSING):
            self.workflow.gate.close()
            raise UniconError(
                f"Runner.close: the ticking thread did not end within {CLOSING:g} s; it sends "
                "nothing any more; end the process"
            )

    def _close(self) -> None:
        if not self._closed:
            self._closed = True
            try:
                self.workflow.close()
            except Exception as error:
                self.faults.append(f"closing: {_reason(error)}")

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
        report.wall_s = round(wall, 3)
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
        report.traceback = self.traceback
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
                    if self._stop:
                        break
                if self._step(time.perf_counter_ns()):
                    self.done = True
                    break
                if self.statistics.count % status_every == 0:
                    self._status()
            return
        self._paced(limit, status_every)

    def _paced(self, limit: int, status_every: int) -> None:
        wait = self._warm_up(WallClock(round(self.pacing.spin_us * 1e3))).until
        period, backlog = self.period_ns, 0 if self.pacing.overrun == "skip" else CATCH_UP
        statistics, now, gate = self.statistics, time.perf_counter_ns, self.workflow.gate
        due = now() + min(period, 10_000_000)
        while not self._stop and statistics.count < limit:
            if self._between:
                self._act()
                if self._stop:
                    break
                due = max(due, now())
            gate.until_ns = due + self._hang_ns
            if wait(due) > gate.until_ns:
                self._missed(now() - due)
            self.next_due_ns = due + period
            try:
                done = self._step(due)
            except BaseException:
                statistics.overruns += max(-(-(now() - due - period) // period), 0)
                raise
            if done:
                self.done = True
                break
            due += period
            late = now() - due
            if late > 0:
                missed = -(-late // period)
                dropped = max(missed - backlog, 0)
                # Each deadline that no tick met counts, those caught up when they run.
                statistics.overruns += max(dropped, 1)
                due += dropped * period
                if late > self._hang_ns:
                    raise Fault(self._hung())
            if statistics.count % status_every == 0:
                self._status()

    def _missed(self, late_ns: int) -> None:
        """Count the ticks that nobody ran, and end the run: the process stood still.

        Raises:
            Fault: always.
        """
        self.statistics.overruns += late_ns // self.period_ns
        raise Fault(
            f"no tick ran for {late_ns * 1e-9:.2f} s: the process was stopped or starved between "
            f"two ticks; more than {self._hang_ns * 1e-9:g} s are a fault (pacing.hang)"
        )

    def _hung(self) -> str:
        """Return what is said of the present tick, which took too long: the slowest block."""
        stamps, names = self.graph.stamps, [block.name for block in self.graph.blocks]
        ends = sorted((int(end), name) for end, name in zip(stamps[2:], names) if end)
        before, slowest, longest = int(stamps[0]), "a block that has not ended", 0
        for end, name in ends:
            if end - before > longest:
                slowest, longest = name, end - before
            before = end
        if time.perf_counter_ns() - before > longest:  # it has no stamp yet
            slowest, longest = "what ran last", time.perf_counter_ns() - before
        return (
            f"a tick hung: {slowest} took {longest * 1e-9:.2f} s; ticks that are late by more than "
            f"{self._hang_ns * 1e-9:g} s are a fault (pacing.hang)"
        )

    def _triggered(self, limit: int, status_every: int, wait: Callable[[float], bool]) -> None:
        """Tick when data arrive; without data at a slow pace, so that safety sees that they lack.

        Where data come more often than ticks, the one is waited for that is expected nearest to
        the deadline; what has come before is taken in as old. The state of a tick is then as fresh
        as a message can be, not up to an interval old. Deadlines are absolute there, so that early
        and late arrivals do not add up to another rate.
        """
        statistics, now, period = self.statistics, time.perf_counter_ns, self.period_ns
        platform = self.workflow.platform
        until = self._warm_up(WallClock(0)).until
        patience = 3e-9 * period
        arrivals = self._arrivals(wait, patience)
        due = last = now()
        hasty, gate = 0, self.workflow.gate
        silence = round(1e9 * patience) + 2 * period + self._hang_ns
        while not self._stop and statistics.count < limit:
            if self._between:
                self._act()
                if self._stop:
                    break
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
            if last - before > silence:
                self._missed(last - before)
            gate.until_ns = last + self._hang_ns
            hasty = hasty + 1 if last - before < 0.6 * period else 0
            if hasty >= 5:  # they come faster than was measured
                arrivals, hasty = self._arrivals(wait, patience), 0
                due = last = now()
            self.next_due_ns = (due if arrivals is not None else last) + period
            if self._step(last):
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

    def _warm_up(self, clock: WallClock) -> WarmUp:
        able = any(block.warm_up is not None for block in self.graph.blocks)
        return WarmUp(self.graph.warm_up, clock, round(self.pacing.dry_run_us * 1e3) if able else 0)

    def _act(self) -> None:
        self.workflow.gate.until_ns = NEVER_NS  # a pause takes its time, and may tick
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


def _reason(error: BaseException) -> str:
    """Return an exception in one line; what is not a `Fault` with its kind and place."""
    if isinstance(error, Fault):
        return str(error)
    text = " ".join(str(error).split())
    frames = traceback.extract_tb(error.__traceback__)
    place = f" ({Path(frames[-1].filename).name}:{frames[-1].lineno})" if frames else ""
    return f"{type(error).__name__}{': ' if text else ''}{text}{place}"
