"""Case: one fault, how it is put into a run, and what is wanted; what was measured, and judged."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from unicon_ros.bench.faults.fault_run import FaultRun

__all__ = ["Case", "Measured", "Wants", "judge", "reaction"]

BLOCKS = "unicon_ros.bench.faults.blocks"
WALK: dict[str, Any] = {"chain": [{"pose": {"to": "stand", "duration": 0.4}}, {"policy": "walk"}]}
WOBBLE: dict[str, Any] = {f"{BLOCKS}:wobble": {}}


@dataclass(frozen=True)
class Wants:
    """What is wanted after a fault; None or empty: nothing.

    Attributes:
        most: commands (with stiffness) that may still leave.
        least: commands that must still leave: the run goes on.
        ms: until the platform is closed, which damps, in [ms].
        closed: the platform is closed.
        ended_ms: until the process has ended in [ms].
        status: exit statuses, any of them.
        reason: a part of the reason in the report, else of what was said.
        report: the report is on disk.
        gap_ms: longest time between two commands after the fault in [ms].
        overruns: ticks counted as missed, at least.
        zero_ms: until the velocity command is zero in [ms].
        speed: largest velocity command after the fault in [m/s], [rad/s].
        lost_s: what the recording may lack of the commands that left in [s].
        files: further files on disk.
    """

    most: int | None = 0
    least: int = 0
    ms: float | None = 250.0
    closed: bool = True
    ended_ms: float | None = None
    status: tuple[int, ...] = (3,)
    reason: str = ""
    report: bool = True
    gap_ms: float | None = None
    overruns: int = 0
    zero_ms: float | None = None
    speed: tuple[float, float, float] | None = None
    lost_s: float | None = None
    files: tuple[str, ...] = ()


@dataclass(frozen=True)
class Case:
    """One fault.

    Attributes:
        group: heading of the table.
        name: what goes wrong.
        fault: what the recording platform does, see there.
        wants: what is wanted.
        at: number of the tick in which it happens.
        flow: of the workflow: the policy, or a simple motion.
        workflow: further keys of the workflow file.
        arguments: further arguments of `unicon run` (or ROS arguments of the node); `{folder}` is
            the case's folder.
        duration: of the run in [s].
        outside: what the bench does to the process meanwhile.
        peer: module in `peers` and its arguments, started first.
        node: run by `unicon_node` instead of `unicon run`.
        topics: platform `ros`, whose robot is the peer; commands are those that it got.
        failing: what the middleware refuses: `take` of cmd_vel or `publish` of commands.
        output: where stdout and stderr go: `file`, `closed`, `device full`, `terminal`, or a
            `pipe` that nobody reads.
        file_limit: largest file that the process may write in [byte], as on a full disk.
        needs: packages without which it is left out.
        quick: one of the few that every test run takes.
    """

    group: str
    name: str
    wants: Wants
    fault: Mapping[str, Any] = field(default_factory=dict)
    at: int = 25
    flow: Any = field(default_factory=lambda: WOBBLE)
    workflow: Mapping[str, Any] = field(default_factory=dict)
    arguments: tuple[str, ...] = ()
    duration: float = 1.2
    outside: Callable[[FaultRun], None] | None = None
    peer: tuple[str, ...] = ()
    node: bool = False
    topics: bool = False
    failing: str = ""
    output: str = "file"
    file_limit: int | None = None
    needs: tuple[str, ...] = ()
    quick: bool = False

    @property
    def row(self) -> str:
        """Return the row of the table: group and name."""
        return f"{self.group}: {self.name}"


@dataclass
class Measured:
    """What was measured of a case.

    Attributes:
        commands: commands (with stiffness) that left after the fault.
        wild: commands after the fault, the closing ones too, not finite or outside of the limits.
        ticks: begun after the fault, until the platform was closed.
        ms: from the fault until the platform was closed in [ms], or None.
        ended_ms: from the fault until the process had ended in [ms], or None.
        status: exit status; minus a signal's number; None where the bench had to kill it.
        reason: why, in the words of the report; else what was said.
        disk: what is on disk, in words.
        gap_ms: longest time between two commands after the fault in [ms].
        overruns: of the report.
        zero_ms: from the fault until the velocity command was zero in [ms], or None.
        speed: largest velocity command after the fault.
        lost_s: what the recording lacks of the commands that left in [s], or None.
    """

    commands: int = 0
    wild: int = 0
    ticks: int | None = None
    ms: float | None = None
    ended_ms: float | None = None
    status: int | None = None
    reason: str = ""
    disk: list[str] = field(default_factory=list)
    gap_ms: float = 0.0
    overruns: int = 0
    zero_ms: float | None = None
    speed: tuple[float, float, float] = (0.0, 0.0, 0.0)
    lost_s: float | None = None


def judge(wants: Wants, got: Measured) -> list[str]:
    """Return what is not as wanted, each in words; empty where all is."""
    missed = []

    def ask(holds: bool, words: str) -> None:
        if not holds:
            missed.append(words)

    def within(value: float | None, bar: float | None, what: str) -> None:
        if bar is not None:
            said = "never" if value is None else f"after {value:.0f} ms"
            ask(value is not None and value <= bar, f"{what} {said}, wanted within {bar:.0f} ms")

    if wants.most is not None:
        ask(got.commands <= wants.most, f"{got.commands} commands, wanted at most {wants.most}")
    ask(got.commands >= wants.least, f"{got.commands} commands, wanted at least {wants.least}")
    ask(got.wild == 0, f"{got.wild} commands not finite or outside of the limits")
    if wants.closed:
        ask(got.ms is not None, "never damped")
        if got.ms is not None:
            within(got.ms, wants.ms, "damped")
    within(got.ended_ms, wants.ended_ms, "ended")
    within(got.zero_ms, wants.zero_ms, "velocity command zero")
    if wants.status:
        ask(got.status in wants.status, f"status {got.status}, wanted {_either(wants.status)}")
    ask(wants.reason in got.reason, f"reason lacks {wants.reason!r}")
    ask(not wants.report or "report" in got.disk, "no report")
    for file in wants.files:
        ask(file in got.disk, f"no {file}")
    if wants.gap_ms is not None:
        ask(got.gap_ms <= wants.gap_ms, f"{got.gap_ms:.0f} ms between two commands")
    ask(got.overruns >= wants.overruns, f"{got.overruns} overruns, wanted {wants.overruns}")
    if wants.speed is not None:
        fast = any(value > bar + 1e-5 for value, bar in zip(got.speed, wants.speed))
        ask(not fast, "velocity command {:.3g}, {:.3g}, {:.3g}".format(*got.speed))
    if wants.lost_s is not None:
        said = "no recording" if got.lost_s is None else f"recording lacks {got.lost_s:.1f} s"
        ask(got.lost_s is not None and got.lost_s <= wants.lost_s, said)
    return missed


def reaction(wants: Wants, got: Measured, by_topic: bool = False) -> str:
    """Return in words what a run did about a fault, of what is wanted of it.

    Args:
        by_topic: commands are those that a robot behind topics got.
    """
    parts = []
    if wants.zero_ms is not None:
        never = "velocity command never 0"
        parts.append(never if got.zero_ms is None else f"velocity 0 after {got.zero_ms:.0f} ms")
    if wants.speed is not None:
        parts.append("velocity {:.3g}, {:.3g}, {:.3g}".format(*got.speed))
    if wants.gap_ms is not None:
        parts.append(f"at most {got.gap_ms:.0f} ms between two commands")
    if wants.overruns:
        parts.append(f"{got.overruns} overruns told")
    if wants.lost_s is not None and got.lost_s is not None:
        parts.append(f"recording lacks {got.lost_s:.1f} s")
    if wants.closed and wants.most is not None:
        what = "last command" if by_topic else "damped"
        parts.insert(0, "never damped" if got.ms is None else f"{what} after {got.ms:.1f} ms")
    elif got.commands and not parts:
        parts.append("goes on")
    return ", ".join(parts)


def _either(statuses: tuple[int, ...]) -> str:
    return " or ".join(map(str, statuses))
