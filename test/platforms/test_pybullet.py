"""PyBullet runs the workflows of MuJoCo by one word, and the robot does the same there."""

from __future__ import annotations

import importlib.util
import sys
from typing import Any

import numpy as np
import pytest

from unicon_base.errors import Fault, MissingDependencyError
from unicon_core.models.kinematic_tree import physical_links, read_tree
from unicon_core.platforms.kit.scene import Scene
from unicon_core.platforms.kit.start import start_of
from unicon_core.platforms.platform import Resettable
from unicon_core.robots import load_robot
from unicon_core.runtime import Runner, RunOptions
from unicon_core.workflow import load_workflow

# What these tests run against, the most that config/evidence.yaml may say by them.
EVIDENCE = "vendor"

needs_pybullet = pytest.mark.skipif(
    importlib.util.find_spec("pybullet") is None,
    reason="pybullet is not installed: pip install 'unicon_ros[sim-pybullet]' (Python 3.10, 3.11)",
)


def ticked(name, overrides, seconds):
    """Run a workflow tick by tick; return what the platform measured, rows of ticks."""
    workflow = load_workflow(name, overrides)
    runner = Runner(workflow, RunOptions(speed="max"))
    states = workflow.states
    names = ("base_pos_w", "base_quat", "joint_pos", "projected_gravity", "base_lin_acc")
    rows: dict[str, list[Any]] = {name: [] for name in (*names, "stamp_ns")}
    try:
        for _ in range(round(seconds / workflow.period)):
            done = runner.tick(0)
            for name, row in rows.items():
                row.append(np.array(states[name]))
            if done:
                break
    finally:
        runner.close()
    return {name: np.array(row) for name, row in rows.items()}


# Enough for a Go2, in half the time.
COARSE = "platforms={pybullet: {timestep: 0.001}}"


@needs_pybullet
def test_go2_stand_lies_stands_and_lies_as_on_mujoco():
    heights = {}
    for platform in ("mujoco", "pybullet"):
        told = ticked("go2_stand", [f"platform={platform}", COARSE], 15.0)
        heights[platform] = told["base_pos_w"][:, 2]
        assert told["stamp_ns"][1] == 20_000_000
        assert np.abs(np.linalg.norm(told["base_quat"], axis=1) - 1.0).max() < 1e-5
        assert told["projected_gravity"][-1, 2] < -0.99
        standing = told["base_lin_acc"][150:200].mean(axis=0)
        assert standing == pytest.approx((0.0, 0.0, 9.81), abs=0.7)
    apart = np.abs(np.subtract(*heights.values()))
    assert len(apart) == 750
    assert float(apart[::25].max()) < 0.02  # every half second: measured 0.3 cm
    low = heights["pybullet"][0]
    high = heights["pybullet"][150]
    assert low < 0.15 < 0.25 < high
    assert heights["pybullet"][-1] < 0.15


@pytest.mark.slow
@needs_pybullet
def test_go2_walk_walks_there():
    pytest.importorskip("onnxruntime", reason="the policy needs onnxruntime")
    workflow = load_workflow("go2_walk", ["platform=pybullet", COARSE])
    report = Runner(workflow, RunOptions(speed="max")).run()
    assert report.faults == []
    assert report.ended == "done"
    assert not report.fell
    assert np.hypot(*report.base_displacement_m[:2]) >= 3.5


@needs_pybullet
@pytest.mark.slow
def test_g1_walks_there(assets, monkeypatch):
    monkeypatch.setenv("UNICON_ASSETS", str(assets))
    pytest.importorskip("onnxruntime", reason="the policy needs onnxruntime")
    workflow = load_workflow("g1_walk", ["platform=pybullet", "duration=20"])
    report = Runner(workflow, RunOptions(speed="max")).run()
    assert report.faults == []
    assert not report.fell
    assert np.hypot(*report.base_displacement_m[:2]) >= 8.0


@needs_pybullet
def test_it_is_disturbed_as_every_simulator():
    flow = "flow={hold: {duration: 0.6}}"
    calm = ticked("go2_stand", ["platform=pybullet", COARSE, flow], 0.6)
    pushes = "scene={initial_pose: rest, push: {every: 0.2, velocity: 2.0}, seed: 3}"
    pushed = ticked("go2_stand", ["platform=pybullet", COARSE, flow, pushes], 0.6)
    apart = np.linalg.norm(pushed["base_pos_w"] - calm["base_pos_w"], axis=1)
    assert apart[:10].max() < 1e-6
    assert apart[-1] > 0.02
    noise = "scene={initial_pose: rest, noise: {joint_pos: 0.1}, seed: 3}"
    noisy = ticked("go2_stand", ["platform=pybullet", COARSE, flow, noise], 0.6)
    assert np.abs(noisy["joint_pos"][0] - calm["joint_pos"][0]).max() > 0.05
    again = ticked("go2_stand", ["platform=pybullet", COARSE, flow, noise], 0.6)
    assert noisy["joint_pos"].tobytes() == again["joint_pos"].tobytes()


@needs_pybullet
def test_a_reset_begins_anew_and_two_worlds_do_not_meet():
    first = load_workflow("go2_stand", ["platform=pybullet"])
    other = load_workflow("go2_stand", ["platform=pybullet"])
    platform = first.platform
    states = first.states
    robot = first.robot
    assert isinstance(platform, Resettable)
    traces = []
    for _ in range(2):
        platform.reset()
        platform.recv()
        assert int(states.stamp_ns) == 0
        assert states.joint_pos == pytest.approx(robot.rest_joint_pos, abs=1e-6)
        for _ in range(20):
            states.joint_pos_target = robot.rest_joint_pos
            states.joint_stiffness = 20.0
            states.joint_damping = 1.0
            platform.send()
            platform.recv()
        traces.append(np.array([*states.joint_pos, *states.base_pos_w]))
    assert traces[0] == pytest.approx(traces[1], abs=1e-4)
    other.platform.recv()
    assert int(other.states.stamp_ns) == 0
    first.platform.close()
    first.platform.close()
    other.platform.recv()
    first.close()
    other.close()


@needs_pybullet
def test_a_command_that_is_not_finite_moves_nothing():
    workflow = load_workflow("go2_stand", ["platform=pybullet"])
    workflow.platform.recv()
    workflow.states.joint_pos_target[3] = np.nan
    with pytest.raises(Fault, match=r"^joint_pos_target of joint FL_hip_joint is nan$"):
        workflow.platform.send()
    workflow.close()


@needs_pybullet
def test_it_prints_nothing(capfd):
    load_workflow("go2_stand", ["platform=pybullet"]).close()
    assert capfd.readouterr().out == ""


def test_without_pybullet_the_install_command_is_told(monkeypatch):
    monkeypatch.setitem(sys.modules, "pybullet_utils", None)
    monkeypatch.setitem(sys.modules, "pybullet_utils.bullet_client", None)
    with pytest.raises(MissingDependencyError) as error:
        load_workflow("go2_stand", ["platform=pybullet"])
    assert str(error.value) == (
        "platform 'pybullet' needs pybullet: pip install 'unicon_ros[sim-pybullet]'"
    )


def test_its_links_weigh_what_the_model_weighs():
    pytest.importorskip("mujoco", reason="mujoco reads the models")
    robot = load_robot("go2")
    loaded = start_of(robot, Scene()).loaded
    links = physical_links(read_tree(loaded.model, robot, colliding=True))
    assert sum(link.mass for link in links) == pytest.approx(float(loaded.model.body_mass.sum()))
    assert links[0].mass > 1.0
    assert all(link.mass > 0.0 and link.parent < i for i, link in enumerate(links))
