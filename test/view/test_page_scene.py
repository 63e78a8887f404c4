"""What a live page draws and hears: shapes, the robot's size, path, ghost, grips; heartbeats."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest

from unicon_base.resources import find_config
from unicon_core.models.loaded import LoadedModel
from unicon_core.platforms.kit.base import rotation
from unicon_core.robots import load_robot
from unicon_core.states import Layout, States
from unicon_core.states.standard import standard_states

pytest.importorskip("viser", reason="no live page: pip install 'unicon_ros[view]'")

from unicon_lab.view.page.scene import Stage
from unicon_lab.view.page.shapes import shapes_of
from unicon_lab.view.page.viewer import state_of


def loaded_model(text: str, joints: list[int]) -> Any:
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{text}</worldbody></mujoco>")
    return LoadedModel(model, Path(), joints)


def test_bodies_without_looks_get_ellipsoids_and_bones() -> None:
    loaded = loaded_model(
        """<body name="trunk" pos="0 0 1"><freejoint/>
        <geom type="capsule" size="0.1 0.2" rgba="1 0 0 1"/>
        <geom type="box" size="0.1 0.2 0.3" pos="0 0 1" rgba="0 1 0 1"/>
        <body name="thigh" pos="0 0.05 0"><joint/>
        <inertial mass="1" pos="0 0 0" diaginertia=".01 .01 .01"/>
        <body name="calf" pos="0 0 -0.5"><joint/>
        <inertial mass="1" pos="0.1 0 -0.1" diaginertia=".0064 .0064 .0064"/>
        </body></body></body>""",
        [1, 2],
    )
    capsule, box, thigh, calf = shapes_of(loaded)
    assert np.ptp(capsule.vertices, axis=0) == pytest.approx([0.2, 0.2, 0.6], rel=0.05)
    assert np.allclose(capsule.vertices.mean(axis=0), 0.0, atol=0.02)
    assert box.vertices.min(axis=0) == pytest.approx([-0.1, -0.2, 0.7])
    assert (thigh.body, calf.body, capsule.body) == (2, 3, 1)
    assert thigh.vertices[:, 2].min() == pytest.approx(-0.5, abs=0.01)  # a bone to the calf
    assert np.ptp(calf.vertices, axis=0).max() < 0.2 * 2 * 0.14  # no inertia makes it monstrous
    assert calf.vertices.mean(axis=0) == pytest.approx([0.1, 0.0, -0.1], abs=1e-3)
    shapes = (capsule, box, thigh, calf)
    assert all(shape.faces.max() < len(shape.vertices) for shape in shapes)


def test_a_body_with_contact_dots_alone_gets_the_hull_of_its_collision_geoms() -> None:
    dots = "".join(
        f'<geom type="sphere" size="0.002" pos="{x} {y} -0.05"/>'
        for x in (-0.1, 0.1)
        for y in (-0.05, 0.05)
    )
    loaded = loaded_model(
        f"""<body pos="0 0 1"><freejoint/><geom type="box" size="0.1 0.1 0.4"/>
        <body pos="0 0 -0.4"><joint/>{dots}</body>
        <body pos="0 0 0.4"><joint/><geom type="box" size="0.2 0.1 0.1" group="3"/></body>
        </body>""",
        [1, 2],
    )
    hulls = {s.body: s for s in shapes_of(loaded) if s.rgba == shapes_of(loaded)[-1].rgba}
    assert set(hulls) == {2, 3}
    foot, head = hulls[2].vertices, hulls[3].vertices
    assert foot.min(axis=0) == pytest.approx([-0.102, -0.052, -0.052], abs=1e-3)
    assert foot[:, 2].max() == pytest.approx(0.0)  # up to the ankle
    assert np.ptp(head, axis=0) == pytest.approx([0.4, 0.2, 0.2])


@pytest.fixture
def stage() -> Any:
    robot = load_robot("go2")
    named: Any = ("world", "base_link", "FL_foot")
    found = find_config("models/go2", "go2", ".xml")
    return Stage(SimpleNamespace(robot=robot, model=found, terrain=None, bodies=named))  # type: ignore[arg-type]


def standing(stage: Any, **values: Any) -> dict[str, Any]:
    robot = stage._robot
    states = States(Layout(standard_states(robot.joint_names)))
    states["joint_pos"][:] = states["joint_pos_target"][:] = robot.default_joint_pos
    states["base_pos_w"][:] = 0.0, 0.0, 0.4
    for name, value in values.items():
        states[name][...] = value
    return {name: states[name] for name in states}


def test_a_view_is_as_large_as_the_robot(stage: Any) -> None:
    assert 0.7 < stage.size < 1.1  # Go2: 0.7 m long, 0.4 m high
    assert stage.middle == pytest.approx([0.0, 0.0, 0.18], abs=0.06)


def test_a_reset_clears_the_path(stage: Any) -> None:
    for number, x in enumerate((0.0, 0.5, 1.0)):
        where = {"base_pos_w": (x, 0.0, 0.4), "stamp_ns": 10**9 * number}
        stage.put(number, standing(stage, **where))
    assert len(stage.path) == 3
    jitters = standing(stage, base_pos_w=(1.5, 0.0, 0.4), stamp_ns=2 * 10**9 - 1000)
    stage.put(3, jitters)
    assert len(stage.path) == 4
    stage.put(4, standing(stage, stamp_ns=0))
    assert stage.path[:, 0].tolist() == [0.0]


def test_a_ghost_stands_at_the_targets_of_joints_that_are_held(stage: Any) -> None:
    stiff = np.zeros(stage._robot.num_joints)
    states = standing(stage, base_pos_w=(1.0, 2.0, 0.4), joint_stiffness=stiff)
    states["joint_pos_target"][:] += 0.3
    pose = stage.put(1, states)
    position, _ = stage.ghost(states, pose)
    assert np.allclose(position, pose.position)
    position, _ = stage.ghost({"joint_pos": states["joint_pos"]}, pose)  # of a bag that has no more
    assert np.allclose(position, pose.position)
    states["joint_stiffness"][1:3] = 20.0
    states["joint_pos_target"][2] = np.nan
    position, quat = stage.ghost(states, pose)
    moved = np.abs(quat - pose.quat).max(axis=1) > 1e-3
    names = {stage._model.body(int(body)).name[:3] for body in np.flatnonzero(moved)}
    assert names == {"FL_"} or names == {"FR_"}


def test_a_point_is_held_in_the_frame_of_its_body(stage: Any) -> None:
    pose = stage.put(1, standing(stage, base_quat=(0.5, 0.5, 0.5, 0.5)))
    assert sorted(stage.dragged.values()) == [1, 2]
    body = next(body for body, number in stage.dragged.items() if number == 1)
    local = np.array((0.1, -0.2, 0.05))
    world = pose.position[body] + rotation(pose.quat[body]) @ local
    assert stage.held(body, world) == pytest.approx(local)


@pytest.mark.parametrize(
    ("text", "state"),
    [
        ('7 {"hidden": false, "stops": 0}', {"hidden": False, "stops": 0}),
        ("", None),
        ("7", None),
        ("7 []", None),
        ("7 {", None),
        ("7 " + "[" * 100_000, None),
    ],
)
def test_a_heartbeat_is_read_and_garbage_is_not(text: str, state: Any) -> None:
    assert state_of(text) == state
