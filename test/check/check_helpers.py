"""What the tests of `unicon check` share: a Go2 with a small network, changed in one place."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import yaml
from onnx import TensorProto, helper, numpy_helper

from unicon_core.check import CheckResult, check_workflow

ROOT = Path(__file__).resolve().parents[2]
JOINTS = tuple(
    f"{leg}_{part}_joint" for leg in ("FL", "FR", "RL", "RR") for part in ("hip", "thigh", "calf")
)
STAND = (0.1, 0.8, -1.5, -0.1, 0.8, -1.5, 0.1, 0.8, -1.5, -0.1, 0.8, -1.5)
POLICY: dict[str, Any] = {
    "schema": "unicon.policy/1",
    "name": "toy",
    "onnx": "policy.onnx",
    "period": 0.02,
    "joints": list(JOINTS),
    "default_joint_pos": list(STAND),
    "action": {"scale": 0.25},
    "stiffness": [40.0] * 12,
    "damping": [1.0] * 12,
    "command_ranges": {"lin_vel_x": [-1.0, 1.0]},
    "observation": {
        "terms": [
            {"name": "ang_vel", "state": "base_ang_vel", "scale": 0.25},
            {"name": "gravity", "state": "projected_gravity"},
            {"name": "command", "state": "velocity_command"},
            {"name": "joint_pos", "state": "joint_pos", "subtract": "default_joint_pos"},
            {"name": "joint_vel", "state": "joint_vel", "scale": 0.05},
            {"name": "last_action", "state": "action"},
        ]
    },
}
WORKFLOW: dict[str, Any] = {
    "robot": "go2",
    "platform": "mujoco",
    "scene": {"initial_pose": "policy:walk"},
    "policies": {"walk": "./policy"},
    "commands": [{"velocity_command": {"constant": [0.6, 0.0, 0.0]}}],
    "flow": {"policy": "walk"},
    "safety": ["finite", "joint_limits"],
}


def write_network(path: Path, inputs: int, outputs: int = 12, gain: float = 0.0) -> None:
    """Write `actions = obs · weight`; with gain 0 the actions are zero and the robot stands."""
    weight = np.random.default_rng(0).normal(size=(inputs, outputs)).astype(np.float32) * gain
    graph = helper.make_graph(
        [helper.make_node("MatMul", ["obs", "w"], ["actions"])],
        "linear",
        [helper.make_tensor_value_info("obs", TensorProto.FLOAT, [1, inputs])],
        [helper.make_tensor_value_info("actions", TensorProto.FLOAT, [1, outputs])],
        [numpy_helper.from_array(weight, "w")],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)])
    model.ir_version = 10
    onnx.save(model, str(path))


NULL = object()
"""Set a key to null by this."""


def changed(values: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return a copy with dotted paths set; a value of None takes the key out."""
    result = deepcopy(dict(values))
    for dotted, value in changes.items():
        here: Any = result
        *path, last = dotted.split(".")
        for key in path:
            here = here[int(key)] if isinstance(here, list) else here.setdefault(key, {})
        place: Any = int(last) if isinstance(here, list) else last
        if value is None:
            del here[place]
        else:
            here[place] = None if value is NULL else value
    return result


def write_workflow(
    folder: Path,
    policy: Mapping[str, Any] | None = None,
    workflow: Mapping[str, Any] | None = None,
    robot: Mapping[str, Any] | None = None,
    *,
    inputs: int = 45,
    outputs: int = 12,
    gain: float = 0.0,
) -> Path:
    """Write workflow, policy and, where it is changed, the robot file; return the workflow."""
    (folder / "policy").mkdir(parents=True)
    write_network(folder / "policy" / "policy.onnx", inputs, outputs, gain)
    text = yaml.safe_dump(changed(POLICY, policy or {}), sort_keys=False)
    (folder / "policy" / "policy.yaml").write_text(text, encoding="utf-8")
    values = changed(WORKFLOW, workflow or {})
    if robot:
        path = ROOT / "config" / "robots" / "go2.yaml"
        facts = changed(yaml.safe_load(path.read_text(encoding="utf-8")), robot)
        (folder / "go2.yaml").write_text(yaml.safe_dump(facts, sort_keys=False), encoding="utf-8")
        values["robot"] = "./go2.yaml"
    path = folder / "toy.yaml"
    path.write_text(yaml.safe_dump(values, sort_keys=False), encoding="utf-8")
    return path


def check(folder: Path, *changes: Mapping[str, Any], **options: Any) -> CheckResult:
    """Write a toy workflow and check it."""
    return check_workflow(write_workflow(folder, *changes, **options))


def codes(result: CheckResult) -> list[str]:
    """Return the codes of the findings."""
    return [finding.code for finding in result.findings]


def text_of(result: CheckResult, code: str) -> str:
    """Return the one finding of a code as its line."""
    found = [finding for finding in result.findings if finding.code == code]
    assert len(found) == 1, result.text()
    return str(found[0])


def note_of(result: CheckResult, code: str) -> str:
    """Return the first note of a code as its line."""
    found = [note for note in result.notes if note.code == code]
    assert found, result.text()
    return str(found[0])


def section(result: CheckResult, title: str) -> Sequence[Sequence[str]]:
    """Return the rows of the table whose title starts like this."""
    return next(s.rows for s in result.sections if s.title.startswith(title))
