"""docs/howto/motion.md its examples are read and run, its tables name what there is."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from motion_helpers import JOINTS, POLICY, model_in, motion, waisted, write_tracker

from unicon_core.policies import Policy, load_policy, policy_states
from unicon_core.policies.hints import AXES
from unicon_core.runtime import Runner, RunOptions
from unicon_core.states import States, standard_states
from unicon_core.workflow import load_workflow
from unicon_ros.cli.main import main

pytest.importorskip("mujoco", reason="anchors are found in a model")
pytest.importorskip("onnxruntime", reason="the networks are ONNX")

DOCUMENT = Path(__file__).resolve().parents[2] / "docs" / "howto" / "motion.md"
if not DOCUMENT.is_file():
    pytest.skip("docs/ is not part of this tree", allow_module_level=True)

TEXT = DOCUMENT.read_text(encoding="utf-8")
BLOCKS = re.findall(r"```(\w+)\n(.*?)```", TEXT, re.DOTALL)
YAML = [yaml.safe_load(body) for kind, body in BLOCKS if kind == "yaml"]
TERMS = [
    {"name": "command", "state": "motion_command"},
    {"name": "anchor", "state": "motion_anchor_ori_b"},
    {"name": "joint_pos", "state": "joint_pos"},
]
GIVEN: dict[str, Any] = {
    "period": 0.02, "joints": POLICY, "default_joint_pos": [0.1, 0.2, 0.3, 0.4],
    "stiffness": 10.0, "damping": 1.0, "action.scale": 0.25, "observation.terms": TERMS,
}  # fmt: skip


def example(key: str) -> dict[str, Any]:
    """Return the one example that begins with a key."""
    (found,) = (values for values in YAML if key in values)
    return found


def table(first: str) -> list[list[str]]:
    """Return the words in code of the first column of a table, row by row."""
    rows = TEXT.split(f"| {first}", 1)[1].split("\n\n", 1)[0].splitlines()[2:]
    return [re.findall(r"`([^`]+)`", row.split("|")[1]) for row in rows]


@pytest.fixture
def policy(tmp_path: Path) -> Policy:
    """A policy whose contract has the page's motion, for the robot of the tests."""
    np.savez(tmp_path / "dance.npz", **{**motion(), "fps": [1.0]})  # it lasts longer so
    model_in(tmp_path)
    write_tracker(tmp_path / "dance.onnx", 8 + 6 + 4, None)
    told = {**example("motion")["motion"], "anchor_body": "torso", "joints": "policy"}
    contract = load_policy(tmp_path / "dance.onnx", given={**GIVEN, "motion": told})
    states = States({**standard_states(JOINTS), **policy_states(contract, JOINTS)})
    return Policy(contract, states, waisted(), model=tmp_path / "waisted.xml")


def test_the_motion_of_the_page_is_followed(policy: Policy) -> None:
    spec = policy.contract.motion
    assert spec is not None
    assert (spec.align, spec.start, spec.end) == ("yaw", 0.0, 20.0)
    assert not policy()
    states = policy.made[0][0]
    assert states["motion_time"] == 0.0
    np.testing.assert_allclose(states["motion_joint_pos"], motion()["joint_pos"][0], atol=1e-6)


def test_the_tables_name_all_keys_and_states(policy: Policy) -> None:
    keys = {name for row in table("key | meaning") for name in row}
    said = set(example("motion")["motion"])
    assert keys | said == set(policy.contract.motion.__dataclass_fields__)  # type: ignore[union-attr]
    assert set(example_chain().values()) <= set(AXES)
    states = {name for row in table("state | shape") for name in row}
    own = policy_states(policy.contract, JOINTS)
    assert states == {name for name in own if name.startswith("motion_")}


def example_chain() -> dict[str, str]:
    """Return the chain in the table of keys."""
    (found,) = re.findall(r"`(\{waist_yaw_joint: [^`]+\})`", TEXT)
    chain: dict[str, str] = yaml.safe_load(found)
    return chain


def test_the_flow_of_the_page_goes_on_behind_the_dance(assets: Path) -> None:
    flow = example("flow")["flow"]
    shorter = ["policies.dance.given.motion.end=1.0", f"flow={yaml.safe_dump(flow)}"]
    still = ["commands=[{velocity_command: {constant: [0.0, 0.0, 0.0]}}]"]
    program = load_workflow("g1_dance", [*shorter, *still])
    report = Runner(program, RunOptions(duration=7.0, speed="max", warn=lambda _: None)).run()
    assert (report.ended, report.faults, report.fell) == ("duration", [], False)
    assert float(program.states["dance_motion_time"]) == pytest.approx(1.0, abs=0.021)


@pytest.mark.slow
@pytest.mark.parametrize(
    "line", [line for kind, body in BLOCKS if kind == "sh" for line in body.splitlines()]
)
def test_every_command_of_the_page_runs(
    line: str, assets: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(shlex.split(line)[1:]) == 0
    assert "did not fall" in capsys.readouterr().out
