"""Payload and contact friction of a scene: as a model that has them would move."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from unicon_base.errors import PlatformError, UniconError
from unicon_core.models.load import load_model
from unicon_core.platforms.kit.scene import Scene
from unicon_core.platforms.kit.start import tell_bodies
from unicon_core.robots import load_robot
from unicon_core.runtime.rollouts import Rollouts
from unicon_core.workflow import Program, load_document

mujoco = pytest.importorskip("mujoco")

AT = [0.1, -0.05, 0.12]


def go2():
    robot = load_robot("go2")
    return robot, Scene().model_path(robot)


@pytest.mark.parametrize("body", ["", "FL_calf"])
def test_a_payload_moves_like_a_welded_point(body):
    robot, path = go2()
    loaded = load_model(path, robot, quiet=True)
    name = body or loaded.model.body(loaded.model.jnt_bodyid[loaded.base]).name
    tell_bodies(loaded, {"mass": 3.0, "position": AT} | ({"body": body} if body else {}), 1.0)

    def weld(spec: Any) -> None:
        point = spec.body(name).add_body(name="payload", pos=AT)
        point.mass = 3.0
        point.ipos = [0.0] * 3
        point.inertia = [1e-12] * 3
        point.explicitinertial = True

    welded = load_model(path, robot, quiet=True, prepare=weld).model
    ends = []
    for model in (loaded.model, welded):
        data = mujoco.MjData(model)
        data.qpos[2] += 0.3
        data.qvel[:] = np.linspace(-1.0, 1.0, model.nv)
        mujoco.mj_step(model, data, 100)
        ends.append(data.qpos.copy())
    assert ends[0] == pytest.approx(ends[1], abs=1e-5)
    assert loaded.model.body_subtreemass[0] == pytest.approx(welded.body_subtreemass[0])


def test_a_payload_without_place_is_at_the_centre_of_mass():
    robot, path = go2()
    loaded, plain = (load_model(path, robot, quiet=True) for _ in range(2))
    tell_bodies(loaded, {"mass": 2.5}, 1.0)
    base = int(loaded.model.jnt_bodyid[loaded.base])
    assert loaded.model.body_mass[base] == plain.model.body_mass[base] + 2.5
    assert (loaded.model.body_ipos == plain.model.body_ipos).all()
    assert (loaded.model.body_inertia == plain.model.body_inertia).all()
    assert loaded.model.body_subtreemass[0] > plain.model.body_subtreemass[0] + 2.4


def test_friction_changes_every_contact():
    robot, path = go2()
    loaded, plain = (load_model(path, robot, quiet=True) for _ in range(2))
    tell_bodies(loaded, {}, 0.5)
    found = []
    for model in (loaded.model, plain.model):
        data = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, data, 0) if model.nkey else None
        data.qpos[2] = 0.05
        mujoco.mj_forward(model, data)
        found.append(np.array([contact.friction[0] for contact in data.contact]))
    assert len(found[0]) > 3
    assert found[0] == pytest.approx(0.5 * found[1])


@pytest.mark.parametrize("platform", ["mujoco", pytest.param("pybullet", marks=pytest.mark.slow)])
def test_a_robot_on_ice_does_not_come_far(platform):
    pytest.importorskip(platform)
    ways = []
    for friction in (1.0, 0.02):
        changed = {"platform": platform, "flow": {"policy": "walk"}}
        changed |= {"commands": [{"velocity_command": {"constant": [0.8, 0.0, 0.0]}}]}
        changed |= {"scene": {"initial_pose": "policy:walk", "contact_friction": friction}}
        program = Program(load_document("go2_walk", changed))
        Rollouts(program).run(100)
        ways.append(float(program.states.base_pos_w[0]))
        program.close()
    assert ways[1] < 0.3 * ways[0], ways


@pytest.mark.parametrize(
    ("payload", "friction", "told"),
    [
        ({}, -1.0, "contact_friction is -1.0; write a number from 0 to 20"),
        ({}, float("nan"), "contact_friction is nan"),
        ({}, True, "contact_friction is true"),
        ([3.0], 1.0, "payload is [3.0]; write {mass: 3.0}"),
        ({"weight": 3.0}, 1.0, "payload: unknown key 'weight'; known: body, mass, position"),
        ({"body": "base"}, 1.0, "payload: missing key 'mass'; add mass: a number from 0"),
        ({"mass": "heavy"}, 1.0, "payload.mass is 'heavy'"),
        ({"mass": 1e6}, 1.0, "payload.mass is 1000000.0"),
        ({"mass": 1.0, "body": 3}, 1.0, "payload.body is 3; write a text"),
        ({"mass": 1.0, "position": [0, 0]}, 1.0, "payload.position is [0, 0]; write a list of 3"),
        ({"mass": 1.0, "position": [0, 0, 99]}, 1.0, "payload.position.2 is 99"),
    ],
)
def test_what_is_wrong_is_told(payload, friction, told):
    with pytest.raises(PlatformError) as caught:
        Scene(payload=payload, contact_friction=friction)
    assert told in str(caught.value)
    assert "scene." in str(caught.value)


def test_an_unknown_body_and_a_base_that_stands_are_told():
    with pytest.raises(PlatformError, match=r"has no body 'trunc'; .*known: "):
        Program(load_document("go2_walk", {"scene.payload": {"mass": 1.0, "body": "trunc"}}))
    robot, path = go2()
    loaded = load_model(path, robot, quiet=True)

    class Fixed(type(loaded)):  # type: ignore[misc]
        base = None

    loaded.__class__ = Fixed
    with pytest.raises(PlatformError, match="the robot has no base that moves; name a body"):
        tell_bodies(loaded, {"mass": 1.0}, 1.0)


def test_a_platform_that_cannot_be_told_refuses():
    with pytest.raises(UniconError, match=r"'fake' cannot be told scene\.payload; take it out of"):
        Program(load_document("go2_stand", {"platform": "fake", "scene.payload.mass": 1.0}))
    with pytest.raises(UniconError, match=r"cannot be told scene\.contact_friction"):
        Program(load_document("go2_stand", {"platform": "fake", "scene.contact_friction": 0.5}))
