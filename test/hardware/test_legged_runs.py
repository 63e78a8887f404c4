"""Runs of `unitree_legged` against an emulated robot in another process, all gates on."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from legged_peer import ALIENGO, Emulated, Process, free_port
from stepping import stepping

from unicon_core import Program, load_workflow
from unicon_core.blocks.controls.device import Controls, unitree_pressed
from unicon_core.flow import Chain
from unicon_core.robots import load_robot
from unicon_core.runtime.report import Report
from unicon_core.runtime.runner import Runner, RunOptions
from unicon_core.states import States
from unicon_core.states.standard import BUTTONS, control_states
from unicon_core.workflow.uses import block, pose

MAKE = "unicon_hardware.unitree_legged.platform:make"
ROBOTS = Path(__file__).resolve().parents[2] / "config" / "robots"
LYING = {"*_hip_joint": 0.0, "*_thigh_joint": 1.2, "*_calf_joint": -2.6}
"""What all three can do, on the belly."""
PATIENT = [
    {"stale_stop": {"timeout": 5.0}},
    {"joint_sensor_stop": {"step": 10.0, "drift": 10.0}},
    {"encoder_stop": {"timeout": 2.0}},
]
"""A busy machine starves the emulator, which is an encoder that stands still."""


@pytest.fixture
def emulated() -> Iterator[Callable[..., Process]]:
    made: list[Process] = []

    def build(*args: Any, **options: Any) -> Process:
        made.append(Process(*args, **options))
        return made[-1]

    yield build
    for process in made:
        process.kill()


def with_gains(folder: Path) -> Path:
    """Return the Aliengo's file with the gains of the vendor's example on branch Aliengo."""
    text = (ROBOTS / "aliengo.yaml").read_text("utf-8")
    text = text.replace("stiffness: null, damping: null", "stiffness: 20.0, damping: 2.0")
    text = text.replace("unknown: [joints.rest, joints.stiffness, joints.damping]", "")
    text = text.replace("sources:\n", 'sources:\n  gains: "ours, for a test"\n')
    path = folder / "aliengo.yaml"
    path.write_text(text.rstrip() + "\nunknown: [joints.rest]\n", "utf-8")
    return path


def run_postures(
    robot: str | Path, seconds: float, ports: tuple[int, int], generation: str | None
) -> Report:
    """Stand up, hold, lie down; at 100 Hz, which a busy machine keeps. In between is repeated."""
    port, local = ports
    given = {
        "address": "127.0.0.1",
        "port": port,
        "local_port": local,
        "watchdog": 5.0,
        "generation": generation,
    }
    flow = Chain(
        pose("stand", duration=seconds),
        block("hold", duration=0.2),
        pose(LYING, duration=seconds),
        block("damp", duration=0.2),
    )
    program = Program(
        robot=str(robot),
        platform=MAKE,
        platforms={MAKE: {**given, "silence": 5.0}},
        rate=100,
        flow=flow,
        safety=["joint_limits", *PATIENT],
        start={"operator": False, "fade_in": 0.3},
    )
    assert not program.safety_left_out
    return Runner(program, RunOptions(warn=lambda _: None)).run()


LONG = pytest.mark.slow
RUNS = [
    pytest.param("go1", None, False, id="go1"),
    pytest.param("go1", None, True, id="go1-mujoco", marks=LONG),
    pytest.param("a1", None, False, id="a1", marks=LONG),
    pytest.param("a1", None, True, id="a1-mujoco", marks=LONG),
    *(pytest.param("aliengo", each, False, id=each, marks=LONG) for each in ALIENGO),
]
MODELS = {"go1": "go1/go1.urdf", "a1": "a1/a1.urdf"}


@pytest.mark.slow
@pytest.mark.parametrize(("name", "generation", "physics"), RUNS)
def test_a_robot_stands_up_and_lies_down_through_all_gates(
    emulated: Callable[..., Process],
    request: pytest.FixtureRequest,
    tmp_path: Path,
    name: str,
    generation: str | None,
    physics: bool,
) -> None:
    ports = free_port(), free_port()
    options: dict[str, Any] = {} if generation is None else {"generation": generation}
    scene: dict[str, Any] = {"initial_pose": LYING}
    if physics:
        scene["model"] = str(request.getfixturevalue("assets") / "models" / MODELS[name])
    # Limp on the floor, the model of a Go1 folds its calves to -2.83 rad, beyond the SDK's limits:
    # the gate `posture` would not let it begin. So both hang until they are stiff.
    file = with_gains(tmp_path) if name == "aliengo" else name
    robot = emulated(file, ports[0], scene=scene, hung=20.0 * physics, **options)
    report = run_postures(file, 1.5 if physics else 0.8, ports, generation)
    assert report.faults == []
    assert report.ended == "done"
    seen = robot.ended()
    assert seen["first"] < 0.05
    assert seen["refused"] == 0
    assert not any(seen["joint_stiffness"])
    # Limp at the end, the physics let the legs spread; and a busy machine misses the last targets.
    np.testing.assert_allclose(seen["joint_pos"][0::3], 0.0, atol=0.4)
    np.testing.assert_allclose(seen["joint_pos"][1::3], 1.2, atol=0.4)
    if physics:
        assert seen["highest"] > 0.25  # it stood
        assert seen["projected_gravity"][2] < -0.9


@pytest.mark.slow
def test_go1_walks_under_a_policy_that_reads_the_velocity_of_its_odometry(
    emulated: Callable[..., Process], assets: Path
) -> None:
    """`go1_walk` as it is, but for the platform: its policy reads what `leg_odometry` estimates."""
    port, local = free_port(), free_port()
    scene = {"model": str(assets / "models" / "go1" / "go1.xml"), "initial_pose": "keyframe:home"}
    robot = emulated("go1", port, scene=scene, hung=34.0)
    changes = {
        "platform": MAKE,
        "platforms": {
            MAKE: {
                "address": "127.0.0.1",
                "port": port,
                "local_port": local,
                "watchdog": 5.0,
                "silence": 5.0,
            }
        },
        "start": {"operator": False},
        "safety": ["finite", "joint_limits", "tilt_stop", *PATIENT],
    }
    program = load_workflow("go1_walk", changes)
    report = Runner(program, RunOptions(warn=lambda _: None, duration=6.0)).run()
    assert report.faults == []
    assert not report.fell
    seen = robot.ended()
    assert seen["first"] < 0.05
    assert seen["farthest"] > 1.0  # 2 m where the emulator keeps up


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


@pytest.mark.slow
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


@pytest.mark.slow
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


@pytest.mark.slow
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


@pytest.mark.slow
def test_a_robot_that_dies_is_a_fault_and_comes_back(tmp_path: Path) -> None:
    ports = free_port(), free_port()
    with running(tmp_path, ports, silence=0.3) as run:
        with stepped(ports[0]) as robot:
            until(lambda: is_held(robot))
        told, _ = run.communicate(timeout=60)
        assert run.returncode == 3, told
        assert f"nothing from 127.0.0.1:{ports[0]}" in told
    with stepped(ports[0]) as robot:
        assert run_postures("go1", 0.8, ports, None).faults == []
        assert robot.first is not None
        assert robot.first < 0.05
