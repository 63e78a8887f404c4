"""Feet that touch by `<pair>` count like those that touch by their bits; floors by any name."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest

from unicon_base.errors import CheckError, ModelError
from unicon_core.check import check_workflow
from unicon_core.check.check import refuse_errors
from unicon_core.models.feet import Feet
from unicon_core.models.load import load_model
from unicon_core.models.loaded import floors, may_touch, on_floor, solid
from unicon_core.models.posed import Footprint, PosedModel
from unicon_core.robots import load_robot
from unicon_core.workflow import Program
from unicon_core.workflow.document import load_document

mujoco = pytest.importorskip("mujoco")

MODEL = Path(__file__).resolve().parents[2] / "config" / "models" / "go2" / "go2.xml"
FEET = ("FR", "FL", "RR", "RL")
FLOOR = '<geom name="floor" type="plane"'
MESH = '<asset><mesh name="skin" file="skin.stl"/></asset>'


def go2(folder, *, pairs="floor", floor=True, bits=False):
    """Write our Go2 with feet that touch by pairs, other geoms by nothing; return the file."""
    text = MODEL.read_text(encoding="utf-8")
    if not bits:
        text = text.replace('contype="0" conaffinity="1"', 'contype="0" conaffinity="0"')
    if not floor:
        start = text.index(FLOOR)
        text = text[:start] + text[text.index("/>", start) + 2 :]
    if pairs is not None:
        named = "".join(f'<pair geom1="{pairs}" geom2="{foot}"/>' for foot in FEET)
        text = text.replace("</mujoco>", f"<contact>{named}</contact></mujoco>")
    path = folder / "go2.xml"
    path.write_text(text, encoding="utf-8")
    return path


def load(path):
    return load_model(path, load_robot("go2"))


def names(loaded, geoms):
    return {loaded.model.geom(geom).name for geom in geoms}


def test_geoms_touch_by_a_pair_that_names_both(tmp_path):
    model = load(go2(tmp_path)).model
    floor, foot, other = (model.geom(name).id for name in ("floor", "FR", "FL"))
    assert may_touch(model, floor, foot)
    assert may_touch(model, foot, floor)
    assert not may_touch(model, foot, other)
    assert solid(model, foot)
    assert not solid(model, int(model.body("base_link").geomadr[0]))


def test_feet_by_pairs_are_as_high_as_by_bits(tmp_path):
    paired = load(go2(tmp_path))
    plain = load(MODEL)
    assert names(paired, on_floor(paired)) == {*FEET}
    pose = load_robot("go2").default_joint_pos
    heights = []
    for loaded in (paired, plain):
        posed = PosedModel(loaded)
        posed.put(pose, (0, 0, 1, 1, 0, 0, 0))
        found = posed.heights()
        heights.append([found[loaded.model.geom(foot).id] for foot in FEET])
    assert heights[0] == pytest.approx(heights[1])


def test_odometry_and_footprint_take_the_feet_that_pairs_name(tmp_path):
    robot = load_robot("go2")
    pose = robot.default_joint_pos
    upright = np.array((1.0, 0.0, 0.0, 0.0))
    found = []
    for path in (go2(tmp_path), MODEL):
        loaded = load(path)
        print_ = Footprint.of(loaded, robot, pose, upright)
        assert print_ is not None
        print_.update()
        found.append((Feet(loaded, robot)._radius, print_.position.copy()))
    np.testing.assert_array_equal(found[0][0], found[1][0])
    np.testing.assert_allclose(found[0][1], found[1][1])


@pytest.mark.parametrize("called", ["floor", "ground", "arena/plane"])
def test_a_floor_is_added_by_the_name_that_pairs_give_it(called, tmp_path):
    loaded = load(go2(tmp_path, pairs=called, floor=False))
    assert loaded.model.geom(called).type == int(mujoco.mjtGeom.mjGEOM_PLANE)
    assert names(loaded, on_floor(loaded)) == {*FEET}
    assert "the model has no surroundings: a floor was added" in loaded.notes


def in_body(path, floor=FLOOR):
    """Put the floor into a body that stands still, as Open Duck's scenes do."""
    text = path.read_text(encoding="utf-8")
    end = text.index("/>", start := text.index(FLOOR)) + 2
    own = f'<body name="floor" pos="0 0 0.1">{floor}{text[start + len(FLOOR) : end]}</body>'
    path.write_text(text[:start] + own + text[end:], encoding="utf-8")
    return path


@pytest.mark.parametrize("pairs", [None, "floor", "ground"])
def test_a_floor_in_a_body_that_stands_still_is_the_floor(pairs, tmp_path):
    loaded = load(in_body(go2(tmp_path, pairs=pairs, bits=pairs is None)))
    assert [loaded.model.geom(floor).name for floor in floors(loaded.model)] == ["floor"]
    assert {*FEET} <= names(loaded, on_floor(loaded))
    posed = PosedModel(loaded)
    posed.put(load_robot("go2").default_joint_pos, (0, 0, 1, 1, 0, 0, 0))
    plain = PosedModel(load(MODEL))
    plain.put(load_robot("go2").default_joint_pos, (0, 0, 0.9, 1, 0, 0, 0))
    assert min(posed.heights().values()) == pytest.approx(min(plain.heights().values()))


