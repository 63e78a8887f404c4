"""Drives a workflow against a stand-in robot on platform `ros`, and says what the robot saw."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ros_helpers import Peer

STAND_IN = (sys.executable, "-m", "unicon_ros.bench.standins.robot")
PLATFORM = ("--set", "platform=ros", "--set", "pacing.hang=20")

ROS_MAP_WITH_GAINS = """\
publish:
  - topic: joint_commands
    type: sensor_msgs/msg/JointState
    fields: {header.stamp: stamp_ns, name: $joint_names, position: joint_pos_target}
  - topic: joint_gains
    type: sensor_msgs/msg/JointState
    fields: {header.stamp: stamp_ns, name: $joint_names, effort: joint_stiffness}
"""


@dataclass(frozen=True)
class Driven:
    """What a run against a stand-in left.

    Attributes:
        status: exit status of `unicon`.
        report: its report; empty where it wrote none.
        output: what it said.
        first: how far the first command was from where the joints were, [rad]; None for none.
        last_first: likewise of the last command after a silence.
        count: commands that the robot got.
    """

    status: int
    report: dict[str, Any]
    output: str
    first: float | None
    last_first: float | None
    count: int


def stand_in(processes: Callable[..., Peer], robot: str, *arguments: str) -> Peer:
    """Start one and wait until it is there."""
    peer = processes(*STAND_IN, robot, *arguments)
    peer.wait_for(lambda: bool(peer.of("ready")), "the stand-in", timeout=60.0)
    return peer


def drive(
    peer: Peer, workflow: str, folder: Path, *, seconds: float = 3.0, more: Sequence[str] = ()
) -> Driven:
    """Run a workflow of `config/workflows/`, the same that runs in MuJoCo, and end the stand-in.

    The operator's go is left out. It is the whole run that is looked at: gates, approach, flow,
    damping.

    Args:
        peer: the stand-in.
        workflow: name or path.
        folder: for the report.
        seconds: of the flow.
        more: further arguments of `unicon run`.
    """
    return ended(begun(workflow, folder, seconds=seconds, more=more), peer, folder)


def begun(
    workflow: str, folder: Path, *, seconds: float, more: Sequence[str] = ()
) -> subprocess.Popen[str]:
    """Begin such a run, in a process."""
    command = [sys.executable, "-m", "unicon_ros", "run", workflow, *PLATFORM]
    command += ["--set", "start.operator=false", f"--duration={seconds}", "--quiet"]
    return subprocess.Popen(
        [*command, f"--report={folder / 'report.json'}", *more],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


def ended(run: subprocess.Popen[str], peer: Peer, folder: Path) -> Driven:
    """Wait for a run to end, end its stand-in, and return what both saw."""
    try:
        output, _ = run.communicate(timeout=120)
    finally:
        run.kill()
    firsts, count = seen(peer)
    path = folder / "report.json"
    report = json.loads(path.read_text()) if path.exists() else {}
    first, last = (firsts[0], firsts[-1]) if firsts else (None, None)
    return Driven(run.returncode, report, output, first, last, count)


def seen(peer: Peer) -> tuple[list[float], int]:
    """End a stand-in; return how far its first commands were, and how many it got."""
    peer.process.terminate()
    peer.end()
    firsts = [line["distance"] for line in peer.of("first")]
    counts = [line["count"] for line in peer.of("commands")]
    return firsts, (counts or [len(firsts)])[-1]
