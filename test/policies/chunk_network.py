"""A network for go2 that answers with chunks, for tests: row i is tanh(obs · w) + 0.01 i."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import yaml
from onnx import TensorProto, helper, numpy_helper
from policy_helpers import save
from slow_network import SIZE, TERMS, turning, weights

from unicon_core.robots import load_robot

ROWS, JOINTS = 8, 12


def write_chunks(
    folder: Path, *, prefix: bool = False, nan: bool = False, turns: int = 0, **chunk: Any
) -> Path:
    """Write the policy.

    Args:
        folder: of it.
        prefix: the answer is the planned rows instead, plus how many run meanwhile.
        nan: rows are NaN once vx is above 0.5 m/s.
        turns: how often it turns around nothing; 10,000 take some 10 ms.
        chunk: key `chunk` beside its size.
    """
    ramp = 0.01 * np.arange(ROWS, dtype=np.float32).reshape(1, ROWS, 1)
    constants: dict[str, Any] = {"w": weights()[0], "ramp": ramp, "vx": np.int64([24])}
    constants |= {"row": np.int64([1, 1, JOINTS]), "half": np.float32(0.5)}
    nodes = [
        helper.make_node("MatMul", ["obs", "w"], ["a"]),
        helper.make_node("Tanh", ["a"], ["b"]),
        helper.make_node("Reshape", ["b", "row"], ["c"]),
        helper.make_node("Add", ["c", "ramp"], ["plain"]),
        helper.make_node("Gather", ["obs", "vx"], ["fast"], axis=1),
        helper.make_node("Sub", ["half", "fast"], ["below"]),
        helper.make_node("Sqrt", ["below"], ["root"]),
    ]
    constants |= {"yes": np.bool_(True), "one": np.float32(1.0), "turns": np.int64(turns)}
    constants |= {"nothing": np.float32(0.0)}
    nodes += turning("turns", "one")
    nodes.append(helper.make_node("Mul", ["root" if nan else "turned", "nothing"], ["zero"]))
    source = "plain"
    if prefix:
        nodes.append(helper.make_node("Add", ["prefix", "delay"], ["known"]))
        source = "known"
    nodes.append(helper.make_node("Add", [source, "zero"], ["chunk"]))

    def value(name: str, *shape: int) -> Any:
        return helper.make_tensor_value_info(name, TensorProto.FLOAT, shape)

    taken = [value("prefix", 1, ROWS, JOINTS), value("delay", 1, 1)] if prefix else []
    graph = helper.make_graph(
        nodes,
        "chunks",
        [value("obs", 1, SIZE), *taken],
        [value("chunk", 1, ROWS, JOINTS)],
        [numpy_helper.from_array(np.asarray(array), name) for name, array in constants.items()],
    )
    save(folder / "policy.onnx", graph)
    robot = load_robot("go2")
    inputs = {"action_prefix": "prefix", "action_delay": "delay"} if prefix else {}
    values = {
        "schema": "unicon.policy/1",
        "name": "slow",
        "onnx": "policy.onnx",
        "period": 0.04,
        "joints": list(robot.joint_names),
        "default_joint_pos": [float(x) for x in robot.default_joint_pos],
        "action": {"scale": 0.1},
        "chunk": {"size": ROWS, **chunk},
        "stiffness": 40.0,
        "damping": 1.0,
        "observation": {"terms": [{"name": state, "state": state} for state in TERMS]},
        "inputs": {"observation": "obs", **inputs},
        "outputs": {"action": "chunk"},
    }
    (folder / "policy.yaml").write_text(yaml.safe_dump(values), "utf-8")
    return folder
