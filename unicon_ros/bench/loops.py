"""Loops: the processes of one pipeline, held still (SIGSTOP) but for the slices that are measured.

A machine's speed changes by half within seconds (other tenants, clocks), so pipelines that are
measured one after the other are not measured alike. Here all of them live at once, discovered and
warm, and take turns of a second and less; a loop that is not measured costs nothing. No loop is
held as long as a lease: peers of which only one takes the other for dead do not meet again (Fast
DDS 2.14).
"""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from unicon_base import AnyDict, UniconError
from unicon_base.arrays import Bool, Float64, Int64
from unicon_core.signals import SIGNALS
from unicon_ros.bench.pipelines.log import beside
from unicon_ros.process_exit import die_with_parent

LEASE = 9.0
"""s for which a loop may be held: after 10 participants with `config/dds/no_shared_memory.xml` take
each other for dead, and commands are lost until they have met again (Fast DDS's own lease: 20)."""

SETTLE = 0.15  # s of a slice until the loop runs steadily again
BREATHS = 2.0  # s between two short times in which those that wait are let go
PATIENCE = 30.0  # s until the first command must have come, and until a process must have ended
GRACE_NS = 50_000_000  # a command that was sent later before the end of a slice may be under way


@dataclass(frozen=True)
class Slice:
    """One turn of a loop, times in [ns] of the wall clock.

    Attributes:
        begin, end: what lies between is measured.
        cpu_share: CPU time of the controller's process per time, of one core.
        measuring_share: that of the process which notes what arrives.
    """

    begin: int
    end: int
    cpu_share: float
    measuring_share: float

    def holds(self, times: Int64) -> Bool:
        """Return which times lie within."""
        return (times >= self.begin) & (times <= self.end)

    def fresh(self, stamps: Int64) -> Bool:
        """Return which states were made in this turn: the age of others counts the time held."""
        return stamps >= self.begin - round(SETTLE * 1e9)


@dataclass
class Loop:
    """Robot (or observer) and controller of a pipeline.

    Args:
        name: for messages.
        measuring: command line of the process that notes what arrives.
        controller: command line of the other; None where the first is both.
        environment: of both.
        log: file that the first writes at its end; the other's has `_controller` in its name.
    """

    name: str
    measuring: list[str]
    controller: list[str] | None
    environment: dict[str, str]
    log: Path
    slices: list[Slice] = field(default_factory=list)
    _processes: list[subprocess.Popen[bytes]] = field(default_factory=list)

    @property
    def controller_log(self) -> Path:
        """Return the file of the controller's log."""
        return beside(self.log, "controller")

    @property
    def _flag(self) -> Path:
        return self.log.with_suffix(".ready")

    def start(self, meanwhile: Callable[[], object] = lambda: None) -> None:
        """Start both, wait until what the controller sends arrives, and hold them.

        Args:
            meanwhile: called now and then; lets those breathe that are held.

        Raises:
            UniconError: nothing arrived, twice; or a process ended.
        """
        for _ in range(2):  # discovery on a busy machine may outlast the patience once
            self._flag.unlink(missing_ok=True)
            for command, log in (
                (self.controller, self.controller_log),
                (self.measuring, self.log),
            ):
                if command is not None:
                    self._processes.append(self._process([*command, "--out", str(log)]))
            if self._ready(meanwhile):
                time.sleep(2 * SETTLE)
                self.hold()
                return
            self.end()
            self.close()
        raise UniconError(f"{self.name}: no command arrived within {PATIENCE:g} s")

    def run(self, seconds: float) -> None:
        """Let both go for a settling time and then `seconds`, and note the slice."""
        self.let_go()
        time.sleep(SETTLE)
        both = self._processes[0].pid, self._processes[-1].pid
        begin, cpu = time.time_ns(), [cpu_ns(pid) for pid in both]
        time.sleep(seconds)
        end, used = time.time_ns(), [cpu_ns(pid) - was for pid, was in zip(both, cpu)]
        self.hold()
        if any(process.poll() is not None for process in self._processes):
            raise UniconError(f"{self.name}: one of its processes has ended")
        self.slices.append(Slice(begin, end, *(each / (end - begin) for each in used)))

    def let_go(self) -> None:
        """Let both run."""
        for process in self._processes:
            process.send_signal(signal.SIGCONT)

    def hold(self) -> None:
        """Stop both."""
        for process in reversed(self._processes):  # the source of states first
            process.send_signal(signal.SIGSTOP)

    def end(self) -> None:
        """Ask both to write their logs and end; once, since a second signal may end them sooner."""
        for process in self._processes:
            process.send_signal(signal.SIGTERM)
            process.send_signal(signal.SIGCONT)

    def close(self) -> None:
        """Wait until both have ended, as `end` asked them to; what does not end is killed."""
        for process in self._processes:
            try:
                process.wait(PATIENCE)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        self._processes = []

    def samples(self) -> list[dict[str, Float64]]:
        """Return the rows of each slice in [µs] (`cpu`, `lost`, `stale` in %); after `close`."""
        if not (self.log.exists() and self.controller_log.exists()):
            return [{} for _ in self.slices]
        measured, controlled = dict(np.load(self.log)), dict(np.load(self.controller_log))
        rows = _bridged if "seen" in controlled else _mirrored
        samples = [rows(each, measured, controlled) for each in self.slices]
        heard = beside(self.controller_log, "heard")
        if heard.exists():
            states = dict(np.load(heard))
            for sample, each in zip(samples, self.slices):
                if (latency := _under_way(each, states)).size:
                    sample["one_way"] = latency
        return samples

    def _process(self, command: list[str]) -> subprocess.Popen[bytes]:
        return subprocess.Popen(
            command,
            env=self.environment,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,  # the terminal's Ctrl-C is ours: they are asked to end
            # Held processes would outlive a parent that is killed.
            preexec_fn=die_with_parent if sys.platform == "linux" else None,
        )

    def _ready(self, meanwhile: Callable[[], object]) -> bool:
        now = time.monotonic()
        end, breath = now + PATIENCE, now + BREATHS
        while not self._flag.exists():
            SIGNALS.check()
            now = time.monotonic()
            if now > end or any(p.poll() is not None for p in self._processes):
                return False
            if now > breath:
                meanwhile()
                breath = now + BREATHS
            time.sleep(0.02)
        return True


