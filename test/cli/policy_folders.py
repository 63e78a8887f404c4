"""Policy folders that the tests write: one that is right, and one for each way to be wrong."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx
import yaml
from onnx import TensorProto, helper, numpy_helper

from unicon_core.robots import load_robot

TERMS = [
    {"name": "base_ang_vel", "state": "base_ang_vel"},
    {"name": "projected_gravity", "state": "projected_gravity"},
    {"name": "velocity_command", "state": "velocity_command"},
    {"name": "joint_pos_rel", "state": "joint_pos", "subtract": "default_joint_pos"},
    {"name": "joint_vel_rel", "state": "joint_vel"},
    {"name": "last_action", "state": "action"},
]


def write_network(path: Path, inputs: int, outputs: int, *, external: bool = False) -> None:
    """Write a linear network with small weights: input `obs`, output `actions`."""
    weights = np.random.default_rng(0).normal(0.0, 0.01, (inputs, outputs)).astype(np.float32)
    graph = helper.make_graph(
        [helper.make_node("MatMul", ["obs", "weights"], ["actions"])],
        "linear",
        [helper.make_tensor_value_info("obs", TensorProto.FLOAT, [1, inputs])],
        [helper.make_tensor_value_info("actions", TensorProto.FLOAT, [1, outputs])],
        [numpy_helper.from_array(weights, "weights")],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    onnx.save_model(
        model,
        str(path),
        save_as_external_data=external,
        location=f"{path.name}.data",
        size_threshold=0,
    )


def write_policy(folder: Path, *, inputs: int = 45, external: bool = False) -> Path:
    """Write a policy for go2 whose terms make 45 inputs."""
    robot = load_robot("go2")
    folder.mkdir(parents=True)
    contract = {
        "schema": "unicon.policy/1",
        "name": folder.name,
        "onnx": "policy.onnx",
        "period": 0.02,
        "joints": list(robot.joint_names),
        "default_joint_pos": [round(float(x), 4) for x in robot.default_joint_pos],
        "action": {"scale": 0.25},
        "stiffness": [30.0] * robot.num_joints,
        "damping": [1.0] * robot.num_joints,
        "observation": {"terms": TERMS},
        "inputs": {"observation": "obs"},
        "outputs": {"action": "actions"},
    }
    (folder / "policy.yaml").write_text(yaml.safe_dump(contract, sort_keys=False))
    write_network(folder / "policy.onnx", inputs, robot.num_joints, external=external)
    return folder


def write_all(root: Path) -> None:
    """Write every folder that the files in `test/bad_workflows/` name."""
    write_policy(root / "good")
    write_policy(root / "wrong_size", inputs=48)
    (write_policy(root / "no_network") / "policy.onnx").unlink()
    (write_policy(root / "no_external_data", external=True) / "policy.onnx.data").unlink()
    path = write_policy(root / "short_names") / "policy.yaml"
    path.write_text(path.read_text().replace("_joint\n", "\n"))
    path = write_policy(root / "from_model") / "policy.yaml"
    values = yaml.safe_load(path.read_text()) | {"joints": {"from": "model"}}
    path.write_text(yaml.safe_dump(values, sort_keys=False))
