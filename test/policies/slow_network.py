"""A network for go2 that takes its time, and can be told to fail, for tests of policies in a child.

`actions, h_out = tanh(obs · w + h_in · u)`; what makes it slow, or fail once vx of the command is
above 0.5 m/s, adds a zero.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import numpy as np
import yaml
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper
from policy_helpers import save

from unicon_core.robots import load_robot

Failing = Literal["", "nan", "raise", "hang"]
TERMS = ("joint_pos", "joint_vel", "velocity_command", "action")
SIZE, JOINTS, VX = 39, 12, 24


def weights() -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """The two matrices, of shape (39, 12) and (12, 12)."""
    random = np.random.default_rng(5)
    return (
        random.normal(size=(SIZE, JOINTS)).astype(np.float32) * np.float32(0.1),
        random.normal(size=(JOINTS, JOINTS)).astype(np.float32) * np.float32(0.1),
    )


def turning(count: str, what: str = "vx") -> list[Any]:
    """Nodes that turn so often around nothing, and leave the result in `turned`."""

    def value(name: str, kind: int) -> Any:
        return helper.make_tensor_value_info(name, kind, [])

    body = helper.make_graph(
        [
            helper.make_node("Identity", ["go"], ["go_on"]),
            helper.make_node("Mul", ["x", "one"], ["x_next"]),
        ],
        "body",
        [
            value("i", TensorProto.INT64),
            value("go", TensorProto.BOOL),
            value("x", TensorProto.FLOAT),
        ],
        [value("go_on", TensorProto.BOOL), value("x_next", TensorProto.FLOAT)],
    )
    return [helper.make_node("Loop", [count, "yes", what], ["turned"], body=body)]


def write_slow(
    folder: Path, *, turns: int = 0, failing: Failing = "", period: float = 0.02
) -> Path:
    """Write the policy; 10,000 turns take some 10 ms.

    Args:
        folder: of it.
        turns: how often it turns around nothing in each call.
        failing: what happens once vx is above 0.5 m/s.
        period: of the policy in [s].
    """
    w, u = weights()
    constants: dict[str, Any] = {
        "w": w,
        "u": u,
        "vx_at": np.int64(VX),
        "one": np.float32(1.0),
        "zero": np.float32(0.0),
        "half": np.float32(0.5),
        "yes": np.bool_(True),
        "turns": np.int64(turns),
        "forever": np.int64(1 << 40),
        "single": np.zeros(1, np.float32),
    }
    nodes = [
        helper.make_node("Gather", ["row", "vx_at"], ["vx"], axis=0),
        helper.make_node("Greater", ["vx", "half"], ["fast"]),
        helper.make_node("Cast", ["fast"], ["fast_int"], to=TensorProto.INT64),
    ]
    if failing == "nan":
        nodes += [
            helper.make_node("Sub", ["half", "vx"], ["below"]),
            helper.make_node("Sqrt", ["below"], ["turned"]),
        ]
    elif failing == "raise":
        nodes += [helper.make_node("Gather", ["single", "fast_int"], ["turned"], axis=0)]
    elif failing == "hang":
        nodes += [helper.make_node("Mul", ["fast_int", "forever"], ["count"]), *turning("count")]
    else:
        nodes += turning("turns")

    def value(name: str, width: int) -> Any:
        return helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, width])

    graph = helper.make_graph(
        [
            helper.make_node("Reshape", ["obs", "flat"], ["row"]),
            *nodes,
            helper.make_node("MatMul", ["obs", "w"], ["a"]),
            helper.make_node("MatMul", ["h_in", "u"], ["b"]),
            helper.make_node("Add", ["a", "b"], ["c"]),
            helper.make_node("Mul", ["turned", "zero"], ["nothing"]),
            helper.make_node("Add", ["c", "nothing"], ["d"]),
            helper.make_node("Tanh", ["d"], ["actions"]),
            helper.make_node("Identity", ["actions"], ["h_out"]),
        ],
        "slow",
        [value("obs", SIZE), value("h_in", JOINTS)],
        [value("actions", JOINTS), value("h_out", JOINTS)],
        [
            numpy_helper.from_array(np.asarray(array), name)
            for name, array in {**constants, "flat": np.array([SIZE], np.int64)}.items()
        ],
    )
    save(folder / "policy.onnx", graph)
    robot = load_robot("go2")
    values = {
        "schema": "unicon.policy/1",
        "name": "slow",
        "onnx": "policy.onnx",
        "period": period,
        "joints": list(robot.joint_names),
        "default_joint_pos": [float(x) for x in robot.default_joint_pos],
        "action": {"scale": 0.1},
        "stiffness": 40.0,
        "damping": 1.0,
        "observation": {"terms": [{"name": state, "state": state} for state in TERMS]},
        "inputs": {"observation": "obs"},
        "outputs": {"action": "actions"},
        "recurrent": [{"input": "h_in", "output": "h_out"}],
    }
    (folder / "policy.yaml").write_text(yaml.safe_dump(values), "utf-8")
    return folder


def workflow(folder: Path, child: Any, **more: Any) -> dict[str, Any]:
    """Return a workflow on platform fake, with the policy in `folder` as `slow`."""
    entry: dict[str, Any] = {"path": str(folder)}
    if child is not None:
        entry["child"] = child
    values: dict[str, Any] = {
        "robot": "go2",
        "platform": "fake",
        "rate": 50,
        "policies": {"slow": entry},
        "commands": [{"velocity_command": {"constant": [0.3, 0.0, 0.0]}}],
        "flow": {"policy": "slow"},
        "safety": ["finite", "joint_limits"],
    }
    return {**values, **more}
