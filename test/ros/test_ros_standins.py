"""A stand-in robot behind topics: looked at in silence, and moved a little."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from peer import Peer
from standin_runs import FIRST, PLATFORM, drive, patient_map, seen, stand_in

from unicon_core.runtime import Runner
from unicon_core.workflow import load_workflow
from unicon_ros.cli.main import main

pytestmark = [pytest.mark.ros, pytest.mark.timeout(300)]


def told_of(path: Path, *arguments: str, workflow: str = "go2_walk") -> tuple[int, dict[str, Any]]:
    """Run preflight against platform `ros`."""
    sets = [*PLATFORM, f"--set=platforms.ros.map={patient_map(path.parent)}"]
    status = main(["preflight", workflow, *sets, f"--json={path}", *arguments])
    return status, json.loads(path.read_text()) if path.exists() else {}


@pytest.mark.slow
def test_preflight_sees_all_and_the_robot_hears_nothing(
    processes: Callable[..., Peer], tmp_path: Path
) -> None:
    loud_map = patient_map(tmp_path, gains=True)
    peer = stand_in(processes, "go2", "--seed=3")
    given = ["--set", f"platforms.ros.map={loud_map}"]
    status, told = told_of(tmp_path / "told.json", "--seconds=1.5", "--ros", *given)
    failed = {row["name"]: row["told"] for row in told["rows"] if row["ok"] is False}
    assert failed == {}
    assert status == 0
    rows = {row["name"]: row["told"] for row in told["rows"]}
    assert "nobody else sends to /joint_" in rows["commanders"]
    assert rows["estop"] == "/unicon/estop: not pressed"
    assert loud_map.name in rows["robot"]
    assert "accelerometer 9." in rows["imu"]
    assert max(told["first_command"].values()) < FIRST  # a pose begins where the robot is
    # Where opening fails it is silent, too: this topic never comes.
    missing = loud_map.read_text().replace("imu/data", "imu/nowhere")
    loud_map.write_text(missing)
    connect = ["--set", "platforms.ros.connect=0.5"]
    assert main(["preflight", "go2_walk", "--set", "platform=ros", *given, *connect]) == 1
    assert seen(peer) == ([], 0)


def test_what_is_sent_over_that_map_is_heard(
    processes: Callable[..., Peer], tmp_path: Path
) -> None:
    """Without `silent` the robot hears a command: what is counted above is real."""
    peer = stand_in(processes, "go2")
    loud_map = patient_map(tmp_path, gains=True)
    program = load_workflow("go2_walk", {"platform": "ros", "platforms.ros.map": str(loud_map)})
    Runner(program).tick(0)
    program.close()
    peer.wait_for(lambda: bool(peer.of("first")), "the command")


@pytest.mark.slow
def test_another_who_commands_the_robot_is_seen(
    processes: Callable[..., Peer], tmp_path: Path
) -> None:
    stand_in(processes, "go2")
    other = load_workflow("go2_walk", {"platform": "ros"})
    try:
        status, told = told_of(tmp_path / "told.json", "--seconds=2")
    finally:
        other.close()
    rows = {row["name"]: row["told"] for row in told["rows"] if row["ok"] is False}
    assert status == 1
    assert rows == {
        "commanders": "1 others send to /joint_commands; end them, one alone may command a robot"
    }


@pytest.mark.slow
def test_wiggle_over_topics_names_swapped_joints(
    processes: Callable[..., Peer], tmp_path: Path
) -> None:
    swapped = ("--swap", "FL_hip_joint", "FR_hip_joint")
    peer = stand_in(processes, "go2", "--posture=default", *swapped)
    status, told = told_of(tmp_path / "told.json", "--wiggle", "--yes")
    assert status == 1
    wrong = {each["joint"]: each["wrong"] for each in told["wiggle"] if each["wrong"]}
    assert set(wrong) == {"FL_hip_joint", "FR_hip_joint"}
    assert "FL_hip_joint moved instead of FR_hip_joint" in wrong["FR_hip_joint"]
    (first, *_), _ = seen(peer)
    assert first < 0.25  # of exchanged encoders the first target is of the other joint


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_a_dry_run_computes_all_and_the_robot_hears_nothing(
    processes: Callable[..., Peer], tmp_path: Path, seed: int
) -> None:
    peer = stand_in(processes, "go2", f"--seed={seed}")
    record = tmp_path / "dry.mcap"
    driven = drive(peer, "go2_walk", tmp_path, more=["--dry", "--ros", f"--record={record}"])
    assert driven.status == 0, driven.output
    assert driven.report["dry"] is True
    assert driven.report["ticks"] >= 100
    assert record.exists()
    assert (driven.first, driven.count) == (None, 0)


NO_IMU, IMU_GOES = "--set=imu_seconds=0", "--set=imu_seconds=20"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "status", "words"),
    [
        pytest.param(("g1_23dof",), 1, "waist_roll_joint", id="another variant"),
        pytest.param(("g1_29dof", NO_IMU), 1, "no message on /imu/data", id="no IMU"),
        pytest.param(
            ("g1_29dof", IMU_GOES),
            3,
            "topic /imu/data: no message for",
            id="IMU gone",
        ),
    ],
)
def test_preflight_of_a_g1_names_what_is_wrong_and_the_robot_hears_nothing(
    processes: Callable[..., Peer],
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    assets: Path,
    arguments: tuple[str, ...],
    status: int,
    words: str,
) -> None:
    peer = stand_in(processes, *arguments)
    assert told_of(tmp_path / "told.json", "--seconds=60", workflow="g1_walk")[0] == status
    output = "".join(capsys.readouterr())
    assert words in output
    assert ";" in output.partition(words)[2]
    assert seen(peer) == ([], 0)


def test_a_silent_session_leaves_out_the_topics_that_tell_commands(tmp_path: Path) -> None:
    from unicon_core import Program, block
    from unicon_ros.bridge import RosSession

    path = tmp_path / "mirror.yaml"
    text = "  - {{topic: {}, type: sensor_msgs/msg/JointState, fields: {{position: {}}}}}\n"
    entries = (("told", "joint_pos"), ("targets", "joint_pos_target"))
    path.write_text("publish:\n" + "".join(text.format(*entry) for entry in entries))
    for silent, left in ((True, ["/told"]), (False, ["/told", "/targets"])):
        warnings: list[str] = []
        session = RosSession(map=path, warn=warnings.append)
        try:
            program = Program(
                robot="go2",
                platform="fake",
                rate=50,
                flow=block("hold"),
                hooks=[session.hook],
                silent=silent,
            )
            topics = [out.topic for out in session.outgoing if out.topic in ("/told", "/targets")]
            assert topics == left
            assert any("a silent run sends none" in line for line in warnings) is silent
            program.close()
        finally:
            session.close()
