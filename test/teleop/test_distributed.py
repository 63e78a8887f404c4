"""Teleoperation with the headset and IK on a workstation: as on the robot, and when it goes away.

By the users' commands, over zmq on loopback, at real rate.
"""

from __future__ import annotations

import os
import signal
from pathlib import Path

import numpy as np
import pytest
from teleop_runs import HOME, Seen, divided, end, free_ports, put_on, start, wait, workflow

pytest.importorskip("mujoco", reason="G1 walks in MuJoCo")
pytest.importorskip("daqp", reason="pip install 'unicon_ros[ik]'")
pytest.importorskip("zmq", reason="pip install 'unicon_ros[zmq]'")
pytest.importorskip("websockets", reason="pip install 'unicon_ros[webxr]'")
pytestmark = [pytest.mark.slow, pytest.mark.alone, pytest.mark.usefixtures("assets")]


def local(folder: Path, seconds: float) -> Seen:
    """Run all of it in one process."""
    folder.mkdir()
    port = free_ports(1)
    run = start(workflow(folder, port), seconds, "--record", str(folder / "robot.mcap"))
    headset = put_on(port, seconds + 20.0, "--forward", "0.6")
    try:
        assert run.wait(seconds + 60.0) == 0, run.stdout.read() if run.stdout else ""
    finally:
        end(headset)
        end(run)
    return Seen(folder / "robot.mcap")


def test_what_comes_from_the_workstation_is_a_tick_old(tmp_path: Path) -> None:
    """The errors of a machine that is not busy are held in test_a_tick_away.py."""
    here = local(tmp_path / "local", 16.0)
    away = tmp_path / "away"
    away.mkdir()
    with divided(away, 18.0) as (robot, _, _):
        assert robot.wait(80.0) == 0
    there = Seen(away / "robot.mcap")
    here_far, there_far = (np.percentile(each.errors(), [50, 95]) for each in (here, there))
    age = float(np.median(there.ages()))
    print("error local and away [mm]:", (1e3 * here_far).round(1), (1e3 * there_far).round(1))
    print(f"age {1e3 * age:.1f} ms, latency of the headset {1e3 * here.latency():.1f} ms")
    assert age <= 0.0205
    assert there_far[0] < 2.0 * here_far[0]
    assert there.states("base_pos_w")[:, 2].min() > 0.6


def told(robot: object) -> str:
    """Return what a run said, which has ended."""
    return robot.stdout.read()  # type: ignore[attr-defined, no-any-return]


def goes_home(seen: Seen, begin: float, until: float) -> None:
    """Hold that arms went home between two times, calmly, and the robot walked on."""
    away = (seen.now > begin + 0.3) & (seen.now < until)
    assert not seen.engaged[away].any()
    assert seen.rate[away].max() <= HOME * 1.01
    arms = seen.states("joint_pos_target")[away][-1, 15:29]
    left = (0.35, 0.18, 0.0, 0.87, 0.0, 0.0, 0.0)  # home of the workflow
    np.testing.assert_allclose(arms[:7], left, atol=1e-5)
    heights = seen.states("base_pos_w")[:, 2]
    assert heights.min() > 0.6


def lost_at(seen: Seen) -> float:
    """Return when the target was lost first, in [s]."""
    lost = np.flatnonzero(seen.engaged[:-1] & ~seen.engaged[1:])
    assert len(lost)
    return float(seen.now[lost[0]])


def test_a_workstation_that_is_killed_lets_the_arms_go_home(tmp_path: Path) -> None:
    with divided(tmp_path, 20.0) as (robot, (desk, _), _):
        wait(13.0)
        os.kill(desk.pid, signal.SIGKILL)
        assert robot.wait(60.0) == 0
        text = told(robot)
    assert "faults        none" in text
    assert "part 'workstation' has been silent for 0.2 s" in text
    seen = Seen(tmp_path / "robot.mcap")
    goes_home(seen, lost_at(seen), float(seen.now[-1]))


@pytest.mark.parametrize("way", ["stopped", "cut"])
def test_who_comes_back_has_to_engage_anew(tmp_path: Path, way: str) -> None:
    with divided(tmp_path, 23.0, wire=True) as (robot, (desk, _), network):
        assert network is not None
        wait(13.0)
        if way == "stopped":
            os.kill(desk.pid, signal.SIGSTOP)
        else:
            network.cut()
        wait(4.0)
        if way == "stopped":
            os.kill(desk.pid, signal.SIGCONT)
            assert desk.wait(20.0) == 3  # it stood still for longer than `hang`: its own fault
        else:
            network.mend()
        assert robot.wait(60.0) == 0
        text = told(robot)
    assert "faults        none" in text
    if way == "cut":
        assert text.count("part 'workstation' is heard") == 2
    seen = Seen(tmp_path / "robot.mcap")
    goes_home(seen, lost_at(seen), float(seen.now[-1]))  # the operator still squeezes
