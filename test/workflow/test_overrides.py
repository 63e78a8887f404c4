"""`--set` reaches every value of every shipped workflow, and keys with dots in them."""

from __future__ import annotations

from collections.abc import Iterator
from copy import deepcopy
from pathlib import Path
from typing import Any

import pytest

from unicon_base.errors import WorkflowError
from unicon_base.located_yaml import read_yaml
from unicon_core.workflow import load_document, load_workflow, workflow_names
from unicon_core.workflow.document import set_value, split_setting
from unicon_core.workflow.members import read_platforms
from unicon_ros.cli.main import main

ROOT = Path(__file__).parents[2]
FILES = sorted([*ROOT.glob("config/*/*.yaml"), *ROOT.glob("examples/**/*.yaml")])
NEW = object()


def _values(here: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield the keys of every value below a document, inner ones too."""
    inner = enumerate(here) if isinstance(here, list) else here.items()
    for key, value in inner:
        yield (*path, key)
        if isinstance(value, (list, dict)):
            yield from _values(value, (*path, key))


def _at(here: Any, path: tuple[Any, ...]) -> Any:
    for key in path:
        here = here[key]
    return here


@pytest.mark.parametrize("path", FILES, ids=lambda path: f"{path.parent.name}-{path.stem}")
def test_every_value_of_every_file_is_reached_and_no_other(path: Path) -> None:
    document = read_yaml(path).value
    for keys in _values(document):
        values = deepcopy(document) if len(keys) > 1 else dict(document)
        dotted = ".".join(f'"{key}"' if "." in str(key) else str(key) for key in keys)
        for text in {dotted, dotted.replace('"', "")}:
            assert set_value(values, text, NEW) == ".".join(map(str, keys))
            assert _at(values, keys) is NEW
        parent = _at(values, keys[:-1])
        parent[keys[-1]] = _at(document, keys)
        assert values == document


@pytest.mark.parametrize(
    ("dotted", "after"),
    [
        ("given.action.scale", {"given": {"action.scale": 9}}),
        ("given.action.clip", {"given": {"action.scale": 1, "action": {"clip": 9}}}),
        ('given."action.clip"', {"given": {"action.scale": 1, "action.clip": 9}}),
        ("states.a.b.c.unit", {"states": {"a.b.c": {"unit": 9}}}),
        ("states.a.b.unit", {"states": {"a.b.c": {"unit": 1}, "a": {"b": {"unit": 9}}}}),
        ("safety.0.finite.x", {"safety": [{"finite": {"x": 9}}, {"limits": {"margin": 1}}]}),
        ("safety.1.limits.margin", {"safety": ["finite", {"limits": {"margin": 9}}]}),
        (
            "policies.walk.given.period",
            {"policies": {"walk": {"path": "p", "given": {"period": 9}}}},
        ),
        ("3.4", {3: {4: 9}}),
        ("nothing.x", {"nothing": {"x": 9}}),
        ('twice."a.b"', {"twice": {"a.b": 9, "a": {"b": 2}}}),
        ('twice."a"."b"', {"twice": {"a.b": 1, "a": {"b": 9}}}),
    ],
)
def test_path_means(dotted: str, after: dict[Any, Any]) -> None:
    before: dict[Any, Any] = {
        "given": {"action.scale": 1},
        "states": {"a.b.c": {"unit": 1}},
        "safety": ["finite", {"limits": {"margin": 1}}],
        "policies": {"walk": "p"},
        3: {4: 5},
        "nothing": None,
        "twice": {"a.b": 1, "a": {"b": 2}},
    }
    expected = deepcopy(before) | after
    set_value(before, dotted, 9)
    assert before == expected


@pytest.mark.parametrize(
    ("dotted", "message"),
    [
        ("a.b", '--set a.b may mean "a"."b" or "a.b"; write the one that is meant'),
        ("rate.x", "--set rate.x: rate is 50, which has no parts; set it whole: --set rate=VALUE"),
        (
            "safety.limits.margin",
            "--set safety.limits.margin: 'limits' is not a place in a list of 2; give a number "
            "from 0 to 1: 0 (finite), 1 (limits)",
        ),
        (
            "safety.0.margin",
            "--set safety.0.margin: safety.0 is 'finite', which has no parts; set it whole: "
            "--set safety.0=VALUE",
        ),
        (
            "empty.0",
            "--set empty.0: '0' is not a place in a list of 0; set the list: --set empty=[…]",
        ),
        (
            "platform.unitree.address",
            "--set platform.unitree.address: platform is 'mujoco', which has no parts; its "
            "options: --set platforms.unitree.address=9",
        ),
        (
            "platform.timestep",
            "--set platform.timestep: platform is 'mujoco', which has no parts; its options: "
            "--set platforms.mujoco.timestep=9",
        ),
    ],
)
def test_path_that_means_nothing_names_the_alternatives(dotted: str, message: str) -> None:
    safety = ["finite", {"limits": {"margin": 1}}]
    values: dict[str, Any] = {"a.b": 1, "a": {"b": 2}, "rate": 50, "safety": safety, "empty": []}
    values["platform"] = "mujoco"
    before = deepcopy(values)
    with pytest.raises(WorkflowError) as caught:
        set_value(values, dotted, 9)
    assert str(caught.value) == message
    assert values == before


def test_path_in_quotes_may_hold_an_equals_sign() -> None:
    assert split_setting('a."x=y".b=3=4') == ('a."x=y".b', "3=4")
    assert split_setting("description=it's") == ("description", "it's")


def test_value_behind_a_dotted_key_is_told_as_set(tmp_path: Path) -> None:
    path = tmp_path / "w.yaml"
    path.write_text(
        "robot: go2\nplatform: fake\nrate: 50\npolicies:\n  walk:\n    path: go2_velocity\n"
        "    given: {observation.history: 1}\nflow: {policy: walk}\n",
        "utf-8",
    )
    document = load_document(path, ["policies.walk.given.observation.history=2"])
    assert document.values["policies"]["walk"]["given"] == {"observation.history": 2}
    assert document.where("policies", "walk", "given", "observation.history").startswith("--set ")


@pytest.mark.parametrize(
    ("setting", "told"),
    [
        (
            "policies.wlak.given.period=1",
            "policies.wlak: did you mean 'walk'? known: walk",
        ),
        (
            "policies.walk.gven.period=1",
            "--set policies.walk.gven.period: policies.walk: unknown key 'gven'; did you mean "
            "'given'? known: child, given, path",
        ),
        ("policies.walk.given.period=0.03", "policy.yaml says period is 0.02 and given says 0.03"),
    ],
)
def test_run_refuses_what_is_set_wrong(
    capsys: pytest.CaptureFixture[str], setting: str, told: str
) -> None:
    assert "go2_walk" in workflow_names()
    assert main(["run", "go2_walk", "--set", "platform=fake", "--set", setting]) == 1
    assert told in capsys.readouterr().err


def test_options_below_the_platforms_name_are_told_where_they_stand(tmp_path: Path) -> None:
    path = tmp_path / "w.yaml"
    path.write_text("robot: go2\nplatform: unitree\nrate: 50\nflow: damp\n", "utf-8")
    document = load_document(path, ["platform.unitree.address=lo"])
    with pytest.raises(WorkflowError, match=r"or --set platforms\.unitree\.address=VALUE"):
        read_platforms(document)


@pytest.mark.parametrize("setting", ["scene.payload.masss=1", "scene.joints.*_knee.damping=1"])
def test_an_option_that_was_set_is_named_and_not_the_line_that_lacks_it(setting: str) -> None:
    with pytest.raises(WorkflowError) as caught:
        load_workflow("go2_walk", [setting])
    assert str(caught.value).startswith(f"--set {setting.partition('=')[0]}: scene.")
