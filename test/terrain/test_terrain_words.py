"""What `scene.terrain` may say, and what it is told where it says something else."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from unicon_base.errors import PlatformError, UniconError
from unicon_base.schema.records import record_of
from unicon_base.schema.types import Number, OneOf
from unicon_core.platforms.kit.scene import Scene
from unicon_core.terrain.words import KINDS, Drawn, Kind, read_terrain
from unicon_core.workflow import Program, load_document

TEXT = (Path(__file__).resolve().parents[2] / "docs" / "howto" / "terrain.md").read_text("utf-8")
DRAWN = [kind for kind, figures in KINDS.items() if issubclass(figures, Drawn)]


class Figure(NamedTuple):
    default: Any
    least: float
    most: float
    unit: str
    whole: bool


def figures_of(kind: str) -> dict[str, Figure]:
    found = {}
    for name, field in record_of(KINDS[kind]).fields.items():
        number = getattr(field.type, "inner", field.type)
        if isinstance(number, OneOf):
            number = getattr(number.members[-1], "inner", number.members[-1])
        if name != "seed":
            assert isinstance(number, Number)
            bounds = number.bounds
            found[name] = Figure(field.default, bounds.low, bounds.high, number.unit, number.whole)
    return found


FIGURES = [(kind, name) for kind in KINDS for name in figures_of(kind)]


@pytest.mark.parametrize("said", ["flat", {"flat": None}, {"flat": {}}])
def test_flat_is_none(said: Any) -> None:
    assert read_terrain(said, 0) is None
    assert Scene(terrain=said).bodies == []


@pytest.mark.parametrize("kind", KINDS)
def test_a_word_alone_has_its_defaults(kind: str) -> None:
    terrain = read_terrain(kind, 5)
    assert terrain is not None
    assert terrain == read_terrain({kind: {}}, 5) == read_terrain({kind: None}, 5)
    assert terrain.figures == {n: f.default for n, f in figures_of(kind).items()}
    assert terrain.seed == 5
    assert Scene(terrain=kind).bodies == ["terrain"]


@pytest.mark.parametrize("kind", DRAWN)
def test_a_seed_of_its_own_goes_before_the_scenes(kind: str) -> None:
    terrain = read_terrain({kind: {"seed": 3}}, 5)
    assert terrain is not None
    assert terrain.seed == 3


def test_one_number_is_both_ends() -> None:
    terrain = read_terrain({"patches": {"friction": 0.5}}, 0)
    assert terrain is not None
    assert terrain["friction"] == (0.5, 0.5)


def wrong_values(figure: Figure) -> list[Any]:
    nan, inf = float("nan"), float("inf")
    wrong = [nan, inf, -inf, True, "much", [], {}, [1, 2, 3], figure.most * 1.01 + 1]
    wrong.append(figure.least - 0.01)
    if figure.whole:
        wrong.append(1.5)
    if isinstance(figure.default, tuple):
        wrong += [[figure.most, figure.least], [nan, nan]]
    else:
        wrong.append([figure.default, figure.default])
    return wrong


@pytest.mark.parametrize(("kind", "name"), FIGURES)
def test_a_wrong_figure_is_told_with_its_bounds_and_unit(kind: str, name: str) -> None:
    figure = figures_of(kind)[name]
    for value in wrong_values(figure):
        with pytest.raises(PlatformError) as error:
            Scene(terrain={kind: {name: value}})
        text = str(error.value)
        assert f"scene.terrain.{kind}.{name}" in text
        falls = value == [figure.most, figure.least]
        assert falls or f"{figure.least:g} to {figure.most:g}" in text
        assert falls or not figure.unit or text.endswith(f"[{figure.unit}]")


@pytest.mark.parametrize(
    ("said", "told"),
    [
        ("hills", "scene.terrain is 'hills'; known: flat, gaps, obstacles, patches, pyramid"),
        ("slop", "scene.terrain is 'slop'; did you mean 'slope'?"),
        ({"steps": {}}, "scene.terrain is 'steps'"),
        ({}, "scene.terrain names nothing; give one of flat, slope, stairs"),
        ({"rough": {}, "slope": {}}, "scene.terrain names rough and slope; give one of flat"),
        ({"flat": {"height": 1}}, "scene.terrain.flat has no figures; write terrain: flat"),
        ({"rough": 0.1}, "scene.terrain.rough is 0.1; write a mapping with extent"),
        ({"patches": [0.1]}, "scene.terrain.patches is [0.1]; write a mapping with"),
        (
            {"rough": {"heigth": 0.1}},
            "rough: unknown key 'heigth'; did you mean 'height'?",
        ),
        ({"stairs": {"seed": 1}}, "scene.terrain.stairs: unknown key 'seed'; known: extent, flat"),
        ({"stairs": {"rise": 5}}, "stairs.rise is 5; write a number from -0.5 to 0.5 [m]"),
        ({"stairs": {"steps": 2.5}}, "steps is 2.5; write a whole number from 1 to 1000"),
        ({"patches": {"friction": [1, 0]}}, "friction is [1.0, 0.0]; write [low, high]"),
        ({"rough": {"seed": -1}}, "scene.terrain.rough.seed is -1; write a whole number from 0"),
        ({"rough": {"seed": True}}, "scene.terrain.rough.seed is true; write a whole number"),
        (
            {"slope": {"flat": 8, "extent": 5}},
            "slope: flat is 8 m, and extent 5; give a larger extent",
        ),
        (
            {"rough": {"spacing": 0.02}},
            "scene.terrain.rough: an extent of 40 m with spacing 0.02 makes 4004001 points, at "
            "most 1000000; give a smaller extent or another spacing",
        ),
        ({"patches": {"size": 0.1}}, "size 0.1 makes 160000 patches, at most 5000"),
        ({"obstacles": {"density": 20}}, "density 20 makes 32000 obstacles, at most 5000"),
        ({"pyramid": {"run": 0.1, "extent": 200, "steps": 1000}}, "run 0.1 makes 4000 boxes"),
        ({"gaps": {"run": 0.05, "width": 0.0, "extent": 200}}, None),
    ],
)
def test_what_is_wrong_is_told(said: Any, told: str | None) -> None:
    if told is None or "makes 4000 boxes" in told:  # within the bound
        assert Scene(terrain=said).uneven is not None
        return
    with pytest.raises(PlatformError) as error:
        Scene(terrain=said)
    assert told in str(error.value)


def test_a_workflow_tells_it_too() -> None:
    pytest.importorskip("mujoco")
    with pytest.raises(UniconError, match=r"go2_stand.*: scene\.terrain\.rough\.height is -1"):
        Program(load_document("go2_stand", {"scene.terrain.rough.height": -1}))
    with pytest.raises(UniconError, match=r"scene\.terrain is 3; write a text or a mapping"):
        Program(load_document("go2_stand", {"scene.terrain": 3}))


def test_a_platform_that_has_flat_ground_alone_refuses() -> None:
    pytest.importorskip("pybullet")
    told = r"'pybullet' cannot be told scene\.terrain; take it out of scene, or choose platform: m"
    with pytest.raises(UniconError, match=told):
        Program(load_document("go2_stand", {"platform": "pybullet", "scene.terrain": "rough"}))
    Program(load_document("go2_stand", {"platform": "pybullet", "scene.terrain": "flat"})).close()


def test_the_document_has_every_kind_and_figure() -> None:
    row = r"^\| ((?:`\w+`(?:, )?)*) *\| `(\w+)` \| ([^|]*) \| ([^|]*) \|"
    told, kinds = {}, [""]
    for named, name, default, bounds in re.findall(row, TEXT, re.M):
        kinds = re.findall(r"\w+", named) or kinds
        told |= {(kind, name): (default.strip(), bounds.strip()) for kind in kinds}
    common = record_of(Kind).fields
    for each in KINDS:
        for name, figure in figures_of(each).items():
            if name in common:
                continue
            default = figure.default
            said = str(list(default)) if isinstance(default, tuple) else f"{default:g}"
            bounds = f"{figure.least:g} to {figure.most:g} {figure.unit}".strip()
            assert told[each, name] == (said, bounds)
    assert {kind for kind, _ in told} == {*KINDS, "all"}
    assert {name for kind, name in told if kind == "all"} == {"extent", "flat", "seed"}
