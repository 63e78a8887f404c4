"""Report: what a run did, as one JSON object and as a readable summary."""

from __future__ import annotations

import errno
import math
import os
import resource
import traceback
from dataclasses import dataclass, field
from pathlib import Path

from unicon_base import AnyDict, Fault
from unicon_core.page import plain, write_json
from unicon_core.runtime.statistics import TickStatistics, percentiles
from unicon_core.workflow.policies import shadowed_in
from unicon_core.workflow.program_data import ProgramData


@dataclass
class Report:
    """One run.

    Attributes:
        workflow, robot, platform: names.
        ticks: number of ticks.
        duration_s: time of the run, simulated where the platform is a simulator.
        wall_s: wall time from the first tick to the end.
        paused_s: of that, how long a pause or another request between two ticks took.
        rate_hz: ticks per second of wall time, pauses left out.
        overruns: deadlines that were missed, one by one.
        overrun_blocks: label to number of ticks that ended late because of that block most.
        startup_s: from the start of the process to the first tick, wall time.
        tick_us: p50, p99, max from `recv` to the end of `send`.
        late_us: p50, p99, max of start minus deadline.
        faults: what went wrong, one line each.
        safety: labels of the blocks between the flow and `send`; empty with `safety: none`.
        safety_left_out: safety blocks that this robot does not have, each with the reason.
        forced: codes of the check's errors that it was run with.
        base_displacement_m: base position at the end minus at the start, world frame; None where
            the robot's base is fixed, as are `fell` and `tilt_deg`.
        fell: the base tilted by more than 60° from upright; None where a gantry holds it.
        sank: the base of the first robot ended below half of the height where it began.
        tilt_deg: largest tilt of the base from upright.
        sha256_commands: SHA-256 over the command states of every tick.
        dry: nothing was sent; the hash is of what would have been.
        blocks: block label to p50, p99, max.
        bridge: published and received messages, where ROS is on.
        advice: what would help a run whose ticks began late; else empty.
        ended: what ended the run: done, duration, stopped, fault, or the name of a signal.
        traceback: of the first fault, where it was an exception of a block's code; else empty.
    """

    workflow: str
    robot: str
    platform: str
    ticks: int = 0
    duration_s: float = 0.0
    wall_s: float = 0.0
    paused_s: float = 0.0
    rate_hz: float = 0.0
    overruns: int = 0
    overrun_blocks: dict[str, int] = field(default_factory=dict)
    startup_s: float | None = None
    tick_us: dict[str, float] = field(default_factory=dict)
    late_us: dict[str, float] = field(default_factory=dict)
    faults: list[str] = field(default_factory=list)
    safety: list[str] = field(default_factory=list)
    safety_left_out: dict[str, str] = field(default_factory=dict)
    forced: list[str] = field(default_factory=list)
    base_displacement_m: list[float] | None = field(default_factory=lambda: [0.0, 0.0, 0.0])
    fell: bool | None = False
    sank: bool = False
    tilt_deg: float | None = 0.0
    sha256_commands: str = ""
    dry: bool = False
    blocks: dict[str, dict[str, float]] = field(default_factory=dict)
    advice: str = ""
    ended: str = ""
    traceback: str = ""
    bridge: AnyDict | None = None
    extra: AnyDict = field(default_factory=dict)

    @classmethod
    def of(
        cls, program: ProgramData, statistics: TickStatistics, wall: float, paused: float = 0.0
    ) -> Report:
        """Return what a program did, but for what its runner alone knows.

        Args:
            program: that was run.
            statistics: of the run's ticks.
            wall: time of the run in [s], above 0.
            paused: how long of it the run stood still in [s].
        """
        ticks, overruns = statistics.count, statistics.overruns
        extra: AnyDict = {}
        if (shadowed := shadowed_in(program.blocks)) is not None:
            extra["shadow"] = shadowed.found()
        for (name, _), network in program.context.networks.items():
            if latency := network.latency():
                extra.setdefault("remote", {})[name] = {
                    what: percentiles(times) for what, times in latency.items()
                }
        return cls(
            program.name,
            program.robot.name,
            program.platform.facts.name,
            ticks=ticks,
            duration_s=round(ticks * program.period, 9),
            wall_s=round(wall, 3),
            paused_s=round(paused, 3),
            rate_hz=round(ticks / max(wall - paused, 1e-9), 3),
            overruns=overruns,
            overrun_blocks=statistics.overrun_blocks(program.period * 1e6) if overruns else {},
            tick_us=statistics.tick_us(),
            late_us=statistics.lateness_us(),
            safety=list(program.safety),
            safety_left_out=dict(program.safety_left_out),
            forced=list(program.forced),
            blocks=statistics.block_us(),
            extra=extra,
            **program.monitor.found(),
        )

    def to_dict(self) -> AnyDict:
        """Return the report as plain values; `bridge` only where ROS was on."""
        values = {k: v for k, v in vars(self).items() if k not in ("bridge", "extra")}
        if self.bridge is not None:
            values["bridge"] = self.bridge
        return values | self.extra

    def write(self, path: str | Path) -> None:
        """Write the report as JSON, folders made as needed."""
        write_json(Path(path), plain(self.to_dict()), folders=True)

    def base_moved(self) -> str:
        """Return in words how far the base moved and tilted, or that it is fixed or held."""
        if self.base_displacement_m is None or self.tilt_deg is None:
            return "fixed"
        x, y, z = (round(value, 2) + 0.0 for value in self.base_displacement_m)  # no -0.00
        held = "hangs on a gantry (scene.gantry), " if self.fell is None else ""
        moved = (
            f"moved {x:+.2f} {y:+.2f} {z:+.2f} m" if math.isfinite(x + y + z) else "place not known"
        )
        return f"{held}{moved}, tilted up to {self.tilt_deg:.0f}°"

    def wall_text(self) -> str:
        """Return wall time and rate in words; a pause of less than 10 ms is not worth one."""
        paused = f", paused for {self.paused_s:.2f} s of it" if self.paused_s >= 0.01 else ""
        return f"{self.wall_s:.2f} s{paused}, {self.rate_hz:.1f} ticks per second"

    def summary(self) -> str:
        """Return the readable lines that end a run."""
        shadow = self.extra.get("shadow")
        share = f" ({self.overruns / self.ticks:.1%})" if self.ticks else ""
        if self.overrun_blocks:
            share += f", most by {', '.join(list(self.overrun_blocks)[:3])}"
        upright = "" if self.faults or self.fell is None else ", did not fall"
        if self.sank and self.base_displacement_m is not None:
            upright += f", sank by {-self.base_displacement_m[2]:.2f} m"
        lines = [
            f"workflow      {self.workflow} on {self.robot} ({self.platform})",
            f"ticks         {self.ticks}, {self.duration_s:.2f} s of ticks",
            f"wall time     {self.wall_text()}",
            f"overruns      {self.overruns}{share}",
            f"tick          p50 {self.tick_us.get('p50', 0):.0f} µs, "
            f"p99 {self.tick_us.get('p99', 0):.0f} µs, max {self.tick_us.get('max', 0):.0f} µs",
            f"base          {self.base_moved()}{', FELL' if self.fell else upright}",
        ]
        if self.startup_s is not None:
            lines.insert(1, f"start-up      {self.startup_s:.2f} s to the first tick")
        if self.bridge is not None:
            lines.append(
                f"ROS 2         published {self.bridge.get('published', 0)}, "
                f"received {self.bridge.get('received', 0)} messages"
            )
        for name, found in self.extra.get("remote", {}).items():
            times = (
                f"{what} p50 {found[key]['p50']:.1f} ms, p99 {found[key]['p99']:.1f} ms"
                for what, key in (("round trip", "round_trip_ms"), ("inference", "inference_ms"))
            )
            lines.append(f"remote        {name}: {', '.join(times)}")
        if self.dry:
            lines.append("dry           nothing was sent")
        if shadow is not None:
            lines.append(f"shadow        {shadow['says']}")
        if self.safety_left_out:
            lines.append(f"safety        without {', '.join(self.safety_left_out)}")
        if self.forced:
            lines.append(f"forced        {', '.join(self.forced)}")
        if self.advice:
            lines.append(f"advice        {self.advice}")
        lines.append(f"ended         {self.ended}")
        lines.append(f"faults        {'; '.join(self.faults) or 'none'}")
        return "\n".join(lines)


