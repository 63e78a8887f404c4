"""Case: one fault, how it is put into a run, and what is wanted; and what was measured."""

from __future__ import annotations

import json
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

TICKS = 5
"""Random ticks at which a fault is put into runs."""

AS_THEY_ARE = (1.0, 1.0)
"""Factors of the gains that nobody has changed."""

BLOCKS = "faults.blocks"
WALK: dict[str, Any] = {"chain": [{"pose": {"to": "stand", "duration": 0.4}}, {"policy": "walk"}]}
WOBBLE: dict[str, Any] = {f"{BLOCKS}:wobble": {}}
COMMANDED: dict[str, Any] = {
    "chain": [
        {"pose": {"to": "stand", "duration": 0.4}},
        {
            "switch": {
                "on": {"commanded": {"hold": 0.3}},
                "cases": {
                    "no": {"chain": [{"pose": {"to": "stand", "duration": 0.3}}, "hold"]},
                    "yes": {"policy": "walk"},
                },
            }
        },
    ]
}
"""It walks while somebody commands it to, else it stands."""

NAN: dict[str, Any] = {"zip": [WOBBLE, {f"{BLOCKS}:broken": {"at": "{at}"}}]}
"""A motion whose targets become NaN in the tick of the fault."""


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
        report: the report is on disk; after a fault (status 3) the record of it, too.
        gap_ms: longest time between two commands after the fault in [ms].
        overruns: ticks counted as missed, at least.
        zero_ms: until the velocity command is zero in [ms].
        speed: largest velocity command after the fault in [m/s], [rad/s].
        lost_s: what the recording may lack of the commands that left in [s].
        files: further files on disk.
        stands_ms: until the targets stand still in [ms].
        refused: messages that were refused and counted, at least.
        gains: no command is changed (of `wobble` alone), but by these factors of stiffness and
            damping, which the last one has.
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
    stands_ms: float | None = None
    refused: int = 0
    gains: tuple[float, float] | None = None


@dataclass(frozen=True)
class Case:
    """One fault.

    Attributes:
        group: heading of the table.
        name: what goes wrong.
        fault: what the recording platform does, see there; unless told it marks the tick, and a
            block misbehaves.
        wants: what is wanted.
        at: number of the tick in which it happens.
        flow: of the workflow: the policy, or a simple motion.
        workflow: further keys of the workflow file; `{log}` in it and in the flow is the command
            log, `{at}` the tick, `{name}` a name that no other run has.
        arguments: further arguments of `unicon run` (or ROS arguments of the node); `{folder}` is
            the case's folder.
        duration: of the run in [s].
        outside: what the bench does to the process meanwhile; gets the FaultRun.
        peer: module in `peers` and its arguments, started first; `{at}` in them is the tick,
            `{workflow}` the file.
        node: run by `unicon_node` instead of `unicon run`.
        topics: platform `ros`, whose robot is the peer; commands are those that it got.
        mujoco: behind the log stands MuJoCo; else the fake robot, which counts as hardware.
        robot: `go2` or `g1`, see `ROBOTS` of simulated_case.py.
        failing: what the middleware does: it refuses `take` of cmd_vel or `publish` of commands,
            or everything (`all`).
        output: where stdout and stderr go: `file`, `closed`, `device full`, `terminal`, or a
            `pipe` that nobody reads.
        file_limit: largest file that the process may write in [byte], as on a full disk.
        again: arguments of `unicon run`, with which the workflow is started anew once the first
            run has ended; status and reason are those of the second, commands those of both.
        clear: node or robot whose latch is let go of before that.
        quick: one of the few that every test run takes.
        spread: it is run at so many random ticks; 0 for one that has its own moment, or none.
        ticks: first and last between which they are.
    """

    group: str
    name: str
    wants: Wants
    fault: Mapping[str, Any] = field(default_factory=lambda: {"mark": True})
    at: int = 25
    flow: Any = field(default_factory=lambda: WOBBLE)
    workflow: Mapping[str, Any] = field(default_factory=dict)
    arguments: tuple[str, ...] = ()
    duration: float = 1.2
    outside: Callable[[Any], None] | None = None
    peer: tuple[str, ...] = ()
    node: bool = False
    topics: bool = False
    mujoco: bool = False
    robot: str = "go2"
    failing: str = ""
    output: str = "file"
    file_limit: int | None = None
    again: tuple[str, ...] | None = None
    clear: str = ""
    quick: bool = False
    spread: int = TICKS
    ticks: tuple[int, int] = (10, 35)

    def drawn(self, seed: int = 0, most: int = TICKS) -> list[Case]:
        """Return the case at each of its ticks, at most so many; the same for the same seed."""
        if not self.spread:
            return [self]
        rng = np.random.default_rng([zlib.crc32(self.row.encode()), seed])
        first, last = self.ticks
        ticks = rng.choice(np.arange(first, last + 1), min(self.spread, most), replace=False)
        return [replace(self, at=tick) for tick in sorted(map(int, ticks))]

    @property
    def row(self) -> str:
        """Return the row of the table: group, name, and the robot if it is another than a Go2."""
        robot = "" if self.robot == "go2" else f", {self.robot}"
        return f"{self.group}: {self.name}{robot}"

    @property
    def outcome(self) -> str:
        """Return what is to come of it, in a word or two."""
        if "wind_down" in self.workflow:
            return "soft"
        if self.wants.zero_ms is not None:
            return "zero command"
        if self.wants.least or self.wants.speed is not None or self.wants.gains is not None:
            return "go on"
        return "refuse" if self.wants.status == (1,) else "damp"

    @property
    def marks(self) -> list[str]:
        """Return what it is run with besides: `mujoco`, `ros`, `child`."""
        found = {
            "mujoco": self.mujoco,
            "ros": self.node
            or bool(self.peer)
            or "--ros" in (*self.arguments, *(self.again or ())),
            "child": "platform" in self.workflow,
        }
        return [word for word, is_so in found.items() if is_so]

    @property
    def uses_policy(self) -> bool:
        """Return whether a policy is in the flow."""
        return '"policy"' in json.dumps(self.flow)

    @property
    def needs(self) -> set[str]:
        """Return the packages without which it is left out."""
        ros = "ros" in self.marks
        needed = {
            "rclpy": ros,
            "rosbags": ros or "--record" in self.arguments,
            "matplotlib": "--picture" in self.arguments,
            "onnxruntime": self.uses_policy,
            "mujoco": self.mujoco,
        }
        return {package for package, is_needed in needed.items() if is_needed}


@dataclass
class Measured:
    """What was measured of a case.

    Attributes:
        reached: the fault has begun.
        commands: commands (with stiffness) that left after the fault.
        wild: commands after the fault, the closing ones too, not finite or outside of the limits.
        beyond: what of the closing commands exceeds the damping command, in words.
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
        stands_ms: from the fault until the targets stood still in [ms], or None.
        refused: messages that were refused.
        changed: commands after the fault that `wobble` did not give so.
        gains: factors of stiffness and damping in the last of them.
    """

    reached: bool = True
    commands: int = 0
    wild: int = 0
    beyond: list[str] = field(default_factory=list)
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
    stands_ms: float | None = None
    refused: int = 0
    changed: int = 0
    gains: tuple[float, float] = AS_THEY_ARE
