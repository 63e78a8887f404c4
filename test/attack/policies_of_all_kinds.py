"""Small policies for go2 of every kind, and workflows that run them on the fake robot."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import onnx
import yaml
from onnx import TensorProto, helper, numpy_helper

from unicon_core.robots import load_robot
from unicon_core.runtime import Report, Runner, RunOptions
from unicon_core.workflow import load_workflow

__all__ = ["INPUTS", "JOINTS", "KINDS", "run", "write_contract", "write_policy"]

INPUTS, JOINTS, HIDDEN = 45, 12, 8
KINDS = ("plain", "history", "phase", "time_step", "recurrent")

TERMS: list[dict[str, Any]] = [
    {"name": "base_ang_vel", "state": "base_ang_vel"},
    {"name": "projected_gravity", "state": "projected_gravity"},
    {"name": "velocity_command", "state": "velocity_command"},
    {"name": "joint_pos", "state": "joint_pos", "subtract": "default_joint_pos"},
    {"name": "joint_vel", "state": "joint_vel", "scale": 0.05},
    {"name": "last_action", "state": "action"},
]
WORKFLOW = """\
schema: unicon.workflow/1
robot: go2
platform: fake
platforms: {fake: {time_constant: 0.05}}
rate: 50
policies: {walk: POLICY}
commands:
  - velocity_command: {constant: [0.5, 0.0, 0.0]}
flow: {policy: walk}
safety: [finite, joint_limits]
"""


def write_contract(folder: Path, **changes: Any) -> None:
    """Write `policy.yaml`."""
    machine = load_robot("go2")
    contract = {
        "schema": "unicon.policy/1",
        "name": folder.name,
        "onnx": "policy.onnx",
        "period": 0.02,
        "joints": list(machine.joint_names),
        "default_joint_pos": [round(float(x), 4) for x in machine.default_joint_pos],
        "action": {"scale": 0.25},
        "stiffness": 30.0,
        "damping": 1.0,
        "observation": {"terms": TERMS},
        **changes,
    }
    folder.mkdir(parents=True, exist_ok=True)
    known = {key: value for key, value in contract.items() if value is not None}
    (folder / "policy.yaml").write_text(yaml.safe_dump(known), "utf-8")


def write_policy(folder: Path, kind: str) -> Path:
    """Write a policy with random weights; return its folder."""
    rng = np.random.default_rng(3)
    size, extra = INPUTS, {}
    if kind == "history":
        size = 3 * INPUTS
        extra = {"observation": {"terms": [{**term, "history": 3} for term in TERMS]}}
    elif kind == "phase":
        states = [f"gait_phase_{name}" for name in ("cos", "sin")]
        terms = [*TERMS, *({"name": name, "state": name} for name in states)]
        size = INPUTS + 4
        extra = {
            "phase": {"period": 0.7, "offsets": [0.0, 3.0]},
            "observation": {"terms": terms},
        }
    elif kind == "time_step":
        extra = {"inputs": {"observation": "obs", "time_step": "step"}}
    elif kind == "recurrent":
        extra = {"recurrent": [{"input": "h_in", "output": "h_out"}]}
    write_contract(folder, **extra)
    mix = {
        "w": rng.normal(0.0, 0.3, (size, HIDDEN)),
        "u": rng.normal(0.0, 0.3, (HIDDEN, HIDDEN)),
        "b": rng.normal(0.0, 0.3, (HIDDEN,)),
        "v": rng.normal(0.0, 0.3, (HIDDEN, JOINTS)),
        "t": np.full((1, HIDDEN), 0.1),
    }
    inputs = [helper.make_tensor_value_info("obs", TensorProto.FLOAT, [1, size])]
    outputs = [helper.make_tensor_value_info("actions", TensorProto.FLOAT, [1, JOINTS])]
    nodes = [helper.make_node("Gemm", ["obs", "w", "b"], ["x"])]
    last = "x"
    if kind == "recurrent":
        inputs.append(helper.make_tensor_value_info("h_in", TensorProto.FLOAT, [1, HIDDEN]))
        outputs.append(helper.make_tensor_value_info("h_out", TensorProto.FLOAT, [1, HIDDEN]))
        nodes += [
            helper.make_node("MatMul", ["h_in", "u"], ["y"]),
            helper.make_node("Add", ["x", "y"], ["z"]),
            helper.make_node("Tanh", ["z"], ["h_out"]),
        ]
        last = "h_out"
    elif kind == "time_step":
        inputs.append(helper.make_tensor_value_info("step", TensorProto.FLOAT, [1, 1]))
        nodes += [
            helper.make_node("MatMul", ["step", "t"], ["y"]),
            helper.make_node("Add", ["x", "y"], ["z"]),
        ]
        last = "z"
    nodes += [
        helper.make_node("Tanh", [last], ["hidden"]),
        helper.make_node("MatMul", ["hidden", "v"], ["actions"]),
    ]
    used = {name for node in nodes for name in node.input}
    weights = [
        numpy_helper.from_array(value.astype(np.float32), name)
        for name, value in mix.items()
        if name in used
    ]
    graph = helper.make_graph(nodes, kind, inputs, outputs, weights)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8)
    onnx.save(model, str(folder / "policy.onnx"))
    return folder


def run(workflow: str | Path, speed: str, seconds: float) -> Report:
    """Run a workflow, or a policy's folder on the fake robot."""
    if isinstance(workflow, Path) and workflow.is_dir():
        file = workflow.parent / f"{workflow.name}.yaml"
        file.write_text(WORKFLOW.replace("POLICY", str(workflow)), "utf-8")
        workflow = file
    loaded = load_workflow(workflow)
    return Runner(loaded, RunOptions(duration=seconds, speed=speed, warn=lambda line: None)).run()
