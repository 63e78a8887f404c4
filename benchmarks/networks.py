"""Networks and contracts of a given size with random weights, for the benchmarks."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np

from unicon_base.arrays import Float32
from unicon_base.errors import imported
from unicon_core.policies import PolicyContract, load_policy
from unicon_core.robots import Robot

TERMS = (
    "{name: base_ang_vel, state: base_ang_vel, scale: 0.25",
    "{name: projected_gravity, state: projected_gravity",
    "{name: velocity_command, state: velocity_command, scale: 2.0",
    "{name: joint_pos_rel, state: joint_pos, subtract: default_joint_pos",
    "{name: joint_vel_rel, state: joint_vel, scale: 0.05",
    "{name: last_action, state: action",
)
"""The 45 values of a quadruped's velocity policy: legged_gym's, without the base velocity."""

HIDDEN = (512, 256, 128)  # sizes of the hidden layers

CLIP = 100.0
"""legged_gym's bound of an observation."""


def random_policy(
    folder: Path, robot: Robot, history: int = 1, recurrent: bool = False
) -> PolicyContract:
    """Write and load a multilayer perceptron with ELU layers and a dynamic batch axis.

    Args:
        folder: where its two files go.
        robot: its joints are the policy's, in their order.
        history: frames of every term.
        recurrent: whether the last hidden layer adds a product with what it was a tick before.

    Raises:
        MissingDependencyError: the package onnx, which writes the file, is absent.
    """
    onnx = imported("onnx", "unicon bench")
    from onnx import TensorProto, helper, numpy_helper

    n = robot.num_joints
    sizes = [(9 + 3 * n) * history, *HIDDEN, n]
    random = np.random.default_rng(0)
    nodes, weights, last = [], [], "obs"
    for i, (rows, columns) in enumerate(pairwise(sizes)):
        matrix = random.normal(0.0, 0.5 / np.sqrt(rows), (rows, columns)).astype(np.float32)
        weights.append(numpy_helper.from_array(matrix, f"w{i}"))
        weights.append(numpy_helper.from_array(np.zeros(columns, np.float32), f"b{i}"))
        out = f"h{i}" if i < len(HIDDEN) else "actions"
        nodes.append(helper.make_node("Gemm", [last, f"w{i}", f"b{i}"], [out]))
        if i < len(HIDDEN):
            if recurrent and i == len(HIDDEN) - 1:
                weights.append(numpy_helper.from_array(_random_square(columns), "u"))
                nodes.append(helper.make_node("MatMul", ["h_in", "u"], ["before"]))
                nodes.append(helper.make_node("Add", [out, "before"], ["sum"]))
                out = "sum"
            nodes.append(helper.make_node("Elu", [out], [f"e{i}"]))
            last = f"e{i}"
    memory: list[list[object]] = [[], []]
    if recurrent:
        nodes.append(helper.make_node("Identity", [last], ["h_out"]))
        memory = [
            [helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, HIDDEN[-1]])]
            for name in ("h_in", "h_out")
        ]
    graph = helper.make_graph(
        nodes,
        "mlp",
        [helper.make_tensor_value_info("obs", TensorProto.FLOAT, ["batch", sizes[0]]), *memory[0]],
        [helper.make_tensor_value_info("actions", TensorProto.FLOAT, ["batch", n]), *memory[1]],
        weights,
    )
    opsets = [helper.make_opsetid("", 17)]
    folder.mkdir(parents=True, exist_ok=True)
    onnx.save(helper.make_model(graph, opset_imports=opsets, ir_version=8), folder / "policy.onnx")
    frames = f", clip: [{-CLIP}, {CLIP}], history: {history}}}"
    lines = [
        "schema: unicon.policy/1",
        "name: random",
        "onnx: policy.onnx",
        "period: 0.02",
        f"joints: {list(robot.joint_names)}",
        f"default_joint_pos: {[float(x) for x in robot.default_joint_pos]}",
        "action: {scale: 0.25}",
        f"stiffness: {[30.0] * n}",
        f"damping: {[1.0] * n}",
        "inputs: {observation: obs}",
        "outputs: {action: actions}",
        *(["recurrent: [{input: h_in, output: h_out}]"] if recurrent else []),
        "observation:",
        "  terms:",
        *(f"    - {term}{frames}" for term in TERMS),
    ]
    (folder / "policy.yaml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return load_policy(folder, robot=robot)


def _random_square(size: int) -> Float32:
    """Return a random matrix that shrinks what it is multiplied with, shape (size, size)."""
    random = np.random.default_rng(1)
    return random.normal(0.0, 0.5 / np.sqrt(size), (size, size)).astype(np.float32)
