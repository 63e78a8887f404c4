"""The JSON Schemas of documents: shipped files fit, what loaders refuse they refuse, too."""

from __future__ import annotations

import copy
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jsonschema
import pytest
import yaml

from unicon_base.errors import PolicyError, UniconError
from unicon_base.located_yaml import read_yaml
from unicon_core.policies.file import build_contract
from unicon_core.policies.policy_yaml import policy_yaml_facts
from unicon_core.robots import load_robot
from unicon_core.workflow import load_document
from unicon_lab.sweep.sweep_file import read_sweep
from unicon_msgs_map import load_map
from unicon_ros.cli.check import KINDS, schema_of
from unicon_ros.cli.main import main

ROOT = Path(__file__).resolve().parents[2]
LOADS: dict[str, Any] = {
    "workflow": load_document,
    "robot": load_robot,
    "sweep": read_sweep,
    "map": load_map,
    "policy": lambda path: build_contract(policy_yaml_facts(read_yaml(path, PolicyError))),
}
FILES = {
    "workflow": sorted((ROOT / "config" / "workflows").glob("*.yaml")),
    "robot": sorted((ROOT / "config" / "robots").glob("*.yaml")),
    "policy": sorted((ROOT / "config" / "policies").rglob("policy.yaml")),
    "map": sorted((ROOT / "config" / "maps").glob("*.yaml"), key=lambda path: path.stat().st_size),
    "sweep": [
        path
        for path in sorted((ROOT / "examples").rglob("*.yaml"))
        if "unicon.sweep/1" in path.read_text("utf-8")
    ],
}


@pytest.fixture(scope="module")
def validators() -> dict[str, Any]:
    return {kind: jsonschema.Draft202012Validator(schema_of(kind)) for kind in KINDS}


@pytest.mark.parametrize("kind", KINDS)
def test_a_schema_is_one_and_the_file_that_editors_use_is_this_one(
    kind: str, validators: dict[str, Any]
) -> None:
    jsonschema.Draft202012Validator.check_schema(validators[kind].schema)
    shipped = ROOT / "config" / "schemas" / f"{kind}.json"
    assert json.loads(shipped.read_text("utf-8")) == validators[kind].schema, (
        "run: unicon schema --out config/schemas"
    )


@pytest.mark.parametrize(("kind", "path"), [(kind, path) for kind in FILES for path in FILES[kind]])
def test_every_shipped_file_fits(kind: str, path: Path, validators: dict[str, Any]) -> None:
    document = read_yaml(path).value
    assert [error.message for error in validators[kind].iter_errors(document)] == []


def mutated(document: dict[str, Any], required: list[str]) -> Iterator[tuple[str, dict[str, Any]]]:
    for key in required:
        yield f"without {key}", {k: v for k, v in document.items() if k != key}
    for key, value in document.items():
        if isinstance(value, (int, float)) and not isinstance(value, bool):
            yield f"{key} is a text", document | {key: "fast"}
        if isinstance(value, list):
            yield f"{key} is a flag", document | {key: False}
    yield "an unknown key", document | {"robott": "go2"}
    yield "another version", document | {"schema": "unicon.nothing/9"}


@pytest.mark.parametrize("kind", KINDS)
def test_what_the_schema_refuses_the_loader_refuses_and_the_reverse(
    kind: str, validators: dict[str, Any], tmp_path: Path
) -> None:
    source = FILES[kind][-1]
    document = read_yaml(source).value
    definition = validators[kind].schema
    reference = definition.get("$ref") or definition["anyOf"][0]["$ref"]
    required = definition["$defs"][reference.rpartition("/")[2]].get("required", [])
    count = 0
    for what, broken in mutated(copy.deepcopy(document), required):
        path = tmp_path / source.name
        path.write_text(yaml.safe_dump(broken, sort_keys=False), "utf-8")
        assert not validators[kind].is_valid(broken), what
        with pytest.raises(UniconError):
            LOADS[kind](path)
        count += 1
    assert count >= 4


def test_blocks_and_platforms_are_completed_with_their_options(validators: dict[str, Any]) -> None:
    definitions = validators["workflow"].schema["$defs"]
    words, mapping, _ = definitions["Flow"]["anyOf"]
    assert {"hold", "policy", "tilt_stop"} <= set(words["enum"])
    (options, *_) = mapping["properties"]["tilt_stop"]["anyOf"]
    assert "[rad]" in options["properties"]["angle"]["description"]
    base = {"robot": "go2", "platform": "fake", "flow": "hold"}
    fits = validators["workflow"].is_valid
    assert fits(base)
    assert not fits(base | {"flow": "holdd"})
    assert not fits(base | {"flow": {"pose": {"tow": "rest"}}})
    assert not fits(base | {"platform": "mujocoo"})
    assert not fits(base | {"scene": {"gravity": 0}})


@pytest.mark.parametrize(
    "line",
    [
        "skills: {a: {do: hold, next: [1]}}",
        "platforms: 3",
        "platforms: {fake: 3}",
        "policies: {1: {}}",
        "parts: {1: null, b: null}",
        "start: {together: {robots: null, me: [a]}}",
    ],
)
def test_nonsense_is_refused_where_it_stands(line: str, tmp_path: Path) -> None:
    path = tmp_path / "w.yaml"
    path.write_text(f"robot: go2\nplatform: fake\nrate: 50\nflow: hold\n{line}\n")
    with pytest.raises(UniconError, match=r"w\.yaml:5: "):
        load_document(path)


def test_the_command_prints_and_writes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["schema", "robot"]) == 0
    assert json.loads(capsys.readouterr().out) == schema_of("robot")
    assert main(["schema", "--out", str(tmp_path / "new")]) == 0
    assert {path.stem for path in (tmp_path / "new").iterdir()} == set(KINDS)
    assert main(["schema", "robott"]) == 1
    assert "did you mean 'robot'?" in capsys.readouterr().err
    assert main(["schema"]) == 1
    (tmp_path / "file").write_text("")
    assert main(["schema", "--out", str(tmp_path / "file")]) == 1
