"""The pages about blocks: their examples run, and their tables say what there is."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from unicon_base.errors import UniconError
from unicon_base.schema.read import read_value
from unicon_core.runtime import Pacing, Runner, RunOptions
from unicon_core.states import StateSpec, standard_states
from unicon_core.workflow import load_workflow
from unicon_core.workflow.flow_yaml import FLOW_WORDS

DOCS = Path(__file__).resolve().parents[2] / "docs"
TEXT = (DOCS / "reference" / "blocks.md").read_text(encoding="utf-8")
HOW_TO = (DOCS / "howto" / "write_a_block.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"^```(\w+)\n(.*?)^```", TEXT + HOW_TO, re.MULTILINE | re.DOTALL)
PYTHON = [code for language, code in EXAMPLES if language == "python"]
YAML = [code for language, code in EXAMPLES if language == "yaml"]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The folder of the reader: the files that the pages name, on the path."""
    for code in (*PYTHON, *YAML):
        name = re.match(r"# (\w+\.(?:py|yaml))\n", code)
        if name:
            (tmp_path / name[1]).write_text(code, encoding="utf-8")
    assert {path.name for path in tmp_path.iterdir()} == {"my_blocks.py", "crouch.yaml"}
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    yield tmp_path
    sys.modules.pop("my_blocks", None)


@pytest.mark.parametrize("code", PYTHON, ids=range(len(PYTHON)))
def test_the_python_examples_run(code: str, folder: Path) -> None:
    exec(compile(code, "an example", "exec"), {"__name__": __name__})


def test_the_workflow_of_the_how_to_runs(folder: Path) -> None:
    workflow = load_workflow("crouch.yaml", {"rate": 100})
    report = Runner(workflow, RunOptions(speed="max")).run()
    assert report.faults == []
    assert 1.5 < report.duration_s < 1.6
    assert workflow.states.crouch == workflow.states.velocity_command[0] * 0.4


def test_the_states_example_is_a_specification() -> None:
    for values in yaml.safe_load(YAML[0])["states"].values():
        assert StateSpec.from_dict(values).size == 12


def test_the_forms_of_blocks_build(folder: Path) -> None:
    forms = yaml.safe_load(next(code for code in YAML if "gravity_of_the_arm" in code))
    for form in forms["flow"]["zip"]:
        path = folder / "form.yaml"
        values: dict[str, Any] = {"robot": "go2", "platform": "fake", "rate": 50, "flow": form}
        values["states"] = {
            "crouch": {"shape": []},
            "gravity_of_the_arm": {"shape": [3], "initial": -1.0},
        }
        if "hold" not in str(form) and "pose" not in str(form):
            values["flow"] = {"zip": ["hold", form]}
        path.write_text(yaml.safe_dump(values), encoding="utf-8")
        load_workflow(path).close()


def test_the_loop_example_builds(folder: Path) -> None:
    flow = yaml.safe_load(next(code for code in YAML if "base_pos_w[2]" in code))
    path = folder / "loop.yaml"
    values = {"robot": "go2", "platform": "fake", "policies": {"walk": "go2_velocity"}}
    path.write_text(yaml.safe_dump({**values, "flow": flow}), encoding="utf-8")
    load_workflow(path).close()


def test_the_excitation_example_builds(folder: Path) -> None:
    flow = yaml.safe_load(next(code for code in YAML if code.startswith("excite:")))
    path = folder / "excite.yaml"
    values = {"robot": "go2", "platform": "fake", "rate": 50, "flow": flow}
    path.write_text(yaml.safe_dump(values), encoding="utf-8")
    load_workflow(path).close()


def test_the_pacing_example_names_every_option_with_its_default() -> None:
    values = yaml.safe_load(next(code for code in YAML if code.startswith("pacing:")))["pacing"]
    assert set(values) == set(Pacing.__dataclass_fields__)
    read_value(Pacing, values, lambda where, text: UniconError(text), "pacing")
    for key in ("trigger", "overrun", "spin_us", "dry_run_us"):
        assert values[key] == getattr(Pacing(), key)
    assert values["arrival_spin_us"] * 1000 == Pacing().arrival_spin_ns(20_000_000)
    assert Pacing().arrival_spin_ns(15_000_000) == 0


def test_the_tables_name_every_node_and_standard_state() -> None:
    for word in FLOW_WORDS:
        assert f"| `{word}: " in TEXT
    for name in standard_states(["a"]):
        assert f"`{name}`" in TEXT
