"""The pages on policies, robot files and checks: their files load and their commands run."""

from __future__ import annotations

import json
import re
import shlex
from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest
import yaml
from policy_helpers import write_linear

from unicon_core.check import CODES, check_workflow
from unicon_core.policies import PolicyContract, load_policy, policy_states, term_slices
from unicon_core.policies.contract import CommandSpec, FilterSpec
from unicon_core.policies.file import PolicyFile
from unicon_core.robots import load_robot
from unicon_core.states import States, standard_states
from unicon_ros.cli.main import main

jsonschema = pytest.importorskip("jsonschema", reason="the robot file is held against its schema")

ROOT = Path(__file__).resolve().parents[2]
PAGES = (
    "reference/policies.md", "howto/run_a_policy.md", "reference/robot_file.md",
    "explanation/check.md",
)  # fmt: skip
if not (ROOT / "docs").is_dir():
    pytest.skip("docs/ is not part of this tree", allow_module_level=True)

TEXT = "\n".join((ROOT / "docs" / page).read_text(encoding="utf-8") for page in PAGES)
BLOCKS = re.findall(r"```(\w+)(?: title=(\S+))?\n(.*?)```", TEXT, re.DOTALL)
TITLED = {title: body for _, title, body in BLOCKS if title}
COMMANDS = [
    line for kind, _, body in BLOCKS if kind == "sh" for line in body.splitlines() if line.strip()
]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The files of the pages, with a network for its policy, as the working folder."""
    for title, body in TITLED.items():
        if title.endswith(".yaml"):
            path = tmp_path / title
            path.parent.mkdir(exist_ok=True)
            path.write_text(body, encoding="utf-8")
    write_linear(tmp_path / "my_walk" / "policy.onnx", 45, 12)
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def without_contract(folder: Path) -> None:
    """Leave the bare network, for the examples that give its facts in the workflow."""
    (folder / "my_walk" / "policy.yaml").unlink()


def test_the_policy_is_whole(folder: Path) -> None:
    contract = load_policy(folder / "my_walk")
    assert contract.period == 0.02
    assert contract.stiffness.tolist() == [40.0] * 12
    assert len(contract.terms) == 6


def test_facts_are_taken_from_the_model(folder: Path, assets: Path) -> None:
    pytest.importorskip("mujoco")
    path = folder / "my_walk" / "policy.yaml"
    given = yaml.safe_load(TITLED["from_model.yaml"])
    rest = {k: v for k, v in yaml.safe_load(path.read_text("utf-8")).items() if k not in given}
    path.write_text(yaml.safe_dump(rest), encoding="utf-8")
    model = assets / "models" / "go1" / "go1.xml"
    contract = load_policy(path, robot=load_robot("go1"), given=given, model=lambda: model)
    assert contract.joints[:3] == ("FR_hip_joint", "FL_hip_joint", "RR_hip_joint")
    assert contract.default_joint_pos.tolist()[:2] == pytest.approx([0.1, -0.1])
    assert set(contract.stiffness.tolist()) == {35.0}
    assert set(contract.damping.tolist()) == {0.5}


def test_what_an_action_and_an_observation_may_be(folder: Path) -> None:
    whole = yaml.safe_load(TITLED["my_walk/policy.yaml"])

    def contract(title: str, **more: Any) -> PolicyContract:
        said = yaml.safe_load(TITLED[title]) | more
        path = folder / "my_walk" / "policy.yaml"
        path.write_text(yaml.safe_dump(whole | said), encoding="utf-8")
        return load_policy(path)

    wheels = ["hip", "thigh", "a_knee_joint", "left_wheel_joint", "right_wheel_joint"]
    mixed = contract("wheels.yaml", joints=wheels, default_joint_pos=[0.0] * 5)
    assert mixed.action.kinds == ("position", "position", "torque", "velocity", "velocity")
    filtered = contract("filters.yaml")
    assert filtered.action.filter == FilterSpec(low_pass=5.0, start="zeros")
    assert filtered.terms[0].filter == FilterSpec(moving_average=3, start="first")
    assert filtered.command == CommandSpec((1.0, 0.5, 2.0))
    legs = contract("cosines_first.yaml", phase={"period": 1.0})
    states = States({**standard_states(legs.joints), **policy_states(legs, legs.joints)})
    names = [part.names for part in term_slices(legs, states, legs.joints)]
    assert names == [
        ("cos_0", "cos_1", "sin_0", "sin_1"),
        ("sin_0", "cos_0", "sin_1", "cos_1"),
        ("cos_0", "cos_1"),
    ]
    seen = contract("sees.yaml").images
    assert {spec.shape for spec in seen.values()} == {(3, 96, 96), (1, 58, 87)}
    clock = contract("clock.yaml").phase
    assert clock is not None
    assert (clock.stand, clock.resume, clock.stand_below) == ("zero", "clock", pytest.approx(0.1))


def test_the_robot_file_fits_loader_and_schema(folder: Path) -> None:
    robot = load_robot(folder / "twig.yaml")
    assert robot.missing_facts() == ["joints.effort"]
    schema = json.loads((ROOT / "config" / "schemas" / "robot.json").read_text())
    jsonschema.validate(yaml.safe_load(TITLED["twig.yaml"]), schema)


def test_every_key_of_the_policy_is_in_the_table() -> None:
    table = TEXT.split("| key | meaning, unit (bold: required) |")[1].split("\n\n")[0]
    plain = {"schema", "name", "robot", "description", "sources"}
    for key in {field.name for field in fields(PolicyFile)} - plain:
        assert re.search(rf"`{key}[`.]", table), key
    assert set(yaml.safe_load(TITLED["my_walk/policy.yaml"])) <= plain | {
        field.name for field in fields(PolicyFile)
    }


@pytest.mark.parametrize("line", COMMANDS)
def test_every_command_does_what_the_page_says(
    line: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("mujoco", reason="some commands simulate")
    if "bare.yaml" in line or "import" in line:
        without_contract(folder)
    command, _, comment = line.partition("#")
    assert command.startswith("unicon ")
    status = main(shlex.split(command)[1:])
    told = capsys.readouterr()
    assert status == (1 if "exit 1" in comment else 0), told.out + told.err
    if "robot=h1" in line:
        assert "robot h1 lacks 12 of the 12 joints needed: FR_hip_joint," in told.err
    if "period=20" in line:
        assert TITLED["finding"].strip() in told.out


def test_a_missing_fact_is_asked_for(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    without_contract(folder)
    values = yaml.safe_load(TITLED["bare.yaml"])
    del values["policies"]["walk"]["given"]["period"]
    (folder / "bare.yaml").write_text(yaml.safe_dump(values))
    assert main(["run", "bare.yaml", "--no-ros"]) == 1
    assert capsys.readouterr().err.replace(str(folder), "DIR") == (
        "unicon: error: policy 'walk': DIR/my_walk/policy.onnx: the ONNX file (no metadata) does "
        "not say period (the control period in [s]); give it under 'given' in the workflow, with "
        "the keys of policy.yaml\n"
    )


def test_a_robot_with_an_unknown_fact_is_not_driven(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("rclpy", reason="platform ros is a platform with motors")
    workflow = {"robot": "./twig.yaml", "platform": "ros", "rate": 50, "flow": {"damp": {}}}
    (folder / "twig_damps.yaml").write_text(yaml.safe_dump(workflow))
    assert main(["run", "twig_damps.yaml", "--no-ros"]) == 1
    assert capsys.readouterr().err.replace(str(folder), "DIR") == (
        "unicon: error: robot twig cannot be driven on platform 'ros': DIR/twig.yaml does not say "
        "joints.effort; find it in the vendor's documents and add it with its source, or simulate: "
        "platform=mujoco\n"
    )


def test_the_check_section_is_accepted(folder: Path) -> None:
    without_contract(folder)
    settings = yaml.safe_load(TITLED["check"])["check"]
    assert set(settings["accept"]) <= set(CODES)
    (folder / "bare.yaml").write_text(TITLED["bare.yaml"] + TITLED["check"])
    result = check_workflow(folder / "bare.yaml")
    assert result.clean, result.text()
    assert result.accepted == {"gains.symmetry"}
