"""Runs the command line against an emulated robot, both as processes, and says what it saw."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from peer import Peer

from unicon_ros.bench.report import free_domain

HERE = Path(__file__).resolve().parent
UNICON = (sys.executable, "-m", "unicon_ros")
PLATFORM = "udp_robot:make"
# How far a first command may be from where the joints are, [rad].
FIRST = 0.05
# For a busy machine in [s].
ROOM = 1.0
# Safety of the workflows, patient with a robot that a busy machine holds up.
PATIENT = (
    "[finite, joint_limits, tilt_stop, {stale_stop: {timeout: 5.0}}, {imu_stop: {timeout: 5.0}}, "
    "{joint_sensor_stop: {step: 10.0, drift: 10.0}}, {encoder_stop: {timeout: 5.0}}]"
)


class Served:
    """An emulated robot in a process of its own, and the platform that drives it.

    Args:
        processes: starts it.
        robot: its name, or its file.
        more: further arguments of `unicon emulate`.
        platform: what drives it.
        options: of the platform; those that depend on where it is served may come later.
    """

    safety, name = PATIENT, ""

    def __init__(
        self,
        processes: Callable[..., Peer],
        robot: str,
        *more: str,
        platform: str,
        options: dict[str, Any],
    ) -> None:
        self.platform, self.options = platform, options
        self.peer = processes(*UNICON, "emulate", robot, *more)
        self.peer.wait_for(
            lambda: bool(self.of("ready")) or self.peer.process.poll() is not None,
            "the robot",
            timeout=60.0,
        )
        assert self.of("ready"), self.peer.end()
        self.where = str(self.of("ready")[0]["where"])

    def of(self, kind: str) -> list[dict[str, Any]]:
        """Return what it has said of a kind."""
        return self.peer.of(kind)

    def wait_for(self, kind: str, count: int = 1, timeout: float = 60.0) -> dict[str, Any]:
        """Wait until it has said so many lines of a kind; return the last of them."""
        self.peer.wait_for(lambda: len(self.of(kind)) >= count, f"{count} {kind}", timeout=timeout)
        return self.of(kind)[count - 1]

    def moved(self) -> float:
        """End it, as a user would; return how far its base went, [m]."""
        self.peer.process.terminate()
        status, errors = self.peer.end()
        assert status == 0, errors
        return math.hypot(*self.of("ended")[0]["moved"][:2])

    def sets(self, platform: str = "", patient: bool = True) -> list[str]:
        """Return the arguments that let a workflow drive it, and leave the workflow as it is."""
        options = json.dumps({self.platform: self.options})
        found = [f"--set=platform={platform or self.platform}", f"--set=platforms={options}"]
        if patient:
            found += ["--set=pacing.hang=20", f"--set=safety={self.safety}"]
        return found

    def run(self, workflow: str, folder: Path, *more: str, **sets: Any) -> subprocess.Popen[str]:
        """Begin a run; what it says goes to `run.txt` in the folder, its report beside it."""
        report = folder / "report.json"
        report.unlink(missing_ok=True)
        command = [*UNICON, "run", workflow, *self.sets(**sets), "--yes", "--quiet"]
        with (folder / "run.txt").open("w") as output:
            return subprocess.Popen(
                [*command, f"--report={report}", *more],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                text=True,
            )


class Emulated(Served):
    """An emulated robot behind UDP, at a port of its own.

    Args:
        processes: starts it.
        robot: its name.
        more: further arguments of `unicon emulate`.
        options: of the face.
    """

    def __init__(
        self, processes: Callable[..., Peer], robot: str, *more: str, **options: Any
    ) -> None:
        os.environ["PYTHONPATH"] = str(HERE)  # the face, and the platform
        options = {"port": 0, "dead_man": 30.0, **options}
        given = [f"--set={name}={value}" for name, value in options.items()]
        patience = {"silence": 5, "connect": 30}
        super().__init__(
            processes,
            robot,
            "--face=udp_robot:face",
            *given,
            *more,
            platform=PLATFORM,
            options=patience,
        )
        self.port = int(self.where.rpartition(":")[2])
        self.options["port"] = self.port


class EmulatedUnitree(Served):
    """An emulated robot of Unitree, in a DDS domain of its own.

    Args:
        processes: starts it.
        robot: its name.
        more: further arguments of `unicon emulate`.
        options: of the face.
    """

    def __init__(
        self, processes: Callable[..., Peer], robot: str, *more: str, **options: Any
    ) -> None:
        domain = free_domain()
        given = [f"--set={name}={value}" for name, value in {**options, "domain": domain}.items()]
        reached = {"address": "127.0.0.1", "domain": domain, "silence": 5, "connect": 30}
        super().__init__(processes, robot, *given, *more, platform="unitree", options=reached)


def ended(run: subprocess.Popen[str], folder: Path, timeout: float = 120.0) -> dict[str, Any]:
    """Wait for a run to end well; return its report."""
    try:
        status = run.wait(timeout)
    finally:
        run.kill()
        run.wait(10)
    said = (folder / "run.txt").read_text()
    assert status == 0, said
    report: dict[str, Any] = json.loads((folder / "report.json").read_text())
    return report


def looked(robot: Served, folder: Path, *more: str, workflow: str = "go2_stand") -> Any:
    """Run preflight; return its exit status and what it wrote as JSON."""
    path = folder / "told.json"
    command = [*UNICON, "preflight", workflow, *robot.sets(), f"--json={path}", "--seconds=1.5"]
    done = subprocess.run([*command, *more], capture_output=True, text=True, timeout=240)
    assert path.exists(), done.stderr
    return done.returncode, json.loads(path.read_text())


def failed(told: dict[str, Any]) -> dict[str, str]:
    """Return the rows that fail."""
    return {row["name"]: row["told"] for row in told["rows"] if row["ok"] is False}
