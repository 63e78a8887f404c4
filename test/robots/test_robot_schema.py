"""The JSON Schema for editors agrees with the validator, as far as a schema can see."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import yaml
from json_schema_reference import accepts

from unicon_core.robots.checks import IMU_KEYS
from unicon_core.robots.joint_physics import JOINT_PHYSICS
from unicon_core.robots.robot import JOINT_FIELDS
from unicon_core.robots.transport_checks import COMMANDS
from unicon_core.robots.validate import _OPTIONAL, _OVERLAY, _REQUIRED, KINDS, SCHEMA

HERE = Path(__file__).parent
ROBOTS = HERE.parents[1] / "config" / "robots"
ROBOT_SCHEMA: dict[str, Any] = json.loads((ROBOTS / "robot.schema.json").read_text("utf-8"))
WHEELED = HERE.parents[1] / "examples" / "rover" / "rover.yaml"
GOOD = [*sorted(ROBOTS.glob("*.yaml")), WHEELED]
BAD = sorted((HERE / "bad").glob("*.yaml"))

# Broken in a way that YAML itself refuses, or that takes arithmetic or a comparison of two places.
NOT_YAML = {"broken_yaml", "tab_indent", "python_object"}
NOT_JSON = {"simulated_friction_is_nan"}
BEYOND_A_SCHEMA = {
    "end_effector_turned",
    "default_outside",
    "feet_empty_not_in_unknown",
    "group_of_no_joint",
    "hand_without_fingers",
    "palm_turned",
    "imu_null_not_in_unknown",
    "joint_twice",
    "key_twice",
    "lower_above_upper",
    "model_leads_out",
    "model_of_another_format",
    "name_differs",
    "no_source_for_gains",
    "overlay_of_itself",
    "null_not_in_unknown",
    "quat_not_unit",
    "rest_outside",
    "simulated_joint_unknown",
    "transport_null_not_in_unknown",
    "unknown_but_given",
    "unknown_misspelt",
}


def _document(path: Path) -> Any:
    return yaml.safe_load(path.read_text("utf-8"))


@pytest.mark.parametrize("path", GOOD, ids=lambda path: path.stem)
def test_schema_accepts_every_robot_file(path: Path) -> None:
    assert accepts(ROBOT_SCHEMA, _document(path), ROBOT_SCHEMA)


@pytest.mark.parametrize(
    "path", [p for p in BAD if p.stem not in NOT_YAML], ids=lambda path: path.stem
)
def test_schema_refuses_what_the_validator_refuses(path: Path) -> None:
    expected = path.stem in BEYOND_A_SCHEMA
    assert accepts(ROBOT_SCHEMA, _document(path), ROBOT_SCHEMA) is expected


def test_schema_accepts_overlays_and_what_the_weak_calf_is_told() -> None:
    weak = _document(HERE.parents[1] / "examples" / "weak_calf.yaml")["scene"]["joints"]
    overlay = {"schema": SCHEMA, "extends": "go2", "simulated": weak}
    assert accepts(ROBOT_SCHEMA, overlay, ROBOT_SCHEMA)
    assert accepts(
        ROBOT_SCHEMA, {**overlay, "description": "Weak.", "simulated": None}, ROBOT_SCHEMA
    )
    for wrong in (
        {"simulated": {"RL_calf_joint": {"strong": 0.3}}},
        {"simulated": {"RL_calf_joint": {"strength": -1}}},
        {"extends": ""},
        {"joints": []},
        {"schema": "unicon.robot/2"},
    ):
        assert not accepts(ROBOT_SCHEMA, overlay | wrong, ROBOT_SCHEMA), wrong
    assert not accepts(ROBOT_SCHEMA, {"schema": SCHEMA, "extends": "go2"}, ROBOT_SCHEMA)


def test_exceptions_exist() -> None:
    assert {p.stem for p in BAD} >= NOT_YAML | NOT_JSON | BEYOND_A_SCHEMA


def test_schema_and_validator_know_the_same_words() -> None:
    defs = ROBOT_SCHEMA["$defs"]
    properties = defs["robot"]["properties"]
    assert set(properties) == {*_REQUIRED, *_OPTIONAL}
    assert set(defs["robot"]["required"]) == set(_REQUIRED)
    assert tuple(defs["overlay"]["required"]) == _OVERLAY
    assert set(defs["overlay"]["properties"]) == {*_OVERLAY, "description"}
    figures = defs["simulated"]["additionalProperties"]["properties"]
    assert {word: each["maximum"] for word, each in figures.items()} == {
        word: largest for word, (largest, _, _) in JOINT_PHYSICS.items()
    }
    assert tuple(properties["kind"]["enum"]) == KINDS
    assert properties["schema"]["const"] == SCHEMA
    assert tuple(properties["transport"]["properties"]["command"]["enum"]) == COMMANDS
    assert tuple(defs["joint"]["required"]) == ("name", *JOINT_FIELDS)
    assert set(defs["joint"]["properties"]) == {"name", *JOINT_FIELDS}
    assert set(defs["imu"]["properties"]) == set(IMU_KEYS)


def test_reference_agrees_with_the_jsonschema_package() -> None:
    jsonschema = pytest.importorskip("jsonschema", reason="package jsonschema is not installed")
    jsonschema.Draft202012Validator.check_schema(ROBOT_SCHEMA)
    validator = jsonschema.Draft202012Validator(ROBOT_SCHEMA)
    for path in GOOD + [p for p in BAD if p.stem not in NOT_YAML | NOT_JSON]:
        document = _document(path)
        assert validator.is_valid(document) == accepts(ROBOT_SCHEMA, document, ROBOT_SCHEMA), path
