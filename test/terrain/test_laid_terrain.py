"""Ground beside the floor of a model: contacts stay what they were, other surroundings are told."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from ball_on_ground import laid

from unicon_base.errors import ModelError

mujoco = pytest.importorskip("mujoco")

FAR = {"extent": 10.0}
PAIR = '<contact><pair geom1="ball" geom2="floor" friction="0.3 0.3 0.01 0.002 0.002"/></contact>'


def contact(model: Any, x: float, y: float, z: float) -> Any:
    """Return a contact of the ball where it is put."""
    data = mujoco.MjData(model)
    data.qpos[:3] = x, y, z + 0.099
    mujoco.mj_forward(model, data)
    assert len(data.contact)
    first = data.contact[0]  # memory of `data`
    arrays = {word: np.array(getattr(first, word)) for word in ("friction", "solref", "solimp")}
    return SimpleNamespace(dim=int(first.dim), **arrays)


def test_a_step_touches_as_the_floor_did() -> None:
    model = laid({"stairs": FAR})
    floor, step = contact(model, 0.0, 0.0, 0.0), contact(model, 1.15, 0.0, 0.1)
    for word in ("friction", "solref", "solimp", "dim"):
        assert np.array_equal(getattr(floor, word), getattr(step, word)), word


def test_a_patch_has_its_factor_of_what_the_floor_had() -> None:
    model = laid({"patches": {"friction": 0.25, **FAR}})
    start, patch = contact(model, 0.0, 0.0, 0.0), contact(model, 3.5, 0.5, 0.0)
    assert start.friction == pytest.approx([0.8, 0.8, 0.02, 0.001, 0.001])
    assert patch.friction == pytest.approx(0.25 * start.friction)
    assert (patch.dim, start.dim) == (4, 4)


def test_a_patch_goes_before_a_foot_that_goes_before_the_floor() -> None:
    model = laid({"patches": {"friction": 0.25, **FAR}}, geom='priority="1"')
    start, patch = contact(model, 0.0, 0.0, 0.0), contact(model, 3.5, 0.5, 0.0)
    assert start.friction == pytest.approx([0.5, 0.5, 0.02, 0.001, 0.001])
    assert patch.friction == pytest.approx(0.25 * start.friction)


def test_pairs_of_the_floor_are_pairs_of_other_ground() -> None:
    bits = 'contype="0" conaffinity="0"'
    for said, factor in (("stairs", 1.0), ("patches", 0.5)):
        figures = FAR if said == "stairs" else {"friction": 0.5, **FAR}
        model = laid({said: figures}, geom=bits, more=PAIR)
        found = contact(model, 1.15, 0.0, 0.1 if said == "stairs" else 0.0)
        assert found.friction[:3] == pytest.approx(np.array([0.3, 0.3, 0.01]) * factor)


@pytest.mark.parametrize(
    ("around", "told"),
    [
        ('<geom name="wall" type="box" size="1 1 1" pos="5 0 0"/>', r"of its own \(wall\): scene"),
        ('<body><geom type="box" size="1 1 1" pos="5 0 0"/></body>', r"of its own \(geom \d\)"),
        ('<geom type="plane" size="1 1 1" pos="5 0 0" zaxis="-1 0 0"/>', "has 2 planes"),
    ],
)
def test_other_surroundings_are_told(around: str, told: str) -> None:
    with pytest.raises(ModelError, match=told):
        laid({"stairs": FAR}, around=around)


def test_ground_lies_on_a_floor_that_a_body_has_which_stands_still() -> None:
    model = laid({"rough": FAR}, height=0.5, open='<body pos="1 2 -0.2">', close="</body>")
    plain = laid({"rough": FAR}, height=0.3)
    data, other = mujoco.MjData(model), mujoco.MjData(plain)
    for one, made in ((model, data), (plain, other)):
        mujoco.mj_kinematics(one, made)
    assert data.geom("floor").xpos[2] == pytest.approx(other.geom("floor").xpos[2])
    assert data.geom("floor").xpos[2] < 0.3
    np.testing.assert_allclose(data.geom("terrain_0").xpos, other.geom("terrain_0").xpos)


def test_a_floor_in_a_body_that_is_not_level_is_told() -> None:
    with pytest.raises(ModelError, match="needs one level floor"):
        laid({"rough": FAR}, open='<body euler="10 0 0">', close="</body>")


def test_what_touches_nothing_is_no_surrounding() -> None:
    look = '<geom type="box" size="1 1 1" pos="5 0 0" contype="0" conaffinity="0"/>'
    assert laid({"stairs": FAR}, around=look).ngeom > 5


def test_a_great_many_pairs_are_told() -> None:
    pairs = "".join(f'<pair name="p{i}" geom1="ball" geom2="floor"/>' for i in range(10))
    with pytest.raises(ModelError, match=r"its floor in 10 pairs, and scene\.terrain has 4"):
        laid({"patches": {"size": 0.6}}, more=f"<contact>{pairs}</contact>")
