"""The JSON Schema for editors agrees with the validator, as far as a schema can see."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import jsonschema
import pytest
import yaml

from unicon_base.schema.read import json_schema
from unicon_core.robots.file import SCHEMA, Overlay, RobotFile

HERE = Path(__file__).parent
ROBOTS = HERE.parents[1] / "config" / "robots"
SCHEMA_OF_ROBOTS = jsonschema.Draft202012Validator(json_schema(RobotFile, Overlay))
WHEELED = HERE.parents[1] / "examples" / "rover" / "rover.yaml"
GOOD = [*sorted(ROBOTS.glob("*.yaml")), WHEELED]
BAD = sorted((HERE / "bad").glob("*.yaml"))

# Broken in a way that YAML itself refuses, or that takes arithmetic or a comparison of two places.
NOT_YAML = {"broken_yaml", "tab_indent", "python_object"}
NOT_JSON = {"simulated_friction_is_nan"}
BEYOND_A_SCHEMA = {
    "foot_twice",
    "hand_of_a_leg",
    "hand_with_feet",
    "hand_without_source",
    "missing_feet",
    "missing_joint_key",
    "no_source_for_command_ranges",
    "no_source_for_imu",
    "simulated_friction_is_nan",
    "unknown_twice",
    "end_effector_turned",
    "default_outside",
    "feet_empty_not_in_unknown",
    "group_of_no_joint",
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


def accepts(document: Any) -> bool:
    """Return whether the schema for editors accepts a document."""
    return SCHEMA_OF_ROBOTS.is_valid(document)


def _document(path: Path) -> Any:
    return yaml.safe_load(path.read_text("utf-8"))


@pytest.mark.parametrize("path", GOOD, ids=lambda path: path.stem)
def test_schema_accepts_every_robot_file(path: Path) -> None:
    assert accepts(_document(path))


@pytest.mark.parametrize(
    "path", [p for p in BAD if p.stem not in NOT_YAML], ids=lambda path: path.stem
)
def test_schema_refuses_what_the_validator_refuses(path: Path) -> None:
    expected = path.stem in BEYOND_A_SCHEMA
    assert accepts(_document(path)) is expected


def test_schema_accepts_overlays_and_what_the_weak_calf_is_told() -> None:
    weak = _document(HERE.parents[1] / "examples" / "weak_calf.yaml")["scene"]["joints"]
    overlay = {"schema": SCHEMA, "extends": "go2", "simulated": weak}
    assert accepts(overlay)
    assert accepts({**overlay, "description": "Weak."})
    for wrong in (
        {"simulated": {"RL_calf_joint": {"strong": 0.3}}},
        {"simulated": {"RL_calf_joint": {"strength": -1}}},
        {"extends": ""},
        {"joints": []},
        {"schema": "unicon.robot/2"},
    ):
        assert not accepts(overlay | wrong), wrong
    assert not accepts({"schema": SCHEMA, "extends": "go2"})


def test_exceptions_exist() -> None:
    assert {p.stem for p in BAD} >= NOT_YAML | NOT_JSON | BEYOND_A_SCHEMA


def test_the_schema_is_one_itself() -> None:
    jsonschema.Draft202012Validator.check_schema(SCHEMA_OF_ROBOTS.schema)
