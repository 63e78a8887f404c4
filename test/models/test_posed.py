"""A model put where states say: heights above the floor, feet, and the joint that floats."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from unicon_core.models.find import find_model
from unicon_core.models.load import load_model
from unicon_core.models.loaded import LoadedModel, free_joint
from unicon_core.models.posed import PosedModel, foot_geoms
from unicon_core.robots import load_robot

mujoco = pytest.importorskip("mujoco")

# Two floors, one of which does not touch the ball; a table that is not the robot's.
SCENE = """\
<mujoco>
  <worldbody>
    <geom name="deep" type="plane" size="0 0 1" pos="0 0 -1"/>
    <geom name="floor" type="plane" size="0 0 1"/>
    <geom name="glass" type="plane" size="0 0 1" pos="0 0 0.4" contype="0" conaffinity="0"/>
    <body name="table" pos="3 0 0.2"><freejoint/><geom size="0.1"/></body>
    <body name="base" pos="0 0 1">
      {base}
      <geom name="ball" size="0.1"/>
      <geom name="ghost" size="0.1" pos="0 0 -0.5" contype="0" conaffinity="0"/>
      <body name="leg" pos="0 0 -0.3"><joint name="knee" axis="0 1 0"/><geom name="FL" size="0.05"/>
        <body name="toe" pos="0 0 -0.2"><geom size="0.02"/><site name="sole"/></body>
      </body>
    </body>
  </worldbody>
</mujoco>
"""


def loaded(base="<freejoint/>"):
    model = mujoco.MjModel.from_xml_string(SCENE.format(base=base))
    return LoadedModel(model, Path("scene.xml"), [model.joint("knee").id])


def named(model, found):
    return {
        model.geom(i).name or model.body(model.geom_bodyid[i]).name: h for i, h in found.items()
    }


def test_heights_are_those_of_what_can_touch_the_nearest_floor():
    posed = PosedModel(loaded())
    posed.put([0.0], (0, 0, 2, 1, 0, 0, 0))
    found = named(posed.loaded.model, posed.heights())
    assert found == pytest.approx({"ball": 1.9, "FL": 1.65, "toe": 1.48})


def test_a_base_is_turned_and_joints_are_moved():
    posed = PosedModel(loaded())
    posed.put([0.0], (0, 0, 2, 0, 1, 0, 0))  # upside down
    assert named(posed.loaded.model, posed.heights())["toe"] == pytest.approx(2.48)
    posed.put([np.pi / 2])  # the base stays where it was put last
    assert named(posed.loaded.model, posed.heights())["toe"] == pytest.approx(2.28)


def test_a_fixed_base_stays_where_the_model_has_it():
    fixed = loaded(base="")
    assert fixed.base is None
    posed = PosedModel(fixed)
    posed.put([0.0], (0, 0, 7, 0, 1, 0, 0))
    assert named(fixed.model, posed.heights())["ball"] == pytest.approx(0.9)


def test_without_a_floor_there_are_no_heights():
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body><joint/><geom size='.1'/></body></worldbody></mujoco>"
    )
    posed = PosedModel(LoadedModel(model, Path("scene.xml"), [0]))
    posed.put([0.0])
    assert posed.heights() == {}


def test_feet_are_bodies_sites_geoms_or_their_stems():
    model = loaded().model
    found = foot_geoms(model, ("FL_foot", "toe", "sole", "nowhere"))
    toe = [int(model.body("toe").geomadr[0])]
    assert found == {"FL_foot": [model.geom("FL").id], "toe": toe, "sole": toe}


def test_the_free_joint_is_the_robots_own():
    model = loaded().model
    assert free_joint(model, 2) == 1


def test_key_poses_are_in_the_robots_order():
    robot = load_robot("go2")
    go2 = load_model(find_model("models/go2/go2.xml"), robot)
    np.testing.assert_allclose(go2.key_poses()["home"], robot.default_joint_pos, atol=1e-6)
