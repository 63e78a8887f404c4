"""An arm of three joints on a fixed base, with a model of its own: no assets are needed."""

from __future__ import annotations

import pytest

from unicon_core.robots import load_robot

ROBOT = """
schema: unicon.robot/1
name: reacher
description: An arm to test with
manufacturer: Nobody
kind: arm
models: {mjcf: reacher.xml}
base_frame: plate
joints:
  - {name: yaw, lower: -3.0, upper: 3.0, effort: 40.0, default: 0.3, FACTS}
  - {name: lift, lower: -2.0, upper: 2.0, effort: 40.0, default: -0.5, FACTS}
  - {name: elbow, lower: -2.5, upper: 2.5, effort: 3.0, default: 0.9, FACTS}
imu: null
groups: {arm: [yaw, lift, elbow], last: [elbow]}
end_effectors:
  tool: {body: forearm, position: [0.25, 0.0, 0.02], quat: [0.5, 0.5, 0.5, 0.5]}
transport: {protocol: fake, rate_hz: 500}
sources:
  joints: "made up"
  gains: "made up"
  default: "made up"
  rest: "made up"
  transport: "made up"
  end_effectors: "made up"
unknown: []
""".replace("FACTS", "velocity: 8.0, rest: 0.0, stiffness: 60.0, damping: 3.0")

MODEL = """
<mujoco>
  <worldbody>
    <body name="plate" pos="0.4 -0.1 0.6" euler="0 0 90">
      <geom type="box" size="0.05 0.05 0.05" mass="2"/>
      <body name="post" pos="0 0 0.1">
        <joint name="yaw" axis="0 0 1"/>
        <geom type="capsule" fromto="0 0 0 0 0 0.1" size="0.03" mass="1"/>
        <body name="upper_arm" pos="0 0 0.1">
          <joint name="lift" axis="0 1 0"/>
          <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.03" mass="1.5"/>
          <body name="forearm" pos="0.3 0 0">
            <joint name="elbow" axis="0 1 0"/>
            <geom type="capsule" fromto="0 0 0 0.25 0 0" size="0.025" mass="0.8"/>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


@pytest.fixture
def reacher(tmp_path):
    """The robot file beside its model."""
    (tmp_path / "reacher.xml").write_text(MODEL)
    path = tmp_path / "reacher.yaml"
    path.write_text(ROBOT)
    return load_robot(path)
