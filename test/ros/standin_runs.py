"""Drives a workflow against a stand-in robot on platform `ros`, and says what the robot saw."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from peer import Peer

FACE = "--face=unicon_hardware.emulate.ros_face:face"
STAND_IN = (*(sys.executable, "-m", "unicon_ros", "emulate"), FACE, "--model=fake")
OUTPUT = "run.txt"
PATIENT = (
    "[finite, joint_limits, tilt_stop, {stale_stop: {timeout: 5.0}}, {imu_stop: {timeout: 5.0}}, "
    "{joint_sensor_stop: {step: 10.0, drift: 10.0}}, {encoder_stop: {timeout: 5.0}}]"
)
"""Safety of the workflows, patient with a stand-in that a busy machine holds up."""
PLATFORM = ("--set=platform=ros", "--set=pacing.hang=20", f"--set=safety={PATIENT}")
FIRST = 0.05
"""How far a first command may be from where the joints are, [rad]."""
SILENCE = 3.0
"""Time-out of the topics of a robot here, [s]."""

MAP = Path(__file__).resolve().parents[2] / "config" / "maps" / "ros_robot.yaml"
PUBLISHED_GAINS = """\
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
        count: commands that the robot got.
    """

    status: int
    report: dict[str, Any]
    output: str
    first: float | None
    count: int


def patient_map(folder: Path, gains: bool = False) -> Path:
    """Write the map of plain topics with longer time-outs; with gains on `joint_gains`, or without.

    A platform that has gains damps whatever it has sent.
    """
    text = MAP.read_text().replace("timeout: 0.5", f"timeout: {SILENCE}")
    path = folder / ("map_with_gains.yaml" if gains else "map.yaml")
    path.write_text(text[: text.index("publish:")] + PUBLISHED_GAINS if gains else text)
    return path


def stand_in(processes: Callable[..., Peer], robot: str, *arguments: str) -> Peer:
    """Start one, in a posture drawn at random unless arguments say, and wait until it is there."""
    peer = processes(*STAND_IN, robot, "--posture=random", *arguments)
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
    workflow: str | Path,
    folder: Path,
    *,
    seconds: float = 60.0,
    operator: bool = False,
    gains: bool = False,
    more: Sequence[str] = (),
) -> subprocess.Popen[str]:
    """Begin such a run, in a process; what it says goes to a file, see `said`."""
    command = [sys.executable, "-m", "unicon_ros", "run", str(workflow), *PLATFORM]
    command += [f"--set=platforms.ros.map={patient_map(folder, gains)}"]
    command += [f"--set=start.operator={str(operator).lower()}", f"--duration={seconds}"]
    with (folder / OUTPUT).open("w") as output:
        return subprocess.Popen(
            [*command, "--quiet", f"--report={folder / 'report.json'}", *more],
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            text=True,
        )


def said(folder: Path) -> str:
    """Return what a run has said so far."""
    return (folder / OUTPUT).read_text()


def ended(run: subprocess.Popen[str], peer: Peer, folder: Path) -> Driven:
    """Wait for a run to end, end its stand-in, and return what both saw."""
    try:
        run.wait(timeout=120)
    finally:
        run.kill()
        run.wait(10)
    firsts, count = seen(peer)
    path = folder / "report.json"
    report = json.loads(path.read_text()) if path.exists() else {}
    return Driven(run.returncode, report, said(folder), firsts[0] if firsts else None, count)


def seen(peer: Peer) -> tuple[list[float], int]:
    """End a stand-in; return how far its first commands were, and how many it got."""
    peer.process.terminate()
    peer.end()
    firsts = [line["distance"] for line in peer.of("first")]
    counts = [line["count"] for line in peer.of("commands")]
    return firsts, (counts or [len(firsts)])[-1]
