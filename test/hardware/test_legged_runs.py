"""Runs of `unitree_legged` against an emulated robot in another process, all gates on."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from legged_peer import Emulated, free_port
from stepping import stepping

from unicon_core import Program
from unicon_core.blocks.controls.device import Controls, unitree_pressed
from unicon_core.flow import Chain
from unicon_core.robots import load_robot
from unicon_core.runtime.report import Report
from unicon_core.runtime.runner import Runner, RunOptions
from unicon_core.states import States
from unicon_core.states.standard import BUTTONS, control_states
from unicon_core.workflow.uses import block, pose

pytestmark = pytest.mark.slow

MAKE = "unicon_hardware.unitree_legged.platform:make"
# What all three can do, on the belly.
LYING = {"*_hip_joint": 0.0, "*_thigh_joint": 1.2, "*_calf_joint": -2.6}
# A busy machine starves the emulator, which is an encoder that stands still.
PATIENT = [
    {"stale_stop": {"timeout": 5.0}},
    {"joint_sensor_stop": {"step": 10.0, "drift": 10.0}},
    {"encoder_stop": {"timeout": 2.0}},
]


def run_postures(seconds: float, ports: tuple[int, int]) -> Report:
    """Stand up, hold, lie down; at 100 Hz, which a busy machine keeps. In between is repeated."""
    port, local = ports
    given = {"address": "127.0.0.1", "port": port, "local_port": local, "watchdog": 5.0}
    flow = Chain(
        pose("stand", duration=seconds),
        block("hold", duration=0.2),
        pose(LYING, duration=seconds),
        block("damp", duration=0.2),
    )
    program = Program(
        robot="go1",
        platform=MAKE,
        platforms={MAKE: {**given, "silence": 5.0}},
        rate=100,
        flow=flow,
        safety=["joint_limits", *PATIENT],
        start={"operator": False, "fade_in": 0.3},
    )
    assert not program.safety_left_out
    return Runner(program, RunOptions(warn=lambda _: None)).run()


HOLDING = """
schema: unicon.workflow/1
name: holding
description: A Go1 holds the posture that it is found in.
robot: go1
platform: {platform}
platforms:
  "{make}":
    {{address: 127.0.0.1, port: {port}, local_port: {local}, watchdog: 0.5, silence: {silence},
      connect: 20.0}}
rate: 100
flow: {{hold: {{duration: 60.0}}}}
safety: [{{stale_stop: {{timeout: 5.0}}}}]
start: {{operator: false, fade_in: 0.2}}
pacing: {{hang: 0.5}}
"""
IN_A_CHILD = f'{{child: "{MAKE}", silence: 5.0, watchdog: 0.5}}'


@contextmanager
def running(
    folder: Path, ports: tuple[int, int], platform: str = f'"{MAKE}"', silence: float = 5.0
) -> Iterator[subprocess.Popen[str]]:
    """Run a workflow that holds a posture by `unicon run`."""
    file = folder / "holding.yaml"
    port, local = ports
    text = HOLDING.format(platform=platform, make=MAKE, port=port, local=local, silence=silence)
    file.write_text(text, "utf-8")
    process = subprocess.Popen(
        [sys.executable, "-m", "unicon_ros", "run", str(file)],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


@contextmanager
def stepped(port: int) -> Iterator[Emulated]:
    """Step a Go1 of stub physics in a thread."""
    robot = Emulated(load_robot("go1"), port)
    with stepping(lambda: robot.run(0.02), robot.close):
        yield robot


def until(holds: Callable[[], bool], patience: float = 60.0) -> None:
    """Wait until something holds."""
    end = time.monotonic() + patience
    while not holds():
        assert time.monotonic() < end
        time.sleep(0.01)


def is_held(robot: Emulated) -> bool:
    """Return whether a robot is commanded with its full stiffness."""
    return bool((robot.states["joint_stiffness"] >= 40.0).all())


def is_limp(robot: Emulated) -> bool:
    """Return whether a robot is damped."""
    states = robot.states
    return not states["joint_stiffness"].any() and bool((states["joint_damping"] > 0.0).all())


@pytest.mark.parametrize("mishap", ["stopped", "killed"])
def test_a_robot_is_damped_where_our_process_stops(tmp_path: Path, mishap: str) -> None:
    """Killed: only what runs in a process of its own can still do it. Stopped: once it goes on."""
    ports = free_port(), free_port()
    platform = IN_A_CHILD if mishap == "killed" else f'"{MAKE}"'
    with stepped(ports[0]) as robot:
        with running(tmp_path, ports, platform) as run:
            until(lambda: is_held(robot))
            if mishap == "killed":
                run.kill()
            else:
                run.send_signal(signal.SIGSTOP)
                time.sleep(1.0)
                run.send_signal(signal.SIGCONT)
            until(lambda: is_limp(robot))
            told, _ = run.communicate(timeout=60)
            assert run.returncode == (-signal.SIGKILL if mishap == "killed" else 3), told
        with running(tmp_path, ports) as again:
            until(lambda: is_held(robot))
            again.send_signal(signal.SIGINT)
            told, _ = again.communicate(timeout=60)
            until(lambda: is_limp(robot))


def test_a_robot_that_leaves_servo_mode_is_a_fault_and_does_not_jump(tmp_path: Path) -> None:
    ports = free_port(), free_port()
    with stepped(ports[0]) as robot, running(tmp_path, ports) as run:
        until(lambda: is_held(robot))
        robot.face.obeys = False  # as the remote does
        told, _ = run.communicate(timeout=60)
        assert run.returncode == 3, told
        assert "is in mode 0x00, not in servo mode 0x0a since it takes commands" in told
        robot.states["joint_stiffness"][...] = 0.0
        robot.face.obeys = True
        time.sleep(0.2)
        assert not robot.states["joint_stiffness"].any()


def test_the_vendors_combination_on_the_remote_damps_a_robot_that_names_no_sticks(
    tmp_path: Path,
) -> None:
    ports = free_port(), free_port()
    held = Controls(States(control_states()))
    with stepped(ports[0]) as robot, running(tmp_path, ports) as run:
        until(lambda: is_held(robot))
        for name in ("L2", "B"):
            assert is_held(robot)
            held.buttons[BUTTONS.index(name)] = 1
            unitree_pressed(held, robot.face.remote)
            time.sleep(0.3)
        until(lambda: is_limp(robot))
        told, _ = run.communicate(timeout=60)
        assert run.returncode == 3, told
        assert "L2+B: held on the remote, stops the robot" in told
        assert "the operator pressed L2+B on the remote (remote_stop)" in told
        robot.face.remote[:] = bytes(40)
        with running(tmp_path, ports) as again:
            told, _ = again.communicate(timeout=60)
        assert again.returncode == 1, told
        assert f"unicon latches --clear unitree_legged/127.0.0.1/{ports[0]}" in told


def test_a_robot_that_dies_is_a_fault_and_comes_back(tmp_path: Path) -> None:
    ports = free_port(), free_port()
    with running(tmp_path, ports, silence=0.3) as run:
        with stepped(ports[0]) as robot:
            until(lambda: is_held(robot))
        told, _ = run.communicate(timeout=60)
        assert run.returncode == 3, told
        assert f"nothing from 127.0.0.1:{ports[0]}" in told
    with stepped(ports[0]) as robot:
        assert run_postures(0.8, ports).faults == []
        assert robot.first is not None
        assert robot.first < 0.05
