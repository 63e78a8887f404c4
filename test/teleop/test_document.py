"""docs/howto/teleoperation.md: its examples build, and it names all options and states."""

from __future__ import annotations

import inspect
import re
from pathlib import Path

import pytest
import yaml

from unicon_core.workflow.autowire import option_names
from unicon_core.workflow.document import load_document
from unicon_manipulation.teleop.teleop import Teleop

ROOT = Path(__file__).resolve().parents[2]
TEXT = (ROOT / "docs" / "howto" / "teleoperation.md").read_text("utf-8")


def test_it_names_every_option_and_state() -> None:
    free = option_names(Teleop)
    for name in inspect.signature(Teleop).parameters:
        assert name not in free or f"`{name}" in TEXT, name
    for name in Teleop.declares(left="E", right=None):
        assert f"`{name}`" in TEXT, name


def test_its_cameras_are_those_of_arx_demos() -> None:
    shown = yaml.safe_load(re.findall(r"```yaml\n(.*?)```", TEXT, re.S)[1])
    ours = load_document("arx_demos").values
    for stage, given in shown.items():
        assert given == ours[stage][: len(given)]


def test_its_first_example_is_a_part_of_g1_vr() -> None:
    shown = yaml.safe_load(re.findall(r"```yaml\n(.*?)```", TEXT, re.S)[0])
    ours = load_document("g1_vr").values
    listed = [next(iter(set(each) - {"on", "of"})) for each in ours["commands"]]
    assert {next(iter(e)) if isinstance(e, dict) else e for e in shown["commands"]} <= set(listed)
    assert shown["commands"][1]["teleop"]["box"] == ours["commands"][3]["teleop"]["box"]
    assert shown["commands"][2]["reach"] == ours["commands"][4]["reach"]
    assert shown["estimate"] == ours["estimate"]


@pytest.mark.parametrize("name", ["g1_vr", "arx_vr", "arx_demos"])
def test_the_workflows_are_files_that_can_be_read(name: str) -> None:
    assert load_document(name).name == name
