"""Intrinsics and optical frame of MuJoCo's cameras, judged by where its renderer draws a ball."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("mujoco")

import mujoco

from unicon_core.models.camera import intrinsics, optical_frame
from unicon_core.models.kinematic_tree import frame_of
from unicon_core.models.loaded import rotate
from unicon_core.robots import Robot, load_robot

HERE = Path(__file__).resolve().parent
BALL = (2.0, 0.3, 0.55)
NEW = hasattr(mujoco, "mjtProjection")
PARALLEL = 'projection="orthographic"' if NEW else 'orthographic="true"'
# Joints with an anchor, a reference and a slider lie between the base and the cameras.
SCENE = f"""\
<mujoco>
  <compiler angle="radian" autolimits="true"/>
  <visual><headlight ambient="1 1 1"/></visual>
  <worldbody>
    <geom type="sphere" size="0.05" pos="{BALL[0]} {BALL[1]} {BALL[2]}" rgba="1 0 0 1"/>
    <camera name="standing" pos="0 0 1" xyaxes="0 -1 0 0.2 0 1" fovy="50"/>
    <body name="post" pos="0 -1 0.2" quat="0.9 0 0 0.3">
      <geom size="0.01" mass="1"/>
      <camera name="post" pos="0 0.1 0.3" xyaxes="0 -1 0 0 0 1" fovy="50"/>
    </body>
    <body name="trunk" pos="0 0 0.5"><freejoint/><geom size="0.01" mass="1"/>
      <camera name="trunk" pos="0.2 0 0.1" xyaxes="0 -1 0 0 0 1" fovy="45"/>
      <camera name="sensor" pos="0.2 0 0.1" xyaxes="0 -1 0 0 0 1" resolution="64 48"
              sensorsize="0.008 0.006" focalpixel="50 60" principalpixel="7 -5"/>
      <camera name="parallel" pos="0.2 0 0.1" {PARALLEL}/>
      <camera name="follows" mode="targetbody" target="arm" pos="1 0 1"/>
      <body name="arm" pos="0.1 0.2 0.1" quat="0.99 0 0.1 0">
        <joint name="FR_hip_joint" axis="0 0.6 0.8" pos="0 .05 0.02" ref="0.3"/>
        <joint name="FR_thigh_joint" axis="1 0 0" pos="0 0 .1" range="-1 1"/>
        <geom size="0.01" mass="1"/>
        <body name="slider" pos="0 0 .2" quat="1 0 0 0.1">
          <joint name="FR_calf_joint" type="slide" axis="0 1 0" pos="0.01 0.02 0.03" ref="0.1"/>
          <geom size="0.01" mass="1"/>
          <camera name="tip" pos="0.1 0 0.1" xyaxes="0 -1 0 0.1 0 1" fovy="80"/>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""
FIXED = ("standing", "post", "trunk", "sensor", "tip")
WIDTH = 320
HEIGHT = 240
DRAW = """\
import json, os, sys
os.environ.setdefault("MUJOCO_GL", "egl")
import mujoco, numpy as np
model = mujoco.MjModel.from_xml_string(sys.stdin.read())
data = mujoco.MjData(model)
data.qpos[:] = json.loads(sys.argv[1])
mujoco.mj_forward(model, data)
renderer = mujoco.Renderer(model, int(sys.argv[3]), int(sys.argv[2]))
found = {}
for name in sys.argv[4:]:
    renderer.update_scene(data, name)
    picture = renderer.render().astype(int)
    ball = (picture[..., 0] > 60) & (picture[..., 1] + picture[..., 2] < 20)
    rows, columns = np.nonzero(ball)
    found[name] = [float(columns.mean()), float(rows.mean())] if len(rows) else None
print(json.dumps(found), flush=True)
os._exit(0)
"""


