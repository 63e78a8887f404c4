"""A plain rclpy process beside the bridge: sees the robot, moves it, dies, and nothing happens."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from unicon_core.flow import Block, Stage
from unicon_core.workflow import HookBlocks, Program

pytestmark = [pytest.mark.ros, pytest.mark.timeout(120)]


class Recorder:
    """Keeps the simulator's own joints and orientation by stamp, and the base's place by tick."""

    def __init__(self) -> None:
        self.joints: dict[int, tuple[list[float], list[float]]] = {}
        self.quats: dict[int, list[float]] = {}
        self.base: list[tuple[int, float]] = []

    def hook(self, workflow: Program) -> HookBlocks:
        states = workflow.states

        def record() -> None:
            stamp = int(states.stamp_ns)
            self.joints[stamp] = (states.joint_pos.tolist(), states.joint_vel.tolist())
            self.quats[stamp] = states.base_quat.tolist()
            self.base.append((stamp, float(states.base_pos_w[0])))

        return {Stage.OBSERVE: [Block("recorder", record)]}


def test_a_plain_peer_sees_the_simulators_values_moves_the_robot_and_may_be_killed(
    runs: Callable[..., Any], peers: Callable[..., Any], sway: Path
) -> None:
    recorder = Recorder()
    run = runs(sway, hooks=[recorder.hook])
    peer = peers("robot_watcher", "--command", "0.5", "0", "0")

    peer.wait_for(lambda: len(peer.of("joints")) > 20, "joint_states")
    peer.wait_for(lambda: run.session.incoming[0].received > 0, "cmd_vel")
    commanded_at = recorder.base[-1][0]
    peer.wait_for(lambda: recorder.base[-1][0] > commanded_at + 2_000_000_000, "2 s of commands")

    joints, quats = dict(recorder.joints), dict(recorder.quats)
    heard = [line for line in peer.of("joints") if line["stamp"] in joints]
    assert len(heard) > 100
    for line in heard:
        assert line["names"] == list(run.program.robot.joint_names)
        assert (line["position"], line["velocity"]) == joints[line["stamp"]]
    assert len(peer.of("imu")) > 100
    for line in peer.of("imu"):
        w, x, y, z = quats[line["stamp"]]
        assert line["xyzw"] == [x, y, z, w]
    newest = max(joints)  # ticks go on meanwhile
    clock = [line["stamp"] for line in peer.of("clock") if line["stamp"] <= newest]
    assert len(clock) > 100
    assert set(clock) <= set(joints)
    assert clock == sorted(clock)

    before = [x for stamp, x in recorder.base if stamp <= commanded_at]
    leaning = recorder.base[-1][1]
    assert leaning - before[-1] > 0.02  # thighs turned by 0.3 rad move the base forward
    assert max(before[-50:]) - min(before[-50:]) < 0.005
    assert run.program.states.velocity_command.tolist() == [0.5, 0.0, 0.0]

    ticks = run.runner.statistics.count
    peer.kill()
    command = run.program.states.velocity_command
    peer.wait_for(lambda: run.runner.statistics.count > ticks + 100, "ticks after the peer died")
    peer.wait_for(lambda: command.tolist() == [0.0, 0.0, 0.0], "the time-out of cmd_vel")
    assert any("cmd_vel: no message for 0.5 s" in line for line in run.warnings)
    report = run.end()
    assert report.faults == []
    assert run.session.counts()["topics"]["/joint_states"]["published"] == report.ticks
