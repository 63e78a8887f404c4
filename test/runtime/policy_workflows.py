"""Workflows with policies of random weights, for the tests of runs: plain, history, recurrent."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx
import yaml
from onnx import TensorProto, helper, numpy_helper

from unicon_core.robots import load_robot

KINDS = ("plain", "history", "recurrent")

TERMS = (
    {"name": "base_ang_vel", "state": "base_ang_vel", "scale": 0.25},
    {"name": "projected_gravity", "state": "projected_gravity"},
    {"name": "velocity_command", "state": "velocity_command", "scale": 2.0},
    {"name": "joint_pos", "state": "joint_pos", "subtract": "default_joint_pos"},
    {"name": "joint_vel", "state": "joint_vel", "scale": 0.05},
    {"name": "last_action", "state": "action"},
)

WORKFLOW = """\
robot: go2
platform: fake
scene: {initial_pose: rest}
platforms: {fake: {time_constant: 0.05}}
rate: 50
policies: {walk: ./policy}
commands:
  - velocity_command:
      schedule: [[0.0, 0.0, 0.0, 0.0], [0.2, 0.5, 0.1, -0.3], [0.9, -0.2, 0.0, 0.4]]
flow:
  chain:
    - pose: {to: stand, duration: 0.2}
    - loop: {do: {policy: walk}, until: {elapsed: 0.6}}
    - hold: {duration: 0.06}
    - sway: {duration: 0.2, gains: {"*_hip_joint": [0.2, 0.1, 0.0]}}
    - loop: {do: {policy: walk}, until: {elapsed: 0.5}}
safety: [fade_in, finite, joint_limits, effort_limits, rate_limit, tilt_stop]
"""


def write_policy(folder: Path, kind: str) -> None:
    """Write `policy.yaml` and a network of two layers; batches are free but for `recurrent`."""
    robot = load_robot("go2")
    n, history = robot.num_joints, 4 if kind == "history" else 1
    inputs, hidden = (9 + 3 * n) * history, 16
    random = np.random.default_rng(5)

    def weight(name: str, *shape: int) -> onnx.TensorProto:
        values = random.normal(size=shape) / np.sqrt(shape[0])
        return numpy_helper.from_array(values.astype(np.float32), name)

    batch = 1 if kind == "recurrent" else "batch"
    info = helper.make_tensor_value_info
    feeds = [info("obs", TensorProto.FLOAT, [batch, inputs])]
    fetches = [info("actions", TensorProto.FLOAT, [batch, n])]
    weights = [weight("w0", inputs, hidden), weight("w1", hidden, n)]
    nodes = [helper.make_node("MatMul", ["obs", "w0"], ["a0"])]
    last = "a0"
    if kind == "recurrent":
        feeds.append(info("h_in", TensorProto.FLOAT, [1, hidden]))
        fetches.append(info("h_out", TensorProto.FLOAT, [1, hidden]))
        weights.append(weight("wh", hidden, hidden))
        nodes += [
            helper.make_node("MatMul", ["h_in", "wh"], ["ah"]),
            helper.make_node("Add", ["a0", "ah"], ["sum"]),
        ]
        last = "sum"
    nodes += [
        helper.make_node("Tanh", [last], ["h_out"]),
        helper.make_node("MatMul", ["h_out", "w1"], ["actions"]),
    ]
    graph = helper.make_graph(nodes, kind, feeds, fetches, weights)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8)
    folder.mkdir(parents=True, exist_ok=True)
    onnx.save(model, str(folder / "policy.onnx"))
    values = {
        "schema": "unicon.policy/1",
        "name": kind,
        "onnx": "policy.onnx",
        "period": 0.02,
        "joints": list(robot.joint_names),
        "default_joint_pos": [float(x) for x in robot.default_joint_pos],
        "action": {"scale": 0.25, "clip": [-4.0, 4.0], "feedback": "clipped"},
        "stiffness": 30.0,
        "damping": 1.0,
        "inputs": {"observation": "obs"},
        "outputs": {"action": "actions"},
        "observation": {"terms": [{**term, "history": history} for term in TERMS]},
    }
    if kind == "recurrent":
        values["recurrent"] = [{"input": "h_in", "output": "h_out"}]
    (folder / "policy.yaml").write_text(yaml.safe_dump(values), encoding="utf-8")


def write_workflow(folder: Path, kind: str) -> Path:
    """Write a workflow whose flow goes through postures and a policy; return the file."""
    write_policy(folder / "policy", kind)
    path = folder / f"{kind}.yaml"
    path.write_text(WORKFLOW, encoding="utf-8")
    return path
