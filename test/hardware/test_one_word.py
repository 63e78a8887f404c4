"""One word changes: a posture on `mujoco`, then on the vendor's platform before its emulated robot.

All gates and the whole set of safety blocks are on.
"""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from emulated_runs import FIRST, UNICON, ended
from legged_peer import ALIENGO
from peer import Peer
from vendor_robots import DRIVES, UNSEEING, completed, serve, stepped

from unicon_core.robots import load_robot

# What these tests run against, the most that config/evidence.yaml may say by them.
EVIDENCE = "stand_in"

pytestmark = [pytest.mark.slow, pytest.mark.timeout(300)]

# How far a joint may hang below its target, [rad]: some gains are weak, and hands have steps.
SAG = 0.35
# Those whose models are at hand; a humanoid hangs, since nobody balances it.
MODELLED = {
    "a1": (),
    "adam_lite": ("--hang",),
    "g1_23dof": ("--hang",),
    "g1_29dof": ("--hang",),
    "go1": ("--hang",),
    "go2": (),
    "h1": ("--hang",),
    "h1_2": ("--hang",),
}
ALONE = ("--model=fake", "--posture=random", "--seed=3")
NEEDS = {"booster": "cyclonedds", "dobot": "cyclonedds", "pnd": "cyclonedds", "ros": "rclpy"}
NEEDS |= {"unitree": "cyclonedds", "unitree_dex3": "cyclonedds"}


def needed(name: str) -> None:
    """Skip where a robot's platform lacks what it needs."""
    dds = name.startswith("inspire") and name != "inspire_rh56_left"
    needs = "cyclonedds" if dds else NEEDS.get(DRIVES[name])
    if needs is not None:
        pytest.importorskip(needs, reason=f"needs {needs}")


def stands(
    processes: Callable[..., Peer],
    name: str,
    folder: Path,
    *more: str,
    generation: str = "",
) -> None:
    """Let `h1_stand` drive an emulated robot to its default pose."""
    needed(name)
    file = completed(name, folder)
    served = serve(processes, name, file, "--each", *more, generation=generation)
    run = served.run("h1_stand", folder, f"--set=robot={file}", "--duration=4")
    report = ended(run, folder)
    assert report["faults"] == []
    commands = served.of("command")
    # An A1, Aliengo or Go1 is asked by limp ones before.
    assert next(line for line in commands if line["stiffness"] > 0.0)["distance"] <= FIRST
    assert served.of("refused") == []
    # It is asked to let go first; at the end actuators may be disabled before the last command.
    assert [line for line in served.of("ignored") if line["count"] == 0] == []
    robot = load_robot(file)
    goal = np.clip(robot.default_joint_pos, robot.lower, robot.upper)
    # Motors that get torques have for a target where they are.
    by_torque = robot.transport.get("torque_servo", {}).get("motors", [])
    own = np.setdiff1d(np.arange(len(goal)), by_torque)
    away = [np.abs(np.array(line["target"])[own] - goal[own]).max() for line in commands]
    there = int(np.argmin(away))
    assert away[there] < 0.01  # hands count in steps of their own
    assert commands[there]["distance"] < SAG


@pytest.mark.parametrize("name", MODELLED)
def test_a_posture_of_the_simulation_is_one_on_the_robot_by_one_word(
    processes: Callable[..., Peer], tmp_path: Path, assets: Path, name: str
) -> None:
    pytest.importorskip("mujoco", reason="mujoco is not installed: pip install 'unicon_ros[sim]'")
    simulated = [*UNICON, "run", "h1_stand", f"--set=robot={name}", "--speed=max", "--duration=1"]
    done = subprocess.run(simulated, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    stands(processes, name, tmp_path, *MODELLED[name])


@pytest.mark.parametrize("name", sorted(DRIVES.keys() - MODELLED.keys() - {"aliengo"}))
def test_a_robot_without_a_model_goes_to_its_pose_from_any_posture(
    processes: Callable[..., Peer], tmp_path: Path, name: str
) -> None:
    stands(processes, name, tmp_path, *ALONE)


@pytest.mark.parametrize("generation", ALIENGO)
def test_an_aliengo_goes_to_its_pose_in_each_generation_that_is_spoken(
    processes: Callable[..., Peer], tmp_path: Path, generation: str
) -> None:
    stands(processes, "aliengo", tmp_path, *ALONE, generation=generation)


def test_an_arm_goes_to_its_pose_on_a_bus_of_this_process(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("can", reason="needs python-can: pip install 'unicon_ros[hw-arx]'")
    from unicon_hardware.arx.platform import face
    from unicon_ros.cli.main import main

    robot, bus = load_robot("arx_x5"), f"can-{tmp_path.name}"
    options = {"channel": bus, "interface": "virtual", "unverified": True, "silence": 5}
    with stepped(robot, face, {"channel": bus}, posture="random", seed=3) as said:
        status = main(
            [
                *("run", "h1_stand", "--set=robot=arx_x5", "--set=platform=arx", "--yes"),
                *(f"--set=platforms={json.dumps({'arx': options})}", "--duration=4"),
                *("--set=pacing.hang=20", f"--set=safety={UNSEEING}"),
            ]
        )
    assert status == 0, capsys.readouterr().err
    first = next(line for line in said if line["kind"] == "first")
    assert first["distance"] <= FIRST
    assert [line["by"] for line in said if line["kind"] == "damping"] == ["command"]
