"""Cuts a walking policy down to some of its joints, for the tests of partial policies.

The network is kept: a matrix in front puts the fewer joints into their places and zeros into those
of the others (they are at their default and still), a matrix behind takes the wanted actions out.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import yaml
from onnx import helper, numpy_helper

from unicon_core.policies import load_policy
from unicon_core.robots import load_robot

VECTORS = 9  # base_ang_vel, projected_gravity, velocity_commands stand before the joints' terms


def restrict(source: Path, folder: Path, joints: Sequence[str]) -> Path:
    """Write the policy that moves only these joints of the G1, in this order; return its folder."""
    contract = load_policy(source, robot=load_robot("g1_29dof"))
    places = [contract.joints.index(name) for name in joints]
    n, m = len(contract.joints), len(joints)
    widen = np.zeros((VECTORS + 3 * m, VECTORS + 3 * n), np.float32)
    widen[range(VECTORS), range(VECTORS)] = 1.0
    for term in range(3):  # joint_pos_rel, joint_vel_rel, last_action
        rows = [VECTORS + term * m + i for i in range(m)]
        widen[rows, [VECTORS + term * n + place for place in places]] = 1.0
    narrow = np.zeros((n, m), np.float32)
    narrow[places, range(m)] = 1.0
    folder.mkdir(parents=True)
    _wrap(contract.model, folder / "policy.onnx", widen, narrow)
    values: dict[str, Any] = {
        "schema": "unicon.policy/1",
        "name": folder.name,
        "onnx": "policy.onnx",
        "period": contract.period,
        "joints": list(joints),
        "default_joint_pos": _of(contract.default_joint_pos, places),
        "action": {
            "scale": _of(contract.action.scale, places),
            "offset": _of(contract.action.offset, places),
        },
        "stiffness": _of(contract.stiffness, places),
        "damping": _of(contract.damping, places),
        "observation": {
            "terms": [
                {"name": "gyro", "state": "base_ang_vel"},
                {"name": "gravity", "state": "projected_gravity"},
                {"name": "command", "state": "velocity_command"},
                {"name": "joint_pos", "state": "joint_pos", "subtract": "default_joint_pos"},
                {"name": "joint_vel", "state": "joint_vel"},
                {"name": "last_action", "state": "action"},
            ]
        },
    }
    (folder / "policy.yaml").write_text(yaml.safe_dump(values, sort_keys=False), encoding="utf-8")
    return folder


def _of(array: Any, places: Sequence[int]) -> list[float]:
    return [float(array[place]) for place in places]


def _wrap(source: Path, target: Path, widen: Any, narrow: Any) -> None:
    model = onnx.load(str(source))
    graph = model.graph
    [given], [made] = graph.input, graph.output
    graph.node.insert(0, helper.make_node("MatMul", ["few", "widen"], [given.name]))
    graph.node.append(helper.make_node("MatMul", [made.name, "narrow"], ["few_actions"]))
    graph.initializer.append(numpy_helper.from_array(widen, "widen"))
    graph.initializer.append(numpy_helper.from_array(narrow, "narrow"))
    del graph.input[:], graph.output[:], graph.value_info[:]
    float32 = onnx.TensorProto.FLOAT
    graph.input.append(helper.make_tensor_value_info("few", float32, [1, widen.shape[0]]))
    graph.output.append(helper.make_tensor_value_info("few_actions", float32, [1, narrow.shape[1]]))
    onnx.save_model(model, str(target))