def breathe(loops: Iterable[Loop]) -> None:
    """Let held loops go for a moment, in which peers tell each other that they live."""
    held = list(loops)
    for loop in held:
        loop.let_go()
    time.sleep(SETTLE)
    for loop in held:
        loop.hold()


def _bridged(each: Slice, measured: AnyDict, controlled: AnyDict) -> dict[str, Float64]:
    ticks = each.holds(controlled["end"]) & each.fresh(controlled["stamp"])
    part = {name: controlled[name][ticks] for name in ("stamp", "seen", "begin", "end")}
    latency = _under_way(each, measured)
    if not part["stamp"].size or not latency.size:
        return {}
    due = part["stamp"][part["end"] < each.end - GRACE_NS]
    lost = ~np.isin(due, measured["stamp"])
    rows = {
        "recv": (part["seen"] - part["stamp"]) * 1e-3,
        "send": (part["end"] - part["begin"]) * 1e-3,
        "state_to_command": (part["end"] - part["stamp"]) * 1e-3,
        "end_to_end": latency,
        "cpu": np.array([100.0 * each.cpu_share]),
        "lost": np.array([100.0 * lost.mean() if lost.size else 0.0]),
        "stale": np.array([100.0 * (np.diff(part["stamp"]) == 0).sum() / part["stamp"].size]),
    }
    if "cost" in controlled:  # of the calls alone, without the waiting; -1 where nothing was told
        cost = controlled["cost"][ticks]
        if (cost := cost[cost >= 0]).size:
            rows["recv_and_send"] = cost * 1e-3
    return rows


def _mirrored(each: Slice, measured: AnyDict, controlled: AnyDict) -> dict[str, Float64]:
    row, since, to_wall = "send", "begin", 0
    if "stamp" in controlled:  # a driver's, of the monotonic clock
        row, since, to_wall = "state_to_command", "stamp", time.time_ns() - time.monotonic_ns()
    ticks = each.holds(controlled["end"] + to_wall)
    latency = _under_way(each, measured)
    if not ticks.any() or not latency.size:
        return {}
    return {
        "mirror": latency,
        row: (controlled["end"] - controlled[since])[ticks] * 1e-3,
        "cpu": np.array([100.0 * each.cpu_share]),
    }


def _under_way(each: Slice, log: AnyDict) -> Float64:
    """Return how long messages that arrived in a slice took, in [µs]."""
    latency: Float64 = (log["received"] - log["stamp"]) * 1e-3
    return latency[each.holds(log["received"]) & each.fresh(log["stamp"])]


def cpu_ns(process: int) -> int:
    """Return the CPU time of a process in [ns], all its threads: clock_getcpuclockid(3)."""
    return time.clock_gettime_ns((~process << 3) | 2)
