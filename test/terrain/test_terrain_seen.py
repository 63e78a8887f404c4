"""Who draws the model of a run draws the ground under it: cameras, and the live page."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from unicon_core.runtime.rollouts import Rollouts
from unicon_core.workflow import Program, load_document

pytest.importorskip("mujoco")


CAMERA = """\
import numpy as np
from unicon_core.models.camera import ModelCamera
from unicon_core.platforms.kit.scene import Scene
from unicon_core.robots import load_robot
from unicon_core.terrain.words import read_terrain
robot = load_robot("go2")
stand = np.nan_to_num(robot.default_joint_pos.astype(float))
camera = ModelCamera(
    Scene().model_path(robot), robot, "eye", (32, 24), body="base_link",
    position=(0.4, 0.0, 0.0), depth=True, terrain=read_terrain(TERRAIN, 0),
)
seen = camera.shoot(stand, np.array([0.0, 0.0, 0.2, 1.0, 0.0, 0.0, 0.0]))
print(float(seen[11, 16]), flush=True)
"""


@pytest.mark.slow
def test_a_camera_sees_a_step() -> None:
    environment, ways = {"MUJOCO_GL": "egl", **os.environ}, []
    for terrain in ("flat", {"pyramid": {"rise": 0.3, "steps": 1}}):
        command = [sys.executable, "-c", CAMERA.replace("TERRAIN", repr(terrain))]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        if "no offscreen OpenGL" in done.stderr:
            pytest.skip("no offscreen OpenGL: apt install libegl1 libgl1-mesa-dri")
        ways.append(float(done.stdout))
    assert ways[0] > 5.0  # the horizon
    assert ways[1] == pytest.approx(0.6, abs=0.02)  # 1 m in front of the origin


@pytest.mark.parametrize("said", [{"rough": {"extent": 10.0}}, {"slope": {"angle": 0.1}}])
def test_the_live_page_draws_it_and_feet_on_it(said: object) -> None:
    pytest.importorskip("viser", reason="pip install 'unicon_ros[view]'")
    from unicon_lab.view.page.scene import Stage
    from unicon_lab.view.shown import shown_of

    changed = {"flow": {"policy": "walk"}, "scene.initial_pose": "policy:walk"}
    changed |= {"commands": [{"velocity_command": {"constant": [0.8, 0.0, 0.0]}}]}
    program = Program(load_document("go2_walk", changed | {"scene.terrain": said}))
    rollouts = Rollouts(program)
    rollouts.run(150)
    program.platform.recv()  # what the last step made of it
    shown, _ = shown_of(program, rollouts.graphs()["run"])
    stage = Stage(shown)
    names = ("joint_pos", "base_pos_w", "base_quat")
    pose = stage.put(1, {name: program.states[name] for name in names})
    simulated = program.platform.data  # type: ignore[attr-defined]
    model = simulated.model
    touched = {model.geom(int(geom)).name for pair in simulated.contact.geom for geom in pair}
    program.close()
    feet = {foot.removesuffix("_foot") for foot in pose.touching}
    assert feet >= touched & {"FL", "FR", "RL", "RR"} != set()
    assert any(name.startswith("terrain") for name in touched)
    assert [shape for shape in stage.shapes if shape.body == 0]
