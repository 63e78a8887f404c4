"""Turn a training checkpoint into the shipped policy: `python export.py checkpoint.pt`.

Writes `policy.onnx` (Gemm and Elu nodes, opset 13, IR 8: accepted by onnxruntime >= 1.17) with the
metadata keys of mjlab and BeyondMimic, and `policy.yaml`, the contract that unicon_core reads.
"""

from __future__ import annotations

import argparse
import hashlib
from pathlib import Path

import contract
import numpy as np
import onnx
import torch
import yaml
from onnx import TensorProto, helper, numpy_helper

STATES = {
    "joint_pos_rel": {"state": "joint_pos", "subtract": "default_joint_pos"},
    "joint_vel_rel": {"state": "joint_vel"},
    "last_action": {"state": "action"},
}


def floats(values: np.ndarray | list[float]) -> list[float]:
    """Plain floats, rounded to what float32 can tell."""
    return [float(f"{v:.6g}") for v in np.asarray(values)]


def build(weights: dict[str, torch.Tensor]) -> onnx.ModelProto:
    """ONNX of the actor's mean: `obs` (batch, 45) -> `actions` (batch, 12)."""
    layers = sorted({int(name.split(".")[1]) for name in weights if name.startswith("actor.")})
    nodes, initializers, value = [], [], "obs"
    for layer in layers:
        for part in ("weight", "bias"):
            array = weights[f"actor.{layer}.{part}"].numpy().astype(np.float32)
            initializers.append(numpy_helper.from_array(array, f"{part}_{layer}"))
        last = layer == layers[-1]
        out = "actions" if last else f"linear_{layer}"
        names = [value, f"weight_{layer}", f"bias_{layer}"]
        nodes.append(helper.make_node("Gemm", names, [out], f"gemm_{layer}", transB=1))
        if not last:
            nodes.append(helper.make_node("Elu", [out], [f"elu_{layer}"], f"elu_{layer}"))
            value = f"elu_{layer}"
    num_joints = len(contract.JOINTS)
    graph = helper.make_graph(
        nodes,
        "go2_velocity",
        [helper.make_tensor_value_info("obs", TensorProto.FLOAT, ["batch", contract.NUM_OBS])],
        [helper.make_tensor_value_info("actions", TensorProto.FLOAT, ["batch", num_joints])],
        initializers,
    )
    model = helper.make_model(
        graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8, producer_name="unicon_ros"
    )
    n = len(contract.JOINTS)
    metadata = {
        "joint_names": contract.JOINTS,
        "joint_stiffness": [contract.STIFFNESS] * n,
        "joint_damping": [contract.DAMPING] * n,
        "default_joint_pos": floats(contract.DEFAULT_JOINT_POS),
        "command_names": ["velocity_command"],
        "observation_names": [name for name, _, _ in contract.TERMS],
        "action_scale": [contract.ACTION_SCALE] * n,
    }
    helper.set_model_props(model, {k: ",".join(map(str, v)) for k, v in metadata.items()})
    onnx.checker.check_model(model, full_check=True)
    return model


def policy_yaml(sha256: str) -> str:
    """The contract file that stands beside the network."""
    n = len(contract.JOINTS)
    terms = [
        {"name": name, **STATES.get(name, {"state": name}), "scale": scale}
        for name, _, scale in contract.TERMS
    ]
    low, high = contract.COMMAND_LOW, contract.COMMAND_HIGH
    document = {
        "schema": "unicon.policy/1",
        "name": "go2_velocity",
        "onnx": "policy.onnx",
        "sha256": sha256,
        "period": contract.PERIOD,
        "robot": "go2",
        "joints": list(contract.JOINTS),
        "default_joint_pos": floats(contract.DEFAULT_JOINT_POS),
        "action": {
            "scale": contract.ACTION_SCALE,
            "clip": [-contract.ACTION_CLIP, contract.ACTION_CLIP],
        },
        "stiffness": [contract.STIFFNESS] * n,
        "damping": [contract.DAMPING] * n,
        "observation": {"layout": "term_major", "newest": "last", "terms": terms},
        "inputs": {"observation": "obs"},
        "outputs": {"action": "actions"},
        "command_ranges": {
            name: floats([low[i], high[i]])
            for i, name in enumerate(("lin_vel_x", "lin_vel_y", "ang_vel_z"))
        },
    }
    body = yaml.dump(document, sort_keys=False, default_flow_style=None, width=110)
    return (
        "# Our velocity policy for Unitree Go2, trained by tools/train (its README tells how).\n"
        "# Written by tools/train/export.py; figures in EVALUATION.md.\n" + body
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("checkpoint", type=Path)
    parser.add_argument("--out", type=Path, default=contract.POLICY_DIR)
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    data = build(torch.load(args.checkpoint)["net"]).SerializeToString()
    (args.out / "policy.onnx").write_bytes(data)
    digest = hashlib.sha256(data).hexdigest()
    (args.out / "policy.yaml").write_text(policy_yaml(digest), encoding="utf-8")
    print(f"{args.out / 'policy.onnx'}: {len(data)} bytes, sha256 {digest}")


if __name__ == "__main__":
    main()
