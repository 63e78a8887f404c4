"""A stand-in robot behind topics: looked at in silence, driven by the workflow of MuJoCo."""

from __future__ import annotations

import json
import os
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import psutil
import pytest
from ros_helpers import Peer
from standin_runs import ROS_MAP_WITH_GAINS, begun, drive, ended, seen, stand_in

from unicon_core.platforms.child.platform import WATCHDOG
from unicon_core.platforms.kit.damping import DAMPING_TIME
from unicon_core.robots import load_robot
from unicon_core.runtime import Runner
from unicon_core.workflow import load_workflow
from unicon_ros.cli.main import main

pytestmark = [pytest.mark.ros, pytest.mark.timeout(300)]

ROOT = Path(__file__).resolve().parents[2]
FIRST = 0.05
"""How far a first command may be from where the joints are, [rad]."""
APPROACH_STEP = 0.5 * 0.02 * 1.01
"""Largest step between two commands of an approach in [rad]: 0.5 rad/s, unless a workflow says."""
STEP = 0.25
"""The same while a flow comes in. What a policy does later on a robot that hangs on nothing and
falls nowhere is its own."""
ROOM = 1.0
"""For a busy machine in [s]."""


@pytest.fixture
def loud_map(tmp_path: Path) -> Path:
    """The map of plain topics, with gains: a platform that has them damps whatever it has sent."""
    text = (ROOT / "config" / "maps" / "ros_robot.yaml").read_text()
    path = tmp_path / "gains.yaml"
    path.write_text(text[: text.index("publish:")] + ROS_MAP_WITH_GAINS)
    return path


def told_of(path: Path, *arguments: str) -> tuple[int, dict[str, Any]]:
    """Run preflight against platform `ros`."""
    sets = ["--set", "platform=ros", "--set", "pacing.hang=20"]
    status = main(["preflight", "go2_walk", *sets, f"--json={path}", *arguments])
    return status, json.loads(path.read_text()) if path.exists() else {}


def test_preflight_sees_all_and_the_robot_hears_nothing(
    processes: Callable[..., Peer], loud_map: Path, tmp_path: Path
) -> None:
    peer = stand_in(processes, "go2", "--seed=3")
    given = ["--set", f"platforms.ros.map={loud_map}"]
    status, told = told_of(tmp_path / "told.json", "--seconds=1.5", "--ros", *given)
    failed = {row["name"]: row["told"] for row in told["rows"] if row["ok"] is False}
    assert failed == {}
    assert status == 0
    rows = {row["name"]: row["told"] for row in told["rows"]}
    assert "nobody else sends to /joint_" in rows["commanders"]
    assert rows["estop"] == "/unicon/estop: not pressed"
    assert "gains.yaml" in rows["robot"]
    assert "accelerometer 9." in rows["imu"]
    assert max(told["first_command"].values()) < FIRST  # a pose begins where the robot is
    # Where opening fails it is silent, too: this topic never comes.
    missing = loud_map.read_text().replace("imu/data", "imu/nowhere")
    loud_map.write_text(missing)
    connect = ["--set", "platforms.ros.connect=0.5"]
    assert main(["preflight", "go2_walk", "--set", "platform=ros", *given, *connect]) == 1
    assert seen(peer) == ([], 0)


