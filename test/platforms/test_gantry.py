"""A gantry in a scene: it holds a base that nobody balances, and the report says so."""

from __future__ import annotations

import numpy as np
import pytest

from unicon_base.errors import WorkflowError
from unicon_core.platforms.kit.scene import Scene
from unicon_core.robots import load_robot
from unicon_core.runtime import Runner, RunOptions
from unicon_core.states import Layout, States
from unicon_core.states.standard import standard_states
from unicon_core.workflow import Program, load_document

pytest.importorskip("mujoco", reason="mujoco is not installed: pip install 'unicon_ros[sim]'")
from unicon_core.platforms.mujoco.platform import make


def held(scene, robots=None, name="go2"):
    """Return a robot in MuJoCo, its states beside it."""
    robot = load_robot(name)
    states = States(Layout(standard_states(robot.joint_names), robots))
    return states, make(states, robot, 0.02, scene=scene)


def limp(states, platform, seconds):
    for _ in range(round(seconds / 0.02)):
        platform.recv()
        platform.send()
    platform.recv()


@pytest.mark.parametrize("terrain", ["flat", "rough"])
def test_a_gantry_bears_a_limp_robot_and_brings_it_back(terrain):
    states, platform = held(Scene(gantry=True, initial_height=0.6, terrain=terrain))
    limp(states, platform, 2.0)
    assert states["base_pos_w"] == pytest.approx([0.0, 0.0, 0.6], abs=0.002)
    platform.push(np.array([1.0, 0.0]))
    platform.data.qvel[3:6] = [1.0, 1.0, 1.0]
    limp(states, platform, 0.1)
    assert states["base_pos_w"][0] > 0.01
    limp(states, platform, 2.0)
    assert states["base_pos_w"] == pytest.approx([0.0, 0.0, 0.6], abs=0.002)
    assert states["projected_gravity"][2] < -0.9999
    platform.reset()
    limp(states, platform, 2.0)
    assert states["base_pos_w"] == pytest.approx([0.0, 0.0, 0.6], abs=0.002)
    platform.change(Scene(initial_height=0.6, terrain=terrain))  # as one without it
    limp(states, platform, 1.0)
    assert states["base_pos_w"][2] < 0.4


@pytest.mark.parametrize("name", ["a1", "b2", "g1_29dof", "go1", "h1", "h1_2", "t1"])
def test_a_gantry_bears_robots_of_all_weights(assets, name):
    """Of a Go1, whose model integrates its damping explicitly, the physics blew up."""
    if not (assets / "models" / name).is_dir():
        pytest.skip(f"no model of {name} in {assets}")
    states, platform = held(Scene(gantry=True, initial_height=2.0), name=name)
    limp(states, platform, 2.0)
    assert states["base_pos_w"] == pytest.approx([0.0, 0.0, 2.0], abs=0.01)
    assert states["projected_gravity"][2] < -0.99


def test_it_holds_every_robot_of_a_batch():
    states, platform = held(Scene(gantry=True, initial_height=0.6), 3)
    limp(states, platform, 1.0)
    assert states["base_pos_w"][:, 2] == pytest.approx(0.6, abs=0.002)
    platform.close()


def program(**changes):
    return Program(load_document("h1_stand", {"robot": "go2", "duration": 1.0} | changes))


def test_the_report_says_that_it_hangs():
    for platform in ("mujoco", "fake"):
        report = Runner(program(platform=platform), RunOptions(speed="max")).run()
        assert report.faults == []
        assert report.fell is None
        assert "hangs on a gantry (scene.gantry), moved +0.00 +0.00" in report.summary()
        assert "fall" not in report.summary()
    report = Runner(program(scene={"gantry": False}), RunOptions(speed="max")).run()
    assert report.fell is False
    assert "gantry" not in report.summary()


def test_a_robot_is_where_it_is_and_a_fixed_base_is_fixed():
    report = Runner(program(platform="fake_robot", duration=0.3)).run()
    assert report.fell is False
    assert "gantry" not in report.summary()
    report = Runner(program(robot="arx_x5"), RunOptions(speed="max")).run()
    assert "base          fixed" in report.summary()


@pytest.mark.parametrize(
    ("changes", "culprit"),
    [
        ({"platform": "newton"}, "cannot be told scene.gantry"),
        ({"scene": {"gantry": "yes"}}, "scene.gantry"),
    ],
)
def test_what_no_simulator_can_is_refused(changes, culprit):
    with pytest.raises(WorkflowError, match=culprit):
        program(**changes)
