"""Bad input of the MuJoCo platform gets one line with culprit, alternatives and remedy."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scenes import in_scene

from unicon_base.errors import (
    Fault,
    MissingDependencyError,
    ModelError,
    PlatformError,
    WorkflowError,
)
from unicon_core.platforms.mujoco import MujocoPlatform, make
from unicon_core.states import States


@pytest.fixture
def build(toy_robot, toy_model, states_of):
    def make_it(
        period: float = 0.01, joints: tuple[str, ...] | None = None, **options: Any
    ) -> tuple[MujocoPlatform, States]:
        robot = toy_robot(joints) if joints else toy_robot()
        states = states_of(robot)
        if "model" not in options:
            options["model"] = toy_model()
        return in_scene(make, states, robot, period, **options), states

    return make_it


Build = Callable[..., tuple[MujocoPlatform, States]]

JOINTS = ("shoulder_joint", "elbow_joint", "wrist_joint", "fingr_joint")


def message(error, tmp_path):
    return str(error.value).replace(str(tmp_path), "DIR")


def test_joint_that_the_model_lacks(build, tmp_path):
    with pytest.raises(ModelError) as error:
        build(joints=JOINTS)
    assert message(error, tmp_path) == (
        "model DIR/toy.xml: no joint 'fingr_joint'; did you mean 'finger_joint'? known: "
        "elbow_joint, finger_joint, shoulder_joint, wrist_joint; rename it in the model, or "
        "choose the model of this robot (scene: {model: PATH})"
    )


def test_joint_names_may_lack_the_ending(build, tmp_path, toy_model):
    path = toy_model()
    path.write_text(path.read_text().replace('"wrist_joint"', '"arm/wrist"'))
    platform, _ = build(model=path)
    assert platform.info()["actuators"]["wrist_joint"] == "position"


def test_joint_that_could_be_two(build, tmp_path, toy_model):
    path = toy_model()
    text = (
        path.read_text().replace('"wrist_joint"', '"a/wrist"').replace('"elbow_joint"', '"wrist"')
    )
    path.write_text(text)
    with pytest.raises(ModelError) as error:
        build(model=path, joints=("shoulder_joint", "wrist_joint", "finger_joint"))
    assert message(error, tmp_path) == (
        "model DIR/toy.xml: joint 'wrist_joint' could be any of wrist, a/wrist; "
        "rename it in the model, or choose the model of this robot (scene: {model: PATH})"
    )


def test_no_model_at_all(build, tmp_path):
    with pytest.raises(ModelError) as error:
        build(model=None)
    assert message(error, tmp_path) == (
        "robot toy names no model (mjcf or urdf); put one beside DIR/toy.yaml and add models: "
        "{mjcf: FILE} ({urdf: FILE} for a URDF), or let the workflow name one anywhere: "
        "scene: {model: PATH}"
    )


def test_model_file_that_is_not_there(build):
    with pytest.raises(ModelError, match=r"^model '/no/such\.xml': no such file"):
        build(model="/no/such.xml")


def test_model_file_that_is_broken(build, tmp_path):
    path = tmp_path / "broken.xml"
    path.write_text("<mujoco><worldbody><geom sise='1'/></worldbody></mujoco>")
    with pytest.raises(ModelError) as error:
        build(model=path)
    text = message(error, tmp_path)
    assert text.startswith("model DIR/broken.xml: ")
    assert "sise" in text
    assert "\n" not in text


def test_period_that_is_no_whole_number_of_steps(build, tmp_path):
    with pytest.raises(ModelError) as error:
        build(period=0.005)
    assert message(error, tmp_path) == (
        "a tick of 0.005 s is not a whole number of physics steps of 0.002 s (model DIR/toy.xml); "
        "write platforms: {mujoco: {timestep: 0.0025}} (or 0.001666666667), or correct the period "
        "to 0.004 or 0.006"
    )


def test_unknown_key_frame(build, tmp_path):
    with pytest.raises(ModelError) as error:
        build(initial_pose="keyframe:upp")
    assert message(error, tmp_path) == (
        "model DIR/toy.xml has no key frame 'upp'; did you mean 'up'? known: up; "
        "correct scene.initial_pose"
    )


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (
            {"initial_pose": "sit"},
            "scene.initial_pose is 'sit'; known: default, keyframe:NAME, lie, model, "
            "policy:NAME, rest, stand; or joints to [rad]",
        ),
        (
            {"initial_pose": {"knee": 1.0}},
            "robot toy has no joint like 'knee'; "
            "known: elbow_joint, finger_joint, shoulder_joint, wrist_joint",
        ),
        ({"delay": -1}, "scene.delay is -1; write a whole number from 0 to 1000 [ticks]"),
        (
            {"terrain": "hills"},
            "scene.terrain is 'hills'; known: flat, gaps, obstacles, patches, pyramid, rough, "
            "slope, stairs; or put other ground into a model (scene: {model: PATH})",
        ),
        ({"noise": {"joint_pos": -1.0}}, "scene.noise.joint_pos is -1.0; write a number from 0"),
        (
            {"push": {"each": 1.0, "every": 1.0, "velocity": 1.0}},
            "scene.push: unknown key 'each'; known: every, velocity",
        ),
        (
            {"push": {"every": 1.0}},
            "scene.push: missing key 'velocity'; add velocity: a number above 0 [m/s]",
        ),
    ],
)
def test_wrong_options(build, options, expected):
    with pytest.raises((PlatformError, WorkflowError)) as error:
        build(**options)
    assert str(error.value) == expected


def test_noise_of_a_state_that_is_not_measured(build):
    with pytest.raises(PlatformError) as error:
        build(noise={"joint_poss": 0.1})
    assert str(error.value).startswith(
        "scene.noise: platform 'mujoco' measures no 'joint_poss'; did you mean 'joint_pos'? known: "
    )


@pytest.mark.parametrize("timestep", [1e-300, 1e-9, 0.0, -0.01, np.nan])
def test_physics_steps_without_number(build, timestep, tmp_path):
    with pytest.raises(ModelError) as error:
        build(timestep=timestep)
    assert "timestep" in str(error.value)


def test_mujoco_that_is_not_installed(build, monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(MissingDependencyError) as error:
        build()
    assert str(error.value) == ("platform 'mujoco' needs mujoco: pip install 'unicon_ros[sim]'")


def test_viewer_without_a_display(build, monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(PlatformError) as error:
        build()[0].viewer()
    assert str(error.value) == (
        "the viewer needs a display and neither DISPLAY nor WAYLAND_DISPLAY is set; "
        "give --view for a page in the browser, or run it under a desktop, `ssh -X` or `xvfb-run`"
    )


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("state", ["joint_pos_target", "joint_effort_ff", "joint_damping"])
def test_command_that_is_not_finite_moves_nothing(build, state, value):
    platform, states = build()
    platform.send()
    before = platform.data.qpos.copy()
    states[state][2] = value
    with pytest.raises(Fault) as error:
        platform.send()
    assert str(error.value) == (f"{state} of joint wrist_joint is {value}")
    assert platform.data.qpos.tolist() == before.tolist()


def test_physics_that_blows_up(build, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    platform, states = build()
    platform.model.actuator_forcelimited[:] = 0
    platform.model.jnt_actfrclimited[:] = 0
    states.joint_stiffness = (10.0, 1e9, 10.0, 10.0)
    states.joint_damping = -1e6
    states.joint_pos_target = 1.0
    with pytest.raises(Fault) as error:  # noqa: PT012  it may take a few ticks
        for _ in range(100):
            platform.send()
    text = str(error.value)
    assert text.startswith("the physics blew up before 0.")
    assert "joint" in text
    assert text.endswith("lower the gains or the physics step (timestep)")
    assert "MUJOCO_LOG.TXT" not in os.listdir(tmp_path)
