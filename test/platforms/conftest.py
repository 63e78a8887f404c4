"""A small robot whose model disagrees with the robot file in order, gear and kind of actuator."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from scenes import in_scene

from unicon_core.robots import Robot, load_robot
from unicon_core.states import States, standard_states

if TYPE_CHECKING:
    from unicon_core.platforms.mujoco import MujocoPlatform

pytest.importorskip("mujoco", reason="mujoco is not installed: pip install 'unicon_ros[sim]'")

JOINTS = ("shoulder_joint", "elbow_joint", "wrist_joint", "finger_joint")

ROBOT = """\
schema: unicon.robot/1
name: toy
description: floating box with a limb
manufacturer: ours
kind: quadruped
models: {{}}
base_frame: box
joints:
{joints}
imu: {{frame: imu, position: [0, 0, 0], quat: [1, 0, 0, 0]}}
feet: [box]
transport: {{protocol: none}}
sources: {{joints: ours, gains: ours, default: ours, rest: ours, imu: ours, feet: ours,
  transport: ours}}
unknown: []
"""

JOINT = (
    "  - {{name: {name}, lower: -2.0, upper: 2.0, velocity: 20.0, effort: {effort}, "
    "default: 0.1, rest: -0.1, stiffness: 20.0, damping: 0.5}}"
)

# Actuators in another order than the joints, named unlike them, of four kinds; one has a gear.
ACTUATORS = """
    <position name="a" joint="wrist_joint" kp="7" kv="0.3" ctrlrange="-1.5 1.5"/>
    <motor name="b" joint="shoulder_joint" gear="3" ctrlrange="-4 4"/>
    <velocity name="c" joint="finger_joint" kv="2" forcerange="-5 5"/>
    <general name="d" joint="elbow_joint" gaintype="affine" gainprm="2 1 0"/>
"""

MODEL = """
<mujoco model="toy">
  <compiler angle="radian" autolimits="true"/>
  <option timestep="0.002" integrator="{integrator}"/>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 1"/>
    <body name="ball" pos="5 5 1"><freejoint/><geom size="0.1"/></body>
    <body name="box" pos="0 0 2">
      {base}
      <geom type="box" size="0.2 0.1 0.05" mass="4"/>
      <site name="imu" pos="0.05 0 0.02" {site}/>
      <body pos="0.2 0 0">
        <joint name="finger_joint" axis="1 0 0" range="-2 2" armature="0.02"/>
        <geom type="capsule" size="0.02" fromto="0 0 0 0 0 -0.1" mass="0.3"/>
      </body>
      <body pos="0 0.1 0">
        <joint name="shoulder_joint" axis="0 1 0" range="-2 2" armature="0.02"/>
        <geom type="capsule" size="0.02" fromto="0 0 0 0 0 -0.2" mass="0.5"/>
        <body pos="0 0 -0.2">
          <joint name="elbow_joint" axis="0 1 0" range="-2 2" armature="0.02"
            actuatorfrcrange="-6 6"/>
          <geom type="capsule" size="0.02" fromto="0 0 0 0.2 0 0" mass="0.3"/>
          <body pos="0.2 0 0">
            <joint name="wrist_joint" axis="0 0 1" range="-2 2" armature="0.02"/>
            <geom type="sphere" size="0.03" mass="0.2"/>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>{actuators}</actuator>
  <sensor>{sensors}</sensor>
  <keyframe>
    <key name="up" qpos="5 5 1 1 0 0 0  1 2 3 1 0 0 0  0.4 0.1 0.2 0.3"/>
  </keyframe>
</mujoco>
"""

SENSORS = """
    <accelerometer name="imu_acc" site="imu"/>
    <gyro name="imu_gyro" site="imu"/>
    <framequat name="imu_quat" objtype="site" objname="imu"/>
"""


@pytest.fixture
def toy_robot(tmp_path):
    """Builds the robot file's Robot; `joints` and `efforts` may be changed."""

    def build(
        joints: tuple[str, ...] = JOINTS, efforts: tuple[float, ...] = (9.0, 9.0, 9.0, 9.0)
    ) -> Robot:
        lines = [JOINT.format(name=n, effort=e) for n, e in zip(joints, efforts)]
        path = tmp_path / "toy.yaml"
        path.write_text(ROBOT.format(joints="\n".join(lines)))
        return load_robot(path)

    return build


@pytest.fixture
def toy_model(tmp_path):
    """Writes the model and returns its path."""

    def write(
        actuators: str = ACTUATORS,
        sensors: str = SENSORS,
        integrator: str = "implicitfast",
        base: str = "<freejoint/>",
        site: str = "",
        text: str = MODEL,
    ) -> Path:
        path = tmp_path / "toy.xml"
        model = text.format(
            actuators=actuators, sensors=sensors, integrator=integrator, base=base, site=site
        )
        if not base:  # the key frame is one of a floating base
            model = model.replace("1 2 3 1 0 0 0", "")
        path.write_text(model)
        return path

    return write


@pytest.fixture
def states_of():
    """Builds the standard states of a robot."""

    def build(robot: Any, num_robots: int | None = None) -> States:
        return States(standard_states(robot.joint_names), num_robots)

    return build


@pytest.fixture
def build(toy_robot, toy_model, states_of):
    """Builds the robot in MuJoCo, in a scene, with the states that it reads and writes."""

    def make_it(
        period: float = 0.01,
        num_robots: int | None = None,
        model: dict[str, Any] | None = None,
        **options: Any,
    ) -> tuple[MujocoPlatform, States]:
        from unicon_core.platforms.mujoco import make

        robot = toy_robot()
        states = states_of(robot, num_robots)
        return in_scene(
            make, states, robot, period, model=toy_model(**(model or {})), **options
        ), states

    return make_it
