"""Ticker: ticks one graph at its times until it is done or stopped; for the runner."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable

import numpy as np

from unicon_base.errors import Fault, Hung
from unicon_core.flow import CompiledGraph, Node, compile_graph
from unicon_core.pacing import CATCH_UP, WallClock, WarmUp, staying
from unicon_core.platforms.platform import CountsArrivals
from unicon_core.runtime.arrivals import Arrivals, awaited
from unicon_core.runtime.statistics import Detail, TickStatistics
from unicon_core.workflow import Program
from unicon_core.workflow.program_data import NEVER_NS

STATUS_S = 0.25
"""Between two status lines, in [s]; at full speed 1 s of ticks."""
OTHER_RATE = 0.2
"""Part by which ticks with each n-th arrival may be off the workflow's rate."""

ENOUGH = 4
"""Arrivals that tell when the next ones come."""


class Ticker:
    """Ticks the graph of one phase.

    Args:
        program: whose states and platform it is about.
        root: the tree of a tick.
        capacity: ticks whose time stamps are kept.
        status: called every `STATUS_S`, or None.
        compiles: makes the graph of the tree, as `compile_graph` does.

    Attributes:
        graph: the compiled tree.
        statistics: time stamps of its ticks.
        done: the graph was done.
        stop: set it, and the present tick is the last.
        next_due_ns: when the next tick is due, on the clock of `time.perf_counter_ns`; 0 where
            ticks are not paced.
        between: actions to be called between two ticks.
        arrivals: when the platform's data come, as far as it was measured.
        detail: switches the time stamps of blocks.
        hang_ns: how late a tick may be; later ones are a fault.
        first_ns: when the first tick is due, on the same clock; 0 for at once. All others are due
            whole periods behind it, though it was late. One that data trigger comes with those
            nearest to it.
    """

    def __init__(
        self,
        program: Program,
        root: Node,
        capacity: int,
        status: Callable[[], object] | None,
        compiles: Callable[..., CompiledGraph] = compile_graph,
    ) -> None:
        self._program, self._status = program, status
        self.pacing, self.period_ns = program.pacing, round(program.period * 1e9)
        self.graph = compiles(root, trace=True)
        names = [block.name for block in self.graph.blocks]
        self.statistics = TickStatistics(
            names, self.graph.deferred_blocks, capacity, self.graph.groups
        )
        self._stamps = memoryview(self.graph.stamps.data)
        groups = self.graph.groups
        self._last = 2 + groups[-1][-1] if groups else 1  # of the group that ends with the tick
        self.detail = Detail(self.graph, self.statistics)
        self.done = self.stop = False
        self.next_due_ns = self.first_ns = 0
        self._waits: WarmUp | None = None
        self.between: deque[Callable[[], object]] = deque()
        self._paused_ns = self._acts_ns = self._acts_ticks = 0
        self.arrivals: Arrivals | None = None
        self.hang_ns = self.pacing.hang_ns(self.period_ns, program.platform.facts.simulated)
        self._tick = program.states["tick"]

    @property
    def lead_ns(self) -> int:
        """How long before a tick its warm-up begins at present, in [ns]; 0 without one."""
        return 0 if self._waits is None else self._waits.lead_ns

    @property
    def paused_ns(self) -> int:
        """How long it has stood still between two ticks for what others asked, in [ns].

        Single steps meanwhile are ticks of the run, a period each.
        """
        if not self._acts_ns:
            return self._paused_ns
        ticked = (self.statistics.count - self._acts_ticks) * self.period_ns
        return self._paused_ns + max(time.perf_counter_ns() - self._acts_ns - ticked, 0)

    def step(self, due_ns: int, begin_ns: int) -> bool:
        """Run one tick: step, then the deferred blocks. True when the graph is done.

        Args:
            due_ns: when it is due.
            begin_ns: now.

        Raises:
            Fault: a block tripped; the caller must close, which damps.
        """
        graph, stamps = self.graph, self._stamps
        if self.statistics.count == self.detail.at:
            self.detail()
        stamps[0] = begin_ns
        done = graph.step()
        try:
            if graph.deferred() or done:
                self.done = done = True
            return done
        finally:  # whatever is found behind `send`, the command of this tick has left
            self._tick += 1
            end = time.perf_counter_ns()
            if not graph.detailed:
                stamps[self._last] = end
            self.statistics.add(due_ns, end, stamps, graph.detailed)

    def run(self, limit: int, *, full_speed: bool = False) -> None:
        """Tick until the graph is done or asked to stop.

        Args:
            limit: most ticks.
            full_speed: tick as fast as it goes.

        Raises:
            Fault: a block tripped, or a tick hung.
        """
        program = self._program
        program.gate.hung, program.paced = self._hung, not full_speed
        status_every = max(1, round((1.0 if full_speed else STATUS_S) / program.period))
        if program.pacing.trigger == "state":
            self._triggered(limit, status_every, program.platform.wait)  # type: ignore[attr-defined]
        elif full_speed:
            self._unpaced(limit, status_every)
        else:
            self._paced(limit, status_every)

    def _unpaced(self, limit: int, status_every: int) -> None:
        while not self.stop and self.statistics.count < limit:
            if self.between:
                self._act()
                if self.stop:
                    break
            if self.step(now := time.perf_counter_ns(), now):
                break
            if self.statistics.count % status_every == 0:
                self._tell()

    def _paced(self, limit: int, status_every: int) -> None:
        wait = self._warm_up(WallClock(round(self.pacing.spin_us * 1e3))).until
        period, backlog = self.period_ns, 0 if self.pacing.overrun == "skip" else CATCH_UP
        statistics, now, gate = self.statistics, time.perf_counter_ns, self._program.gate
        due = self.first_ns or now() + min(period, 10_000_000)
        missed = max(now() - due, 0) // period  # the moment has passed: those behind it are kept
        due += missed * period
        statistics.overruns += missed
        while not self.stop and statistics.count < limit:
            if self.between:
                self._act()
                if self.stop:
                    break
                due = max(due, now())
            gate.until_ns = due + self.hang_ns
            if (begin := wait(due)) > gate.until_ns:
                self._missed(now() - due)
            self.next_due_ns = due + period
            try:
                done = self.step(due, begin)
            except BaseException:
                statistics.overruns += max(-(-(now() - due - period) // period), 0)
                raise
            if done:
                break
            due += period
            late = now() - due
            if late > 0:
                missed = -(-late // period)
                dropped = max(missed - backlog, 0)
                # Each deadline that no tick met counts, those caught up when they run.
                statistics.overruns += max(dropped, 1)
                due += dropped * period
                if late > self.hang_ns:
                    raise Hung(self._hung())
            if statistics.count % status_every == 0:
                self._tell()

    def _missed(self, late_ns: int) -> None:
        """Count the ticks that nobody ran, and end the run: the process stood still.

        Raises:
            Fault: always.
        """
        self.statistics.overruns += late_ns // self.period_ns
        raise Hung(
            f"no tick ran for {late_ns * 1e-9:.2f} s: the process was stopped or starved between "
            f"two ticks; more than {self.hang_ns * 1e-9:g} s are a fault (pacing.hang)"
        )

    def _hung(self) -> str:
        """Return what is said of the present tick, which took too long: the slowest block."""
        stamps, names = self.graph.stamps, [block.name for block in self.graph.blocks]
        if not self.graph.detailed:
            names = [self.statistics.group_label(i) for i in range(len(names))]
        ends = sorted((int(end), name) for end, name in zip(stamps[2:], names) if end > stamps[0])
        before, slowest, longest = int(stamps[0]), "a block that has not ended", 0
        for end, name in ends:
            if end - before > longest:
                slowest, longest = name, end - before
            before = end
        if time.perf_counter_ns() - before > longest:  # it has no stamp yet
            slowest, longest = "what ran last", time.perf_counter_ns() - before
        return (
            f"a tick hung: {slowest} took {longest * 1e-9:.2f} s; ticks that are late by more than "
            f"{self.hang_ns * 1e-9:g} s are a fault (pacing.hang)"
        )

    def _triggered(self, limit: int, status_every: int, wait: Callable[[float], bool]) -> None:
        """Tick when data arrive; without data at a slow pace, so that safety sees that they lack.

        Where data come more often than ticks, the one is waited for that is expected nearest to
        the deadline; what has come before is taken in as old. The state of a tick is then as fresh
        as a message can be, not up to an interval old. Deadlines are absolute there, so that early
        and late arrivals do not add up to another rate.
        """
        statistics, now, period = self.statistics, time.perf_counter_ns, self.period_ns
        platform = self._program.platform
        until = self._warm_up(WallClock(round(self.pacing.spin_us * 1e3))).until
        if self.pacing.cpu is None:
            wait = staying(wait)
        spin = self.pacing.arrival_spin_ns(period)
        patience, every = 3e-9 * period, self.pacing.every or 0
        # A phase before may have measured it: while that is done nothing is sent.
        arrivals = self.arrivals = self.arrivals or self._first_arrivals(wait, patience)
        due = last = self.first_ns - period if self.first_ns else now()
        if arrivals is None:
            until(self.first_ns)
        hasty, again, gate = 0, 0, self._program.gate
        silence = round(1e9 * patience) + 2 * period + self.hang_ns
        while not self.stop and statistics.count < limit:
            if self.between:
                self._act()
                if self.stop:
                    break
                last = now()
            came = False
            if arrivals is not None:
                often = 1.5 * arrivals.interval_ns < period
                if self._counted(arrivals):
                    due = last + round(every * arrivals.interval_ns)
                else:
                    due = max(due + period, now()) if often else last + round(arrivals.interval_ns)
                expected = arrivals.nearest(due)
                until(expected - arrivals.lead_ns())
                if often:
                    platform.recv()
                if spin:
                    came = awaited(wait, expected, min(spin, round(arrivals.interval_ns / 2)))
            came = came or wait(patience)
            before, last = last, now()
            if not came:
                statistics.overruns += 1
            if last - before > silence:
                self._missed(last - before)
            gate.until_ns = last + self.hang_ns
            hasty = hasty + 1 if last - before < 0.6 * period else 0
            if hasty >= 5:  # they come faster than was measured
                arrivals = self.arrivals = self._arrivals(wait, patience)
                hasty = 0
                due = last = now()
            self.next_due_ns = (due if arrivals is not None else last) + period
            if self.step(last, last):
                break
            if came and arrivals is not None:
                arrivals.note(last)
                if often and arrivals.lost and statistics.count >= again:
                    again = statistics.count + ENOUGH * 4  # not after every tick
                    self._measure(arrivals, wait, due + period - 2 * round(arrivals.interval_ns))
            if statistics.count % status_every == 0:
                self._tell()

    def _counted(self, arrivals: Arrivals) -> bool:
        """Return whether each n-th of the data makes a tick, at the workflow's rate or near it.

        Data that change their rate later, or seem to on a busy machine, fall back to deadlines.
        """
        every = self.pacing.every
        often = self.period_ns / arrivals.interval_ns
        return every is not None and abs(every / often - 1.0) <= OTHER_RATE

    def _first_arrivals(self, wait: Callable[[float], bool], patience: float) -> Arrivals | None:
        """Return what `_arrivals` does before the first command.

        Raises:
            Fault: each n-th of the data comes at another rate than the workflow's.
        """
        every, tries = self.pacing.every, 3  # a process that has just started may miss some
        while True:
            arrivals = self._arrivals(wait, patience)
            if arrivals is None or every is None or self._counted(arrivals):
                return arrivals
            tries -= 1
            if not tries:
                rate, data = 1e9 / self.period_ns, 1e9 / arrivals.interval_ns
                raise Fault(
                    f"pacing.every is {every} and data come at {data:.4g} Hz, so ticks at "
                    f"{data / every:.4g} Hz, not at the workflow's {rate:.4g} Hz; set "
                    f"pacing.every: {max(round(data / rate), 1)}, or leave it out"
                )

    def _arrivals(self, wait: Callable[[float], bool], patience: float) -> Arrivals | None:
        """Return what tells when the data come, or None where nothing is known of them.

        Every arrival is waited for: later, a queue of one forgets those between two ticks.
        """
        platform, period = self._program.platform, self.period_ns
        if not isinstance(platform, CountsArrivals):
            return None
        times: list[int] = []
        platform.recv()
        while len(times) < 10 and not self.stop:
            if not wait(patience):
                return None
            times.append(time.perf_counter_ns())
            platform.recv()
            if len(times) == 4 and min(np.diff(times)) > 0.6 * period:
                break
        return Arrivals(times) if len(times) >= 2 else None

    def _measure(self, arrivals: Arrivals, wait: Callable[[float], bool], until_ns: int) -> None:
        """Measure anew when the data come, between two ticks; too few of them change nothing."""
        now, times = time.perf_counter_ns, list[int]()
        while not self.stop and (left := until_ns - now()) > 0 and wait(left * 1e-9):
            times.append(now())
            self._program.platform.recv()
        if len(times) >= ENOUGH:
            arrivals.measure(times)

    def _warm_up(self, clock: WallClock) -> WarmUp:
        able = any(block.warm_up is not None for block in self.graph.blocks)
        longest = round(self.pacing.dry_run_us * 1e3) if able else 0
        self._waits = WarmUp(self.graph.warm_up, clock, longest)
        return self._waits

    def _act(self) -> None:
        self._program.gate.until_ns = NEVER_NS  # a pause takes its time, and may tick
        self._acts_ns, self._acts_ticks = time.perf_counter_ns(), self.statistics.count
        try:
            for _ in range(len(self.between)):
                self.between.popleft()()
        finally:
            self._paused_ns = self.paused_ns
            self._acts_ns = 0

    def _tell(self) -> None:
        if self._status is not None:
            self._status()
