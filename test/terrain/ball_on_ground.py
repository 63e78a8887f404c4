"""Ground under a ball, for tests that look at the ground alone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from unicon_core.models.loaded import LoadedModel
from unicon_core.models.terrain import laying
from unicon_core.terrain.ground import ground_of
from unicon_core.terrain.words import read_terrain

BALL = """\
<mujoco>
  <worldbody>
    {open}
    <geom name="floor" type="plane" size="0 0 1" pos="0 0 {height}" friction="0.8 0.01 0.001"/>
    {close}
    {around}
    <body name="ball" pos="0 0 0.5"><freejoint/>
      <geom name="ball" size="0.1" mass="1" condim="4" friction="0.5 0.02 0.001" {geom}/>
      <body name="lid"><joint name="lid"/>
        <geom size="0.02" pos="0 0 0.05" contype="0" conaffinity="0"/>
      </body>
    </body>
  </worldbody>
  {more}
</mujoco>
"""
NOTHING = {"open": "", "close": "", "around": "", "geom": "", "more": ""}


def laid(said: Any, height: float = 0.0, **text: str) -> Any:
    """Return the compiled model of a ball on ground whose floor was at a height in [m]."""
    mujoco = pytest.importorskip("mujoco")
    xml = BALL.format(height=height, **{**NOTHING, **text})
    model = mujoco.MjModel.from_xml_string(xml)
    terrain = read_terrain(said, 0)
    assert terrain is not None
    joints = [i for i in range(model.njnt) if model.joint(i).name == "lid"]
    lay = laying(LoadedModel(model, Path("ball.xml"), joints), ground_of(terrain))
    spec = mujoco.MjSpec.from_string(xml)
    lay(spec)
    return spec.compile()