def reason_of(error: BaseException) -> str:
    """Return an exception in one line; what is not a `Fault` with its kind and place."""
    if isinstance(error, Fault):
        return str(error)
    text = " ".join(str(error).split())
    frames = traceback.extract_tb(error.__traceback__)
    place = f" ({Path(frames[-1].filename).name}:{frames[-1].lineno})" if frames else ""
    return f"{type(error).__name__}{': ' if text else ''}{text}{place}{out_of_files(error)}"


SPARE = 16
"""Damping, the report, the fault record and lazy imports have at most a few open at once."""


class SpareFiles:
    """Holds descriptors; `release` gives them back, any number of times.

    A process that has none to spare holds as many as it gets.
    """

    def __init__(self) -> None:
        self._held: list[int] = []
        try:
            for _ in range(SPARE):
                self._held.append(os.open(os.devnull, os.O_RDONLY))
        except OSError:  # what it wants to open itself tells
            self.release()

    def release(self) -> None:
        """Close them."""
        while self._held:
            os.close(self._held.pop())


def out_of_files(error: BaseException) -> str:
    """Return the limit and the remedy where a process ran out of file descriptors, else ""."""
    if not isinstance(error, OSError) or error.errno != errno.EMFILE:
        return ""
    limit = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    return (
        f"; this process may have {limit} files open: close what is opened again and again, or "
        f"raise the limit: ulimit -n {max(4096, 4 * limit)}"
    )