def test_what_is_sent_over_that_map_is_heard(
    processes: Callable[..., Peer], loud_map: Path
) -> None:
    """Without `silent` the robot hears a command: what is counted above is real."""
    peer = stand_in(processes, "go2")
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
    swapped = ("--swapped", "FL_hip_joint", "FR_hip_joint")
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


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_go2_in_any_posture_is_driven_by_the_workflow_of_the_simulation(
    processes: Callable[..., Peer], tmp_path: Path, seed: int
) -> None:
    driven = drive(stand_in(processes, "go2", f"--seed={seed}"), "go2_walk", tmp_path)
    assert driven.status == 0, driven.output
    assert driven.count >= 50
    assert driven.first is not None
    assert driven.first <= FIRST


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_g1_in_any_posture_is_never_entered_with_a_jump(
    processes: Callable[..., Peer], tmp_path: Path, assets: Path, seed: int
) -> None:
    """A policy is the first to act: the approach goes to its default pose before."""
    peer = stand_in(processes, "g1_29dof", f"--seed={seed}")
    driven = drive(peer, "g1_walk", tmp_path, more=["--force=pose.start"])
    assert driven.status == 0, driven.output
    assert driven.first is not None
    assert driven.first <= FIRST
    steps = [line["step"] for line in peer.of("commands") if "step" in line]
    approach = [step for step in steps if step <= APPROACH_STEP]
    assert steps[: len(approach)] == approach
    entered = steps[len(approach)]  # 50 commands, of which the last are the policy's first
    assert entered <= STEP, steps


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP], ids=lambda n: n.name)
@pytest.mark.parametrize("gains", [True, False], ids=["gains", "positions"])
def test_a_robot_in_a_child_is_damped_when_the_run_dies_or_stands_still(
    processes: Callable[..., Peer],
    tmp_path: Path,
    loud_map: Path,
    number: signal.Signals,
    gains: bool,
) -> None:
    """The child has the robot: without its parent it damps within its watchdog, and ends."""
    peer = stand_in(processes, "go2", "--seed=6")
    more = ["--set", "platform={child: ros}"]
    if gains:
        more += ["--set", f"platforms.ros.map={loud_map}"]
    run = begun("go2_walk", tmp_path, seconds=60.0, more=more)
    try:
        peer.wait_for(lambda: bool(peer.of("commands")), "50 commands", timeout=60.0)
        count = peer.of("commands")[-1]["count"]
        (child,) = (each for each in psutil.Process(run.pid).children(recursive=True))
        began = time.monotonic()
        os.kill(run.pid, number)
        if gains:
            peer.wait_for(lambda: bool(peer.of("limp")), "that stiffness is gone", timeout=20.0)
            assert peer.of("limp")[0]["after"] - began < WATCHDOG[False] + DAMPING_TIME + ROOM
        end = time.monotonic() + 20.0
        while child.is_running() and child.status() != psutil.STATUS_ZOMBIE:
            assert time.monotonic() < end, "the child goes on"
            time.sleep(0.05)
    finally:
        run.kill()
        run.communicate()
    firsts, heard = seen(peer)
    assert firsts[0] <= FIRST
    assert len(firsts) == 1
    limit = (WATCHDOG[False] + DAMPING_TIME + ROOM) / 0.02
    assert heard - count < limit + 50  # then nothing comes any more
    assert max(line["step"] for line in peer.of("commands") if "step" in line) <= STEP


@pytest.mark.slow
def test_a_robot_that_is_killed_ends_the_run_with_its_reason(
    processes: Callable[..., Peer], tmp_path: Path
) -> None:
    peer = stand_in(processes, "go2", "--seed=4")
    run = begun("go2_walk", tmp_path, seconds=60.0)
    peer.wait_for(lambda: bool(peer.of("commands")), "50 commands", timeout=60.0)
    peer.kill()
    driven = ended(run, peer, tmp_path)
    assert driven.status == 3
    # Whichever looks first: the set of a robot at its stamps, the bridge at its topics.
    assert any("data is stale" in f or "no message for" in f for f in driven.report["faults"])


@pytest.mark.slow
def test_after_a_run_that_was_killed_the_next_one_begins_where_the_robot_is(
    processes: Callable[..., Peer], tmp_path: Path
) -> None:
    peer = stand_in(processes, "go2", "--seed=5")
    run = begun("go2_walk", tmp_path, seconds=60.0)
    peer.wait_for(lambda: bool(peer.of("commands")), "50 commands", timeout=60.0)
    run.kill()
    run.communicate()
    again = drive(peer, "go2_walk", tmp_path, seconds=2.0)
    assert again.status == 0, again.output
    assert len(peer.of("first")) == 2  # after a silence the next command is a first one again
    assert again.last_first is not None
    assert again.last_first <= FIRST


def test_postures_drawn_at_random_are_within_the_limits() -> None:
    import numpy as np

    from unicon_ros.bench.standins.robot import random_posture

    for name in ("go2", "g1_29dof"):
        robot = load_robot(name)
        drawn = [random_posture(robot, np.random.default_rng(seed)) for seed in range(50)]
        assert all((robot.lower < pos).all() and (pos < robot.upper).all() for pos in drawn)
        assert np.ptp(drawn, axis=0).min() > 0.2


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
