"""Runs of `unitree_legged` against an emulated robot in another process, all gates on."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from legged_peer import ALIENGO, Process, free_port

from unicon_core import Program
from unicon_core.flow import Chain
from unicon_core.runtime.report import Report
from unicon_core.runtime.runner import Runner, RunOptions
from unicon_core.workflow.uses import block, pose

MAKE = "unicon_ros.hardware.unitree_legged.platform:make"
ROBOTS = Path(__file__).resolve().parents[2] / "config" / "robots"
LYING = {"*_hip_joint": 0.0, "*_thigh_joint": 1.2, "*_calf_joint": -2.6}
"""What all three can do, on the belly."""


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
        platforms={MAKE: {**given, "silence": 1.0}},
        rate=100,
        flow=flow,
        safety=["joint_limits"],
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
        # Limp on the floor, the model of a Go1 folds its calves to -2.83 rad, which is beyond the
        # SDK's limits, and the gate `posture` would not let it begin.
        options["hung"] = True
    file = with_gains(tmp_path) if name == "aliengo" else name
    robot = emulated(file, ports[0], scene=scene, **options)
    report = run_postures(file, 1.5 if physics else 0.4, ports, generation)
    assert report.faults == []
    assert report.ended == "done"
    seen = robot.ended()
    assert seen["first"] < 0.05
    assert seen["refused"] == 0
    assert not any(seen["joint_stiffness"])
    # Limp at the end, the physics let the legs spread.
    np.testing.assert_allclose(seen["joint_pos"][0::3], 0.0, atol=0.5 if physics else 0.05)
    np.testing.assert_allclose(seen["joint_pos"][1::3], 1.2, atol=0.5 if physics else 0.05)
    if physics:
        assert seen["highest"] > 0.25  # it stood
        assert seen["projected_gravity"][2] < -0.9
