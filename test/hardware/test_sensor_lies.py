"""Sensors that lie in the midst of a walk: an emulated robot behind its protocol, and a policy."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import pytest
from emulated_runs import Served
from legged_peer import free_port
from peer import Peer

from unicon_ros.bench.report import free_domain

pytestmark = [pytest.mark.slow, pytest.mark.timeout(240), pytest.mark.usefixtures("assets")]

WALKS = {
    "go1": ("go1_walk", ()),
    "go2": ("go2_walk", ()),
    "g1_29dof": ("g1_walk", ("--posture=default", "--let-go=4.5")),
}
TURNING = "--set=commands=[{velocity_command: {constant: [0.4, 0.0, 0.5]}}]"
# Time from the first wrong frame to the first limp command in [s], and the reason. It is 0.3 s for
# one frame and 0.6 s for a window, and a tick of each side until the command is there.
FOUND = {
    "encoder": (0.3, "is its encoder sound"),
    "yaw": (0.35, "base_quat turned otherwise than the gyroscope says"),
    "gyro sign": (0.65, "base_quat turned otherwise than the gyroscope says"),
    "velocities frozen": (0.65, "velocit"),
    "velocities zero": (0.65, "velocit"),
    "velocity sign": (0.65, "velocit"),
    "repeat": (0.65, "measurements repeat|than the gyroscope says|velocit"),  # the seam may be seen
    "ageing": (0.65, "older than it was, by its own clock"),
}
AT = 10.0


def walked(
    processes: Callable[..., Peer],
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    robot: str,
    kind: str,
    seconds: float,
) -> tuple[int, str, dict[str, float]]:
    """Walk on a robot that lies; return status, what was said, and the times of the lie."""
    workflow, more = WALKS[robot]
    log = folder / "lies"
    log.touch()
    lies = {"kind": kind, "at": AT, "log": str(log)}
    monkeypatch.setenv("LIES", json.dumps(lies))
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parent))
    if robot == "go1":
        given = {"port": free_port()}
        platform, options = "unitree_legged", {"address": "127.0.0.1", **given}
    else:
        given = {"domain": free_domain()}
        platform, options = "unitree", {"address": "127.0.0.1", **given}
    sets = [f"--set={name}={value}" for name, value in given.items()]
    served = Served(
        processes,
        robot,
        "--face=lying_face:face",
        *sets,
        *more,
        platform=platform,
        options={**options, "connect": 30, "silence": 1.0},
    )
    sent = served.run(
        workflow, folder, TURNING, f"--duration={seconds}", "--set=pacing.hang=5", patient=False
    )
    status = sent.wait(200)
    said = (folder / "run.txt").read_text()
    told: dict[str, float] = {}
    for line in log.read_text().splitlines():
        told = {**json.loads(line), **told}  # the first of each
    return status, said, told


@pytest.mark.parametrize("kind", FOUND)
@pytest.mark.parametrize("robot", WALKS)
def test_a_sensor_that_lies_in_a_walk_is_a_fault(
    processes: Callable[..., Peer],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    robot: str,
    kind: str,
) -> None:
    status, said, told = walked(processes, tmp_path, monkeypatch, robot, kind, AT + 8.0)
    within, reason = FOUND[kind]
    print(robot, kind, told.get("limp", 0) - told.get("lies", 0), said[-300:])
    assert status == 3, said
    assert re.search(reason, said), said
    assert told["limp"] - told["lies"] <= within


@pytest.mark.parametrize("robot", WALKS)
def test_late_and_lost_frames_of_a_sound_robot_are_no_fault(
    processes: Callable[..., Peer], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, robot: str
) -> None:
    """Each frame up to 20 ms late, 1 % of them lost; a policy may fall of it."""
    status, said, _ = walked(processes, tmp_path, monkeypatch, robot, "jitter", 60.0)
    assert status == 0 or "faults        the base leans" in said, said
