"""A stand-in robot behind topics, driven by the workflow of MuJoCo: its beginning, and kills."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import psutil
import pytest
from command_watch import CommandWatch
from peer import Peer, wait_for
from standin_runs import FIRST, SILENCE, Driven, begun, drive, ended, said, seen, stand_in

from unicon_core.gates.build import beginning
from unicon_core.platforms.child.platform import WATCHDOG
from unicon_core.platforms.kit.command import DAMPING_TIME
from unicon_core.workflow import load_workflow
from unicon_hardware.emulate.emulator import SILENCE as UNHEARD

pytestmark = [pytest.mark.ros, pytest.mark.slow, pytest.mark.timeout(300)]

PERIOD = 0.02
APPROACH = 0.5
"""Speed of an approach in [rad/s], unless a workflow says."""
FADE_IN = 1.0
"""Of an approach at least, in [s], unless a workflow says."""
STEP = 0.25
"""Largest step while a flow comes in. What a policy does later on a robot that hangs on nothing and
falls nowhere is its own."""
TELLING = ("--each",)
"""Of a stand-in that says every command; its joints lag behind an approach by 0.015 rad."""
ROOM = 1.0
"""For a busy machine in [s]."""


@dataclass(frozen=True)
class Body:
    """A robot, and the workflow of config/workflows/ that drives it.

    Attributes:
        policy_first: a policy acts first, so that the approach goes to its default pose.
    """

    workflow: str
    robot: str
    policy_first: bool


BODIES = [
    pytest.param(Body("go2_walk", "go2", False), id="go2"),
    pytest.param(Body("g1_walk", "g1_29dof", True), id="g1"),
]


@pytest.fixture(autouse=True)
def assets_of_a_g1(request: pytest.FixtureRequest) -> None:
    """Skip what drives a G1 where its policy is not there."""
    if "g1" in request.node.name.partition("[")[2]:
        request.getfixturevalue("assets")


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("body", BODIES)
def test_the_workflow_of_the_simulation_drives_a_robot_in_any_posture_without_a_jump(
    processes: Callable[..., Peer], tmp_path: Path, body: Body, seed: int
) -> None:
    """Neither where it begins to move nor where its flow comes in; a policy is the G1's first."""
    peer = stand_in(processes, body.robot, f"--seed={seed}", *TELLING)
    driven = drive(peer, body.workflow, tmp_path)
    assert driven.status == 0, driven.output
    assert driven.count >= 50
    no_jump(peer, driven, body)


def answers(peers: Callable[..., Peer], *words: str) -> list[str]:
    """Call services of a run, and return what they say."""
    caller = peers("caller", "unicon", *words)
    status, errors = caller.end()
    assert status == 0, errors
    return [line["message"] for line in caller.lines]


def no_jump(peer: Peer, driven: Driven, body: Body) -> None:
    """Hold what the robot heard against how a run may begin."""
    distances = [line["distance"] for line in peer.of("command")]
    targets = np.array([line["target"] for line in peer.of("command")])
    assert driven.first is not None
    assert driven.first == distances[0]
    assert driven.first <= FIRST
    program = load_workflow(body.workflow, {"platform": "fake"})
    goal = beginning(program).joint_pos if body.policy_first else targets[0]
    program.close()
    entered = np.flatnonzero(np.abs(targets - goal).max(axis=1) < 1e-4)[-1] + 1
    assert entered >= 0.8 * FADE_IN / PERIOD
    steps = np.abs(np.diff(targets, axis=0)).max(axis=1)
    # A robot that is held up by a busy machine misses a command here and there.
    assert np.percentile(steps[: entered - 1], 80) <= 1.01 * APPROACH * PERIOD
    stamps = [line["stamp"] for line in peer.of("command")]
    way = np.abs(targets[entered - 1] - targets[0]).max()
    assert stamps[entered - 1] - stamps[0] >= 0.9 * way / APPROACH
    assert distances[entered] <= FIRST  # the first command of the flow
    assert steps[entered - 1] <= FIRST
    assert steps[entered : entered + 10].max() <= STEP


@pytest.mark.parametrize("body", BODIES)
def test_gates_come_first_then_the_operators_go_by_a_service_then_motion(
    processes: Callable[..., Peer], peers: Callable[..., Peer], tmp_path: Path, body: Body
) -> None:
    peer = stand_in(processes, body.robot, "--seed=7", *TELLING)
    planner = peers("passer_by")
    planner.tell("say 0.3")
    run = begun(body.workflow, tmp_path, seconds=3.0, operator=True, more=["--ros"])
    moving = "waiting for command: velocity_command is vx 0.3 m/s"
    wait_for(lambda: moving in said(tmp_path), moving, 60.0)
    assert answers(peers, "start")[0].startswith("not yet: it waits for ")
    planner.tell("silent")
    asked = "waiting for the operator's go: press Enter, call ~/start"
    wait_for(lambda: asked in said(tmp_path), asked, 60.0)
    assert peer.of("command") == []
    for _ in range(5):  # on a busy machine data may be slow at that very moment
        if answers(peers, "start") == ["go"]:
            break
    driven = ended(run, peer, tmp_path)
    assert driven.status == 0, driven.output
    assert driven.report["ticks"] == 150
    assert driven.output.index(moving) < driven.output.index(asked)
    no_jump(peer, driven, body)


