"""Runner: runs a program until it is done, stopped or at fault, and damps at the end."""

from __future__ import annotations

import threading
import time
import traceback
from collections.abc import Callable
from contextlib import suppress

from unicon_base.errors import EmergencyStopPressed, Fault, Hung, Silence, UniconError
from unicon_core.flow import CompiledGraph, Node
from unicon_core.pacing import prepare_process, process_age_s
from unicon_core.platforms.platform import Resettable
from unicon_core.runtime.phases import WIND_DOWN, Damp, Phase, RunOptions, refuse_pace, status_facts
from unicon_core.runtime.report import Report, SpareFiles, reason_of
from unicon_core.runtime.startup_sequence import StartupSequence
from unicon_core.runtime.statistics import Starvation, advice_of
from unicon_core.runtime.ticker import Ticker
from unicon_core.signals import SIGNALS, Interrupted, signal_name
from unicon_core.workflow import Program

FEW = 256
"""Ticks whose time stamps are kept before the run; nobody asks for them."""

CLOSING = 3.0
"""How long `close` of another thread waits for the ticking one to damp, in [s]."""


class Runner:
    """Runs one program; `tick` and `close` may also be driven by a host such as the ROS node.

    While `run` ticks, its thread alone may use the program: `stop`, `call_soon` and `close` are
    for the others.

    Args:
        program: what to run; not closed, and not run before.
        options: how.

    Attributes:
        phase: what the run is at.
        operator: wait for `go` before a robot moves; as of the options, until it runs.
        graph: the compiled tick of the run.
        statistics: of the run's ticks.
        faults: what went wrong, one line each; the first is why the run ended.
        traceback: where the first fault came from, if it was no `Fault`; else "".
        at_fault: called where a fault ends the ticks, before the platform damps: microseconds.
        interrupted: a signal ended the run.
        pressed: an emergency stop ended the run.

    Raises:
        PlatformError: the platform cannot be paced as the workflow says.
        UniconError: the program is closed.
    """

    def __init__(self, program: Program, options: RunOptions | None = None) -> None:
        if program.gate.closed:
            raise UniconError(f"workflow {program.name} is closed; build it anew to run it again")
        self.program = program
        self.options = options or RunOptions()
        program.warn = self.options.warn
        refuse_pace(program, self.options)
        self.phase = Phase.WAIT
        self.monitor = program.monitor
        status = None if self.options.status is None else self._status
        compiles = self.options.compiler(program)
        ticks = self.options.capacity
        self._run = self._ticker = Ticker(program, program.root, ticks, status, compiles)
        if self.options.detail:
            self._run.detail.at = -1
        # Compiled now: between run and wind-down a robot would wait for its commands.
        self._ending_ticks = max(1, round(WIND_DOWN / program.period))
        self._ending = None
        if (root := program.wind_down) is not None:
            self._ending = Ticker(program, root, self._ending_ticks, None, compiles)
        self.operator = self.options.operator
        self._damp = Damp(program) if program.has_platform else None
        self._before = StartupSequence(program, self.options, self._ticked)
        self.graph, self.statistics = self._run.graph, self._run.statistics
        self.pacing, self.period_ns = program.pacing, self._run.period_ns
        self.faults: list[str] = []
        self.traceback = ""
        self.at_fault: list[Callable[[], object]] = []
        self.interrupted = self.pressed = False
        self._hurry = False
        self._closed = False
        self._thread: int | None = None
        self._ended = threading.Event()
        self._started_ns = 0
        self._age_s: float | None = None
        # Of a simulator no machine keeps anything waiting; `str` says nothing.
        simulated = program.platform.facts.simulated
        self._starvation: Callable[[], str] = str if simulated else Starvation()
        self._ended_ns = 0

    def graphs(self) -> dict[str, CompiledGraph]:
        """Return the compiled ticks by phase."""
        tickers = {Phase.RUN.value: self._run, Phase.SOFT.value: self._ending}
        return {name: each.graph for name, each in tickers.items() if each is not None}

    @property
    def next_due_ns(self) -> int:
        """When the next tick is due, on the clock of `time.perf_counter_ns`; 0 for at once.

        What comes after `send` may use the time until then.
        """
        if self.phase is Phase.DAMP and self._damp is not None:
            return self._damp.next_due_ns
        return self._ticker.next_due_ns

    @property
    def lead_ns(self) -> int:
        """How long before the next tick its warm-up begins at present, in [ns]; 0 without one."""
        return self._ticker.lead_ns

    @property
    def waits_for(self) -> str:
        """What is waited for before the flow; "" where nothing is."""
        return self._before.reason(self.phase)

    @property
    def asks(self) -> bool:
        """Whether an operator has to say go before the flow ticks."""
        program = self.program
        moves = not (program.platform.facts.simulated or program.silent) and program.has_platform
        return moves and self.operator and program.start.operator

    def go(self) -> bool:
        """Say that the robot may move; it counts where the operator alone is waited for."""
        return self.phase is Phase.WAIT and self._before.go()

    @property
    def done(self) -> bool:
        """Whether the flow of the run was done."""
        return self._run.done

    def stop(self) -> None:
        """Ask the phase to end after the present tick; safe from a signal handler or a thread.

        The run goes on to its wind-down, a wind-down to its end.
        """
        self._ticker.stop = True

    @property
    def stopping(self) -> bool:
        """Whether the present phase was asked to end."""
        return self._ticker.stop

    @property
    def paused_s(self) -> float:
        """How long the run has stood still between two ticks for actions of `call_soon`, in [s]."""
        return self._run.paused_ns * 1e-9

    def call_soon(self, action: Callable[[], object]) -> None:
        """Run an action between two ticks, in the thread of the ticks; safe from any thread.

        It may take its time (a pause): ticks missed meanwhile are not overruns. What it raises is
        a fault.
        """
        self._ticker.between.append(action)

    def reset(self) -> None:
        """Bring a simulator and the flow back to their beginning; call it between two ticks.

        Raises:
            UniconError: another thread ticks.
        """
        self._only_here("reset", "call_soon(runner.reset)")
        if isinstance(self.program.platform, Resettable):
            self.program.platform.reset()
        self.graph.reset()

    def tick(self, due_ns: int) -> bool:
        """Run one tick: step, then the deferred blocks. True when the flow is done.

        Raises:
            Fault: a block tripped; the caller must close, which damps.
            UniconError: another thread ticks.
        """
        self._only_here("tick", "call_soon")
        return self._ticker.step(due_ns, time.perf_counter_ns())

    def _only_here(self, what: str, instead: str) -> None:
        if self._thread not in (None, threading.get_ident()):
            raise UniconError(f"Runner.{what}: another thread ticks this workflow; use {instead}")

    def run(self) -> Report:
        """Run to the end and return the report; whatever goes wrong is in it, the platform closed.

        Every signal whose default action ends the process ends the run after the present tick; a
        second one damps at once, in the middle of the tick.

        Raises:
            UniconError: it runs already, or has run; or nobody can be met at the moment of its
                start: the platform is closed then.
        """
        if self._closed or self._thread is not None:
            state = "has ended" if self._closed else "is running"
            raise UniconError(f"Runner.run: this run {state}; build the workflow anew")
        try:
            self._before.meet()
        except BaseException:
            self._close()
            raise
        self._thread = threading.get_ident()
        with SIGNALS, SIGNALS.guard(self.stop, self._damp_now):
            if SIGNALS.asked:  # `|=` would undo what a signal sets in the middle of it
                self._run.stop = True
            restore: Callable[[], object] = bool
            fault: BaseException | None = None
            spare = SpareFiles()
            before, why = 0, ""
            try:
                try:
                    restore = prepare_process(self.pacing, self.options.warn)
                    if self.options.speed == "real":
                        self.statistics.take_memory()
                    self._started_ns = time.perf_counter_ns()
                    if self._before(self.asks):
                        self._run.first_ns = self._before.first_ns
                        self.phase = Phase.RUN
                        self._started_ns, self._age_s = time.perf_counter_ns(), process_age_s()
                        self._run.run(
                            self.options.ticks(self.program), full_speed=self.options.speed == "max"
                        )
                    self.interrupted = bool(SIGNALS.asked)
                    why = self._why()
                    self._ended_ns = time.perf_counter_ns()
                    self._wind_down()
                except BaseException as error:  # whatever it is, only damping is sent from now on
                    fault = error
                    spare.release()
                    pressed = isinstance(error, EmergencyStopPressed)
                    for latch in self.program.latches if pressed else ():
                        latch.set(str(error))  # a thread writes it
                    with suppress(Exception):  # whatever it is, the robot is damped
                        for act in self.at_fault:
                            act()
                self._ended_ns = self._ended_ns or time.perf_counter_ns()
                before = len(self.faults)
                self._damped(fault)
                self._close()
            except Interrupted as error:  # a second signal came just here; it has damped
                fault = fault or error
            spare.release()
            # Damped first, told afterwards; no signal raises any more.
            if fault is not None:
                self._failed(fault, before)
            if isinstance(fault, EmergencyStopPressed):
                self.pressed = True
                for latch in self.program.latches:
                    latch.kept()
            restore()
            self._thread = None
            self._ended.set()
            self.interrupted = bool(SIGNALS.asked)
            report = self.report()
            report.ended = "fault" if self.faults else why or self._why()
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
            return  # reported where the robot was damped
        try:
            reason = reason_of(error)
        except Exception:  # its text cannot be had
            reason = type(error).__name__
        if isinstance(error, Silence):
            reason += self._starvation()
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
        return "stopped" if self._run.stop else "duration"

    def close(self) -> None:
        """Damp and close, once. From another thread: end the run, which damps, and wait for it.

        A wind-down is left out.

        Raises:
            UniconError: the ticking thread did not end in time; nothing is sent any more.
        """
        if self._thread in (None, threading.get_ident()):
            self._close()
            return
        self._hurry = True
        self.stop()
        if not self._ended.wait(CLOSING):
            self.program.gate.close()
            raise UniconError(
                f"Runner.close: the ticking thread did not end within {CLOSING:g} s; it sends "
                "nothing any more; end the process"
            )

    def _close(self) -> None:
        if not self._closed:
            self._closed, self.phase = True, Phase.OFF
            try:
                self.program.close()
            except Exception as error:
                self.faults.append(f"closing: {reason_of(error)}")
            self._before.close()

    def report(self) -> Report:
        """Return the report of the run so far."""
        statistics = self.statistics
        wall_ns = (self._ended_ns or time.perf_counter_ns()) - self._started_ns
        wall = max(wall_ns * 1e-9, 1e-9)
        report = Report.of(self.program, statistics, wall, self.paused_s)
        if self._age_s is not None and 0 < statistics.count <= self.options.capacity:
            first = int(statistics.kept()[0, 2])
            report.startup_s = round(self._age_s + (first - self._started_ns) * 1e-9, 3)
            report.extra |= self._before.facts(first)
        report.advice = advice_of(statistics, self.pacing, self.options.speed, self.period_ns)
        report.faults = list(self.faults)
        report.traceback = self.traceback
        return report

    def _ticked(self, phase: Phase, tree: Node, hang_ns: int | None) -> bool:
        """Tick another tree before the run until it is done; False where the run is to end.

        Args:
            phase: that this is.
            tree: of a tick.
            hang_ns: how late ticks may be, where that is not as in the run.
        """
        self.phase, run = phase, self._run
        ticker = self._ticker = Ticker(self.program, tree, FEW, None)
        if hang_ns is not None:
            ticker.hang_ns = hang_ns
        if run.stop:  # what a signal sets at any moment counts
            ticker.stop = True
        ticker.run(1 << 62)
        self._ticker = run
        if ticker.stop:
            run.stop = True
        run.arrivals = ticker.arrivals
        self.program.states["tick"][...] = 0
        return ticker.done

    def _damped(self, fault: BaseException | None) -> None:
        """Send the damping command for its time, where anything was sent at all.

        A simulation that ended well is left as it is.
        """
        program = self.program
        if self._damp is None or not program.gate.sent.any or program.gate.closed:
            return
        if fault is None and not SIGNALS.asked and program.platform.facts.simulated:
            return
        self.phase = Phase.DAMP
        self.monitor.finish()
        try:
            self._damp.run(hear=not isinstance(fault, Hung))
        except Interrupted:
            raise
        except BaseException:  # `close` damps by its own means, and tells
            pass

    def _wind_down(self) -> None:
        """Tick the flow that follows the run; commands are zero from here on."""
        ending = self._ending
        if ending is None or self._hurry or self.program.gate.closed:
            return
        if self.phase is not Phase.RUN or not self.program.gate.sent.any:
            return  # it waited, or has not come to where its flow begins
        self.phase = Phase.SOFT
        self.monitor.finish()
        self.program.states["velocity_command"][...] = 0.0
        ending.arrivals = self._run.arrivals
        self._ticker = ending
        if self._hurry:  # asked for just now
            ending.stop = True
        ending.run(self._ending_ticks, full_speed=self.options.speed == "max")

    def _status(self) -> None:
        assert self.options.status is not None
        facts = status_facts(self.statistics, self._started_ns, self.program, self.phase)
        self.options.status(facts | ({"faults": len(self.faults)} if self.faults else {}))