def test_a_field_of_heights_in_a_body_that_stands_still_is_the_floor(tmp_path):
    path = in_body(go2(tmp_path, pairs="ground"), '<geom name="floor" hfield="f" type="hfield"')
    field = '<asset><hfield name="f" nrow="2" ncol="2" size="5 5 1 1" elevation="0 0 0 0"/></asset>'
    text = path.read_text().replace("<worldbody>", f"{field}<worldbody>", 1)
    path.write_text(text, encoding="utf-8")
    loaded = load(path)
    assert not floors(loaded.model)
    foot = loaded.model.geom("FL").id
    assert may_touch(loaded.model, loaded.model.geom("floor").id, foot)


def test_a_floor_is_added_by_a_name_that_is_free(tmp_path):
    path = go2(tmp_path, pairs=None, floor=False, bits=True)
    text = path.read_text().replace('<geom name="FR"', '<geom name="floor"')
    path.write_text(text, encoding="utf-8")
    loaded = load(path)
    assert [loaded.model.geom(floor).name for floor in floors(loaded.model)] == ["floor_"]


def test_pairs_that_name_another_floor_take_the_one_that_is_there(tmp_path):
    loaded = load(go2(tmp_path, pairs="ground"))
    assert names(loaded, on_floor(loaded)) == {*FEET}
    assert "4 pairs name ground, which is not in the model: taken as its floor" in loaded.notes


def test_a_pair_of_two_that_are_not_there_is_the_files_mistake(tmp_path):
    path = go2(tmp_path, pairs="ground")
    path.write_text(path.read_text().replace('geom2="FR"', 'geom2="FX"'), encoding="utf-8")
    with pytest.raises(ModelError, match="geom 'ground' not found"):
        load(path)


def test_pairs_of_absent_meshes_go_with_them(tmp_path):
    path = go2(tmp_path)
    text = path.read_text().replace("<worldbody>", f"{MESH}<worldbody>", 1)
    text = text.replace(
        '<geom name="FR" class="foot"/>', '<geom name="FR" type="mesh" mesh="skin"/>'
    )
    path.write_text(text, encoding="utf-8")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        loaded = load(path)
    assert names(loaded, on_floor(loaded)) == {*FEET} - {"FR"}
    assert "1 geoms left out, 1 of them may collide" in loaded.absent[loaded.path]
    assert list(loaded.absent_shapes.values()) == [["skin.stl"]]


@pytest.mark.parametrize("robot", ["h1", "h1_2"])
def test_feet_whose_meshes_are_all_absent_are_an_error_that_names_them(robot, assets):
    changes = [f"robot={robot}", "check.accept=[]"]
    (found,) = check_workflow("h1_stand", changes).findings
    assert found.code == "model.collision"
    assert "do not collide with the floor" in found.evidence
    for foot in load_robot(robot).feet:
        assert f"{foot}.STL" in found.evidence
    with pytest.raises(CheckError, match=r"model\.collision"):
        refuse_errors(Program(load_document("h1_stand", changes)))


def checked(path, *, twin=False, platform="mujoco"):
    changes = [f"scene.model={path}", "check.duration=1", f"platform={platform}"]
    return check_workflow("go2_walk", changes, twin=twin)


def test_a_robot_on_paired_feet_walks_and_is_clean(tmp_path):
    pytest.importorskip("onnxruntime")
    result = checked(go2(tmp_path), twin=True)
    assert result.clean, result.text()


def test_feet_that_touch_nothing_are_told_first(tmp_path):
    pytest.importorskip("onnxruntime")
    result = checked(go2(tmp_path, pairs=None))
    assert result.findings[0].code == "model.collision"
    assert "nothing of the robot collides with the floor" in result.findings[0].evidence


def test_feet_that_alone_touch_nothing_are_told(tmp_path):
    pytest.importorskip("onnxruntime")
    path = go2(tmp_path, pairs=None, bits=True)
    text = path.read_text()
    for foot in FEET:
        old = f'name="{foot}" class="foot"'
        text = text.replace(old, f'{old} conaffinity="0"')
    path.write_text(text, encoding="utf-8")
    first = checked(path).findings[0]
    assert first.code == "model.collision"
    assert "its feet (FR_foot, FL_foot, RR_foot, RL_foot) do not collide" in first.evidence


@pytest.mark.slow
def test_the_twin_tells_what_its_own_model_lacks(tmp_path):
    pytest.importorskip("onnxruntime")
    result = checked(go2(tmp_path, pairs=None), twin=True, platform="fake")
    assert result.findings[0].code == "model.collision", result.text()
    assert "collision geometry" in result.findings[0].culprit


def test_absent_meshes_are_a_note_that_every_start_tells(tmp_path):
    pytest.importorskip("onnxruntime")
    path = go2(tmp_path, bits=True, pairs=None)
    geom = '<geom type="mesh" mesh="skin" contype="0" conaffinity="0"/>'
    text = path.read_text().replace("<worldbody>", f"{MESH}<worldbody>", 1)
    text = text.replace('<geom name="FR" class="foot"/>', f'<geom name="FR" class="foot"/>{geom}')
    path.write_text(text, encoding="utf-8")
    result = checked(path)
    assert result.clean, result.text()
    (note,) = [note for note in result.notes if note.code == "model.meshes"]
    assert "1 mesh files are absent (first: skin.stl)" in note.evidence
    changes = [f"scene.model={path}", "duration=0.1"]
    told = refuse_errors(Program(load_document("go2_walk", changes)))
    assert any("1 mesh files are absent (first: skin.stl)" in line for line in told)