@pytest.mark.parametrize("gains", [True, False], ids=["gains", "positions"])
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP], ids=lambda n: n.name)
@pytest.mark.parametrize("body", BODIES)
def test_a_robot_in_a_child_is_damped_when_the_run_dies_or_stands_still(
    processes: Callable[..., Peer],
    tmp_path: Path,
    body: Body,
    number: signal.Signals,
    gains: bool,
) -> None:
    """The child has the robot: without its parent it damps within its watchdog, and ends."""
    peer = stand_in(processes, body.robot, "--seed=6")
    more = ["--set", "platform={child: ros, silence: 5}"]
    run = begun(body.workflow, tmp_path, gains=gains, more=more)
    try:
        peer.wait_for(lambda: bool(peer.of("commands")), "50 commands", timeout=60.0)
        count = peer.of("commands")[-1]["count"]
        (child,) = (each for each in psutil.Process(run.pid).children(recursive=True))
        began = time.monotonic()
        os.kill(run.pid, number)
        if gains:
            peer.wait_for(lambda: bool(peer.of("damping")), "that stiffness is gone", timeout=20.0)
            assert peer.of("damping")[0]["by"] == "command"
            assert peer.of("damping")[0]["after"] - began < WATCHDOG[False] + DAMPING_TIME + ROOM
        end = time.monotonic() + 20.0
        while child.is_running() and child.status() != psutil.STATUS_ZOMBIE:
            assert time.monotonic() < end, "the child goes on"
            time.sleep(0.05)
        peer.wait_for(lambda: bool(silences(peer, began)), "the robot's own watchdog")
    finally:
        run.kill()
        run.wait(10)
    firsts, heard = seen(peer)
    assert firsts[0] <= FIRST
    limit = (WATCHDOG[False] + DAMPING_TIME + ROOM) / PERIOD
    assert heard - count < limit + 50  # then nothing comes any more
    assert max(line["step"] for line in peer.of("commands") if "step" in line) <= STEP


@pytest.mark.parametrize("body", BODIES)
def test_a_robot_that_is_killed_ends_the_run_damped_with_its_reason(
    processes: Callable[..., Peer],
    watches: Callable[[str], CommandWatch],
    tmp_path: Path,
    body: Body,
) -> None:
    peer = stand_in(processes, body.robot, "--seed=4")
    watch = watches(body.robot)
    run = begun(body.workflow, tmp_path, gains=True)
    peer.wait_for(lambda: bool(peer.of("commands")), "50 commands", timeout=60.0)
    peer.kill()
    killed = time.monotonic()
    driven = ended(run, peer, tmp_path)
    assert driven.status == 3
    (fault,) = driven.report["faults"]
    assert fault.startswith(f"topic /joint_states: no message for {SILENCE:g} s")
    # What was sent into the void was the damping command: the robot may live, and the network not.
    falls = [each for at, each in watch.stiffness if at > killed]
    top = falls.index(max(falls))
    assert falls[top:] == sorted(falls[top:], reverse=True)
    assert falls[-1] == 0.0
    limp_at = next(at for at, each in watch.stiffness if at > killed and each == 0.0)
    held = [each.target for each in watch.commands if each.at > limp_at]
    assert np.ptp(held, axis=0).max() == 0.0
    assert watch.commands[-1].at - killed < SILENCE + DAMPING_TIME + ROOM


@pytest.mark.parametrize("body", BODIES)
def test_a_robot_whose_run_is_killed_is_limp_and_the_next_run_begins_where_it_is(
    processes: Callable[..., Peer], tmp_path: Path, body: Body
) -> None:
    peer = stand_in(processes, body.robot, "--seed=5")
    run = begun(body.workflow, tmp_path)
    peer.wait_for(lambda: bool(peer.of("commands")), "50 commands", timeout=60.0)
    began = time.monotonic()
    run.kill()
    run.wait(10)
    peer.wait_for(lambda: bool(silences(peer, began)), "the robot's own watchdog")
    assert silences(peer, began)[0] < UNHEARD + ROOM
    before = len(peer.of("first"))
    again = drive(peer, body.workflow, tmp_path, seconds=2.0)
    assert again.status == 0, again.output
    # After a silence the next command is a first one again.
    assert peer.of("first")[before]["distance"] <= FIRST


def silences(peer: Peer, since: float) -> list[float]:
    """Return when a robot's own watchdog acted, from a time of `time.monotonic` on, [s]."""
    return [line["after"] - since for line in peer.of("silence") if line["after"] > since]
