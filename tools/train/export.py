"""Turn a training checkpoint into the shipped policy: `python export.py checkpoint.pt`.

Writes `policy.onnx` (see network.py) and `policy.yaml`, the contract that unicon_core reads.
"""

from __future__ import annotations

import argparse
import hashlib
from pathlib import Path

import contract
import network
import numpy as np
import onnx
import torch
import yaml
from integral import Weights
from onnx import helper

STATES = {
    "joint_pos_rel": {"state": "joint_pos", "subtract": "default_joint_pos"},
    "joint_vel_rel": {"state": "joint_vel"},
    "last_action": {"state": "action"},
}


SCAN_TERM = {
    "name": "height_scan",
    "state": "height_scan",
    "subtract": contract.SCAN_HEIGHT,
    "clip": [-contract.SCAN_CLIP, contract.SCAN_CLIP],
}


def sees(values: dict[str, torch.Tensor]) -> bool:
    """True for a checkpoint of `train.py --stairs`: its actor takes a scan."""
    return values["actor.0.weight"].shape[1] > contract.NUM_OBS


def floats(values: np.ndarray | list[float]) -> list[float]:
    """Plain floats, rounded to what float32 can tell."""
    return [float(f"{v:.6g}") for v in np.asarray(values)]


def weights(values: dict[str, torch.Tensor], name: str) -> Weights:
    """(weight, bias) of each layer of one network of a checkpoint."""
    numbers = sorted({int(key.split(".")[1]) for key in values if key.startswith(f"{name}.")})
    parts = ("weight", "bias")
    return [tuple(values[f"{name}.{i}.{part}"].numpy() for part in parts) for i in numbers]


def build(values: dict[str, torch.Tensor]) -> onnx.ModelProto:
    """The network of a checkpoint with the metadata keys of mjlab and BeyondMimic."""
    actor = weights(values, "actor")
    n = len(contract.JOINTS)
    names = [name for name, _, _ in contract.TERMS]
    if sees(values):
        names.append(SCAN_TERM["name"])
        actor[0][0][:, contract.NUM_OBS :] *= contract.SCAN_SCALE
        # The estimate of the velocity is that of the policy which training went on from.
        _, estimate = network.weights_of(onnx.load(contract.POLICY_DIR / "policy.onnx"))
    else:
        estimate = weights(values, "estimate")
    model = network.build(actor, estimate)
    metadata = {
        "joint_names": contract.JOINTS,
        "joint_stiffness": [contract.STIFFNESS] * n,
        "joint_damping": [contract.DAMPING] * n,
        "default_joint_pos": floats(contract.DEFAULT_JOINT_POS),
        "command_names": ["velocity_command"],
        "observation_names": names,
        "action_scale": [contract.ACTION_SCALE] * n,
    }
    helper.set_model_props(model, {k: ",".join(map(str, v)) for k, v in metadata.items()})
    return model


def policy_yaml(sha256: str, scan: bool) -> str:
    """The contract file that stands beside the network."""
    n = len(contract.JOINTS)
    terms = [
        {"name": name, **STATES.get(name, {"state": name}), "scale": scale}
        for name, _, scale in contract.TERMS
    ]
    if scan:
        terms.append(SCAN_TERM)
    low, high = contract.COMMAND_LOW, contract.COMMAND_HIGH
    document = {
        "schema": "unicon.policy/1",
        "name": "go2_stairs" if scan else "go2_velocity",
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
        "recurrent": [{"input": "memory", "output": "next_memory"}],
        "command_ranges": {
            name: floats([low[i], high[i]])
            for i, name in enumerate(("lin_vel_x", "lin_vel_y", "ang_vel_z"))
        },
    }
    if scan:
        document["height_scan"] = {
            "size": list(contract.SCAN_SIZE),
            "resolution": contract.SCAN_RESOLUTION,
            "offset": [0.0, 0.0],
            "frame": "yaw",
            "order": "xy",
        }
    body = yaml.dump(document, sort_keys=False, default_flow_style=None, width=110)
    return (
        f"# Our {'stairs' if scan else 'velocity'} policy for Unitree Go2, trained by tools/train"
        " (its README tells how).\n"
        "# Written by tools/train/export.py; figures in EVALUATION.md.\n" + body
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("checkpoint", type=Path)
    parser.add_argument("--out", type=Path, help="folder; default: that of the shipped policy")
    args = parser.parse_args()
    values = torch.load(args.checkpoint)["net"]
    scan = sees(values)
    args.out = args.out or (contract.STAIRS_DIR if scan else contract.POLICY_DIR)
    args.out.mkdir(parents=True, exist_ok=True)
    if not scan and not any(name.startswith("estimate.") for name in values):
        parser.error(f"{args.checkpoint} has no estimate yet: python estimate.py {args.checkpoint}")
    data = build(values).SerializeToString()
    (args.out / "policy.onnx").write_bytes(data)
    digest = hashlib.sha256(data).hexdigest()
    (args.out / "policy.yaml").write_text(policy_yaml(digest, scan), encoding="utf-8")
    print(f"{args.out / 'policy.onnx'}: {len(data)} bytes, sha256 {digest}")


if __name__ == "__main__":
    main()
