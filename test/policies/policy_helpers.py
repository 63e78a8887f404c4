"""What the policy tests share: small networks written on the spot, and robots."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import yaml
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper

from unicon_core.robots import Robot

JOINTS = ("a_hip", "a_knee", "b_hip", "b_knee")


def robot(
    joints: Sequence[str] = JOINTS,
    *,
    default: float = 0.5,
    stiffness: float = 7.0,
    damping: float = 0.7,
    name: str = "toy",
) -> Robot:
    """A robot with the given joints in vendor order; NaN marks an unknown fact."""
    n = len(joints)

    def full(value: float) -> NDArray[np.float32]:
        return np.full(n, value, np.float32)

    return Robot(
        name=name,
        description="test robot",
        manufacturer="nobody",
        kind="quadruped",
        path=Path(f"{name}.yaml"),
        models={},
        base_frame="base_link",
        joint_names=tuple(joints),
        lower=full(-2),
        upper=full(2),
        velocity_limit=full(10),
        effort_limit=full(10),
        default_joint_pos=full(default),
        rest_joint_pos=full(0),
        joint_stiffness=full(stiffness),
        joint_damping=full(damping),
        imu=None,
        feet=(),
        transport={"protocol": "none"},
        sources={},
        unknown=(),
    )


def write_linear(
    path: Path,
    inputs: int,
    outputs: int,
    *,
    metadata: Sequence[tuple[str, str]] = (),
    batch: int | str = 1,
    weight: NDArray[np.float32] | None = None,
    names: tuple[str, str] = ("obs", "actions"),
) -> NDArray[np.float32]:
    """Write a network `actions = obs · weight`; return the weight, shape (inputs, outputs)."""
    if weight is None:
        weight = np.random.default_rng(1).normal(size=(inputs, outputs)).astype(np.float32) * 0.1
    obs, actions = names
    shapes = {obs: [batch, inputs], actions: [batch, outputs]}
    write_graph(path, f"{actions} = MatMul({obs}, w)", [obs], shapes, {"w": weight}, metadata)
    return weight


def write_graph(
    path: Path,
    nodes: str,
    inputs: Sequence[str],
    shapes: Mapping[str, Sequence[int | str]],
    constants: Mapping[str, Any],
    metadata: Sequence[tuple[str, str]] = (),
    types: Mapping[str, int] | None = None,
) -> None:
    """Write a network; `save` takes its metadata.

    Args:
        path: the file.
        nodes: one a line: `output = Operator(input, input)`.
        inputs: their names.
        shapes: of inputs and outputs.
        constants: floats or, as lists of them and arrays, whole numbers.
        types: of tensors that are not float32.
    """
    calls = [re.split(r" = |\(", line.strip().rstrip(")")) for line in nodes.strip().splitlines()]
    made = [helper.make_node(kind, given.split(", "), [out]) for out, kind, given in calls]
    tensors = {
        name: helper.make_tensor_value_info(name, (types or {}).get(name, TensorProto.FLOAT), shape)
        for name, shape in shapes.items()
    }
    arrays = {name: np.asarray(value) for name, value in constants.items()}
    weights = [
        numpy_helper.from_array(a.astype(np.float32) if a.dtype.kind == "f" else a, name)
        for name, a in arrays.items()
    ]
    outputs = [tensor for name, tensor in tensors.items() if name not in inputs]
    graph = helper.make_graph(made, "toy", [tensors[name] for name in inputs], outputs, weights)
    save(path, graph, metadata)


def save(path: Path, graph: Any, metadata: Sequence[tuple[str, str]] = ()) -> None:
    """Write a graph with metadata pairs as they are, repeated keys included."""
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)])
    model.ir_version = 8
    for key, value in metadata:
        entry = model.metadata_props.add()
        entry.key, entry.value = key, value
    path.parent.mkdir(parents=True, exist_ok=True)
    onnx.save(model, str(path))


def toy_values(**changes: Any) -> dict[str, Any]:
    """Values of a valid `policy.yaml` for four joints with 15 inputs; `None` removes a key."""
    values: dict[str, Any] = {
        "schema": "unicon.policy/1",
        "name": "toy",
        "onnx": "policy.onnx",
        "period": 0.02,
        "joints": list(JOINTS),
        "default_joint_pos": [0.1, 0.2, 0.3, 0.4],
        "action": {"scale": 0.25},
        "stiffness": [10.0, 20.0, 30.0, 40.0],
        "damping": [1.0, 2.0, 3.0, 4.0],
        "observation": {
            "terms": [
                {"name": "ang_vel", "state": "base_ang_vel", "scale": 0.25},
                {"name": "joint_pos", "state": "joint_pos", "subtract": "default_joint_pos"},
                {"name": "joint_vel", "state": "joint_vel", "scale": 0.05},
                {"name": "last_action", "state": "action"},
            ]
        },
    }
    values.update(changes)
    return {key: value for key, value in values.items() if value is not None}


def write_toy(folder: Path, values: Mapping[str, Any] | None = None, inputs: int = 15) -> Path:
    """Write `policy.yaml` and its network; return the file."""
    folder.mkdir(parents=True, exist_ok=True)
    if not (folder / "policy.onnx").exists():
        write_linear(folder / "policy.onnx", inputs, 4)
    path = folder / "policy.yaml"
    path.write_text(yaml.safe_dump(toy_values() if values is None else dict(values)), "utf-8")
    return path
