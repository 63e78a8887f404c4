"""What leaves at the end is finite, within the limits, repeated, and a hold without gains."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ros_attack import Run, behind_topics, robot, wait_for

from unicon_base.errors import Fault
from unicon_core.robots import load_robot
from unicon_core.runtime import Runner
from unicon_core.workflow import Program, load_workflow

pytestmark = [
    pytest.mark.ros,
    pytest.mark.alone,  # a peer that another test starves for 0.5 s is silent
    pytest.mark.usefixtures("domain", "short_damping"),
    pytest.mark.timeout(90),
]

GAINS = """\
subscribe:
  - topic: joint_states
    type: sensor_msgs/msg/JointState
    timeout: 0.5
    fields: {name: $joint_names, position: joint_pos, velocity: joint_vel}
publish:
  - topic: joint_commands      # gains in the places of velocity and effort
    type: sensor_msgs/msg/JointState
    fields: {position: joint_pos_target, velocity: joint_damping, effort: joint_stiffness}
"""


@pytest.fixture
def gains(tmp_path: Path) -> Path:
    path = tmp_path / "gains.yaml"
    path.write_text(GAINS)
    return path


def ticked(path: Path, peer: Any, ticks: int = 30) -> tuple[Program, Runner]:
    """Return a run of some ticks, of which the robot has heard."""
    workflow = load_workflow(path)
    runner = Runner(workflow)
    for _ in range(ticks):
        assert workflow.platform.wait(2.0)
        runner.tick(0)
    wait_for(lambda: bool(peer.lines) and peer.lines[-1]["commands"] >= ticks, "the commands")
    return workflow, runner


def last(peer: Any, beyond: int) -> tuple[int, np.ndarray]:
    """Return how many commands the robot had after so many, and the last: rows as in the map."""
    wait_for(lambda: peer.lines[-1]["commands"] > beyond, "the last command")
    before = -1
    while before != (before := peer.lines[-1]["commands"]):  # two lines of the same number
        count = len(peer.lines)
        wait_for(lambda count=count: len(peer.lines) > count + 1, "the next lines")
    return before - beyond, np.array(peer.lines[-1]["last"][0])


@pytest.mark.parametrize("wrong", [1e30, math.nan, -math.inf])
def test_the_last_target_of_an_absurd_measurement_is_what_was_sent_before(
    wrong: float, tmp_path: Path, gains: Path
) -> None:
    with robot("none", 0.0) as peer:
        path = behind_topics(tmp_path, "finite", map=gains, damping=0.5)
        workflow, runner = ticked(path, peer)
        sent = workflow.states.joint_pos_target.copy()
        states = workflow.states
        states.joint_pos[2] = wrong
        states.joint_pos[5] = 0.1  # a frozen reading, the limit is -0.84
        states.joint_effort_ff[...] = wrong
        states.joint_pos_target[...] = wrong
        runner.close()
        repeats, command = last(peer, 30)
    target, damping, stiffness = command
    go2 = load_robot("go2")
    assert target == pytest.approx(np.clip(sent, go2.lower, go2.upper))
    assert (stiffness == 0.0).all()
    assert damping == pytest.approx(go2.joint_damping)
    assert not states.joint_vel_target.any()
    assert not states.joint_effort_ff.any()
    assert 25 <= repeats <= 60  # 0.5 s of 100 Hz; a busy machine makes fewer


def test_a_map_of_positions_alone_holds_the_targets_that_were_sent_last(tmp_path: Path) -> None:
    with robot("none", 0.0) as peer:
        workflow, runner = ticked(behind_topics(tmp_path, "finite", damping=0.5), peer)
        sent = workflow.states.joint_pos_target.copy()
        workflow.states.joint_pos[...] = -1.0  # where it is by now
        workflow.states.joint_pos_target[...] = math.nan  # what a tick left behind
        runner.close()
        repeats, command = last(peer, 30)
    go2 = load_robot("go2")
    assert command[0] == pytest.approx(np.clip(sent, go2.lower, go2.upper))
    assert not command[1:].any()
    assert 25 <= repeats <= 60


def test_a_robot_that_goes_mad_is_damped_within_its_limits(tmp_path: Path) -> None:
    with robot("far joints", 0.2) as peer:
        run = Run(behind_topics(tmp_path, "finite, {rate_limit: {max_rate: 5.0}}")).start()
        try:
            wait_for(lambda: bool(peer.lines) and peer.lines[-1]["lies"], "the lies")
        finally:
            report = run.end()
        _, command = last(peer, 10)
    go2 = load_robot("go2")
    assert report.faults == []
    assert (command[0] >= go2.lower - 1e-6).all()
    assert (command[0] <= go2.upper + 1e-6).all()


def test_a_command_that_is_not_finite_never_leaves(tmp_path: Path, gains: Path) -> None:
    with robot("none", 0.0) as peer:
        workflow, runner = ticked(behind_topics(tmp_path, "", map=gains, damping=0.5), peer)
        workflow.states.joint_stiffness[4] = math.nan
        with pytest.raises(Fault, match="joint_stiffness of joint FL_thigh_joint is nan"):
            workflow.platform.send()
        runner.close()
        workflow.platform.close()  # twice
        _, command = last(peer, 30)
    assert np.isfinite(command).all()
    assert not command[2].any()


def test_a_publication_that_fails_at_the_end_does_not_keep_the_rest_open(
    tmp_path: Path, gains: Path
) -> None:
    with robot("none", 0.0) as peer:
        workflow, runner = ticked(behind_topics(tmp_path, "finite", map=gains), peer)
        platform = workflow.platform

        def broken() -> None:
            raise RuntimeError("no memory left")

        platform.outgoing[0]._encode = broken
        runner.close()
        assert runner.faults[0].startswith("closing: RuntimeError: no memory left")
        assert not platform._own.context.ok()  # let go all the same


def test_a_close_in_the_middle_of_a_send_has_the_last_word(tmp_path: Path, gains: Path) -> None:
    """As from a signal handler: nothing of the command that was under way leaves behind it."""
    with robot("none", 0.0) as peer:
        path = behind_topics(tmp_path, "finite", map=gains, damping=0.5)
        workflow, runner = ticked(path, peer)
        (out,) = workflow.platform.outgoing
        encode = out._encode

        def interrupted() -> bytes:
            raw: bytes = encode()
            out._encode = encode
            workflow.platform.close()
            return raw

        out._encode = interrupted
        runner.tick(0)
        runner.close()
        _, command = last(peer, 30)
    assert not command[2].any()
    assert command[1] == pytest.approx(load_robot("go2").joint_damping)