@pytest.fixture
def robot():
    """The three joints of the scene, in a robot whose base is called trunk."""
    go2 = load_robot("go2")
    fields = {**vars(go2)}
    for key, value in fields.items():
        if isinstance(value, np.ndarray):
            fields[key] = value[:3]
    own = {"joint_names": go2.joint_names[:3], "base_frame": "trunk"}
    return Robot(**(fields | own))


@pytest.fixture
def model():
    return mujoco.MjModel.from_xml_string(SCENE)


@pytest.fixture
def qpos():
    return [0.1, -0.1, 0.6, 0.995, 0.0, 0.05, 0.08, 0.35, 0.2, 0.15]


def in_world(model, data, robot, parent):
    """Return origin and quaternion of a frame by MuJoCo's own kinematics."""
    if parent == "odom":
        return np.zeros(3), np.array((1.0, 0.0, 0.0, 0.0))
    body = model.body(parent).id
    carried = frame_of(model, robot, body)
    assert carried is not None
    name, origin = carried
    assert name == parent
    return data.xpos[body] + rotate(data.xquat[body], origin), data.xquat[body]


@pytest.mark.parametrize(
    ("name", "expected"),
    [("standing", "odom"), ("post", "odom"), ("trunk", "trunk"), ("tip", "slider")],
)
def test_the_optical_frame_is_where_the_camera_is(name, expected, model, robot, qpos):
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    camera = model.camera(name).id
    mount = optical_frame(model, robot, camera)
    assert mount is not None
    parent, position, quat = mount
    assert parent == expected
    origin, turn = in_world(model, data, robot, parent)
    np.testing.assert_allclose(origin + rotate(turn, position), data.cam_xpos[camera], atol=1e-9)
    axes = data.cam_xmat[camera].reshape(3, 3)  # columns: right, up, backward
    for axis, there in zip(np.eye(3), (axes[:, 0], -axes[:, 1], -axes[:, 2])):
        np.testing.assert_allclose(rotate(turn, rotate(quat, axis)), there, atol=1e-9)


def test_a_camera_in_the_world_of_a_robot_that_stands_there_hangs_on_its_base(robot):
    fixed = mujoco.MjModel.from_xml_string(SCENE.replace("<freejoint/>", ""))
    mount = optical_frame(fixed, robot, fixed.camera("standing").id)
    assert mount is not None
    assert mount[0] == "trunk"
    np.testing.assert_allclose(mount[1], (0.0, 0.0, 1.0), atol=1e-12)


def test_a_camera_that_turns_by_itself_has_no_frame_of_its_own(model, robot):
    assert optical_frame(model, robot, model.camera("follows").id) is None


def test_a_camera_without_perspective_has_no_intrinsics(model):
    found = intrinsics(model, model.camera("parallel").id, WIDTH, HEIGHT)
    assert (found.fx, found.fy) == (0.0, 0.0)


def test_the_renderer_draws_a_ball_where_intrinsics_and_frame_say(model, robot, qpos):
    numbers = [json.dumps(qpos), str(WIDTH), str(HEIGHT)]
    done = subprocess.run(
        [sys.executable, "-c", DRAW, *numbers, *FIXED],
        input=SCENE,
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        last = (done.stderr.strip().splitlines() or ["no reason told"])[-1]
        pytest.skip(f"no offscreen OpenGL ({last})")
    drawn = json.loads(done.stdout)
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    for name in FIXED:
        camera = model.camera(name).id
        mount = optical_frame(model, robot, camera)
        assert mount is not None
        parent, position, quat = mount
        origin, turn = in_world(model, data, robot, parent)
        seen = rotate(inverse(turn), np.array(BALL) - origin) - position
        x, y, z = rotate(inverse(quat), seen)
        pinhole = intrinsics(model, camera, WIDTH, HEIGHT)
        expected = [pinhole.fx * x / z + pinhole.cx, pinhole.fy * y / z + pinhole.cy]
        assert drawn[name] is not None, name
        assert drawn[name] == pytest.approx(expected, abs=0.2), name  # pixels


def inverse(quat):
    return quat * np.array((1.0, -1.0, -1.0, -1.0))
