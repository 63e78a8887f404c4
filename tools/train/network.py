"""The shipped Go2 network as ONNX, node by node, for export.py: the integral, then the actor.

Opset 13, IR 8: accepted by onnxruntime >= 1.17. `integral.Integral` is what the nodes before the
actor compute; `test/test_go2_integral.py` holds both equal.
"""

from __future__ import annotations

import contract
import integral
import numpy as np
import onnx
from env import COMMAND_HIGH, COMMAND_LOW
from onnx import TensorProto, helper, numpy_helper

Weights = integral.Weights


class Graph:
    """Nodes and constants, each named by what it gives."""

    def __init__(self) -> None:
        self.nodes: list[onnx.NodeProto] = []
        self.constants: list[onnx.TensorProto] = []

    def constant(self, name: str, value: object, kind: type = np.float32) -> None:
        self.constants.append(numpy_helper.from_array(np.asarray(value, kind), name))

    def node(self, kind: str, inputs: str, outputs: str, **attributes: object) -> None:
        """Values are named in one text each."""
        name = outputs.split()[0]
        made = helper.make_node(kind, inputs.split(), outputs.split(), name, **attributes)
        self.nodes.append(made)

    def layers(self, name: str, given: str, result: str, weights: Weights) -> None:
        """Gemm nodes with Elu between them."""
        for i, (weight, bias) in enumerate(weights):
            self.constant(f"{name}_weight_{i}", weight)
            self.constant(f"{name}_bias_{i}", bias)
            last = i == len(weights) - 1
            out = result if last else f"{name}_linear_{i}"
            names = f"{given} {name}_weight_{i} {name}_bias_{i}"
            self.node("Gemm", names, out, transB=1)
            if not last:
                given = f"{name}_elu_{i}"
                self.node("Elu", out, given)


def velocity(graph: Graph, weights: Weights) -> None:
    """`frames` and `felt` -> `velocity`: weights of 0 where the estimate is not to look."""
    (first, bias), *between, (last, last_bias) = weights
    seen = np.zeros((len(first), integral.FRAMES * contract.NUM_OBS))
    seen[:, integral.SEEN] = first
    gyro = np.zeros((contract.NUM_OBS, 3))
    gyro[2, 2] = 1.0 / contract.OBS_SCALE[2] / integral.UNIT[2]
    graph.constant("gyro", gyro)
    graph.constant("velocity_bias", [*last_bias, 0.0])
    graph.constant("velocity_weight", np.concatenate([last, np.zeros((1, last.shape[1]))]))
    graph.layers("estimate", "frames", "hidden_linear", [(seen, bias), *between])
    graph.node("Elu", "hidden_linear", "hidden")
    graph.node("Gemm", "felt gyro velocity_bias", "turn")
    graph.node("Gemm", "hidden velocity_weight turn", "velocity", transB=1)


def tell(graph: Graph, weights: Weights) -> None:
    """`felt` and `memory` -> `told` and `next_memory`; felt is what flat ground needs of `obs`."""
    scale = contract.OBS_SCALE[integral.COMMAND] * integral.UNIT
    pick = np.zeros((contract.NUM_OBS, 3))
    pick[integral.COMMAND] = np.diag(1.0 / scale)
    put = np.zeros((3, contract.NUM_OBS))
    put[:, integral.COMMAND] = np.diag(scale)
    past = integral.PAST.stop - integral.PAST.start
    for name, value in {
        "pick": pick,
        "put": put,
        "lag": contract.PERIOD / integral.LAG,
        "gain": contract.PERIOD * integral.GAIN,
        "forget": contract.PERIOD * integral.FORGET,
        "one": 1.0,
        "nothing": 0.0,
        "still": integral.STILL,
        "noticed_low": -integral.NOTICED,
        "noticed_high": integral.NOTICED,
        "held_low": -integral.LARGEST,
        "held_high": integral.LARGEST,
        "command_low": COMMAND_LOW / integral.UNIT,
        "command_high": COMMAND_HIGH / integral.UNIT,
    }.items():
        graph.constant(name, value)
    for name, whole in {"parts": [3, 3, past], "begin": [0], "end": [past], "axis": [1]}.items():
        graph.constant(name, whole, np.int64)
    node = graph.node
    node("Split", "memory parts", "reference_before held_before past", axis=1)
    node("Concat", "felt past", "frames", axis=1)
    velocity(graph, weights)
    node("Gemm", "felt pick", "command")
    node("Sub", "command reference_before", "ahead")
    node("Mul", "ahead lag", "approach")
    node("Add", "reference_before approach", "reference")
    node("Sub", "reference velocity", "error")
    node("Clip", "error noticed_low noticed_high", "noticed")
    node("Mul", "noticed gain", "gained")
    node("Abs", "ahead", "distance")
    node("Mul", "distance forget", "forgotten")
    node("Sub", "one forgotten", "kept")
    node("Mul", "kept held_before", "remembered")
    node("Add", "remembered gained", "integrated")
    node("Clip", "integrated held_low held_high", "bounded")
    node("Abs", "command", "size")
    node("ReduceMax", "size", "largest", axes=[1], keepdims=1)
    node("Greater", "largest still", "is_moving")
    node("Cast", "is_moving", "moving", to=TensorProto.FLOAT)
    node("Mul", "bounded moving", "held")
    node("Add", "command held", "wanted")
    node("Max", "wanted command_low", "not_less")
    node("Min", "not_less command_high", "in_range")
    node("Sub", "in_range command", "more")
    node("Gemm", "more put felt", "told")
    node("Slice", "frames begin end axis", "next_past")
    node("Concat", "reference held next_past", "following", axis=1)
    node("IsNaN", "following", "broken")
    node("Where", "broken nothing following", "next_memory")


def weights_of(model: onnx.ModelProto) -> tuple[Weights, Weights]:
    """Actor and estimate of a network that `build` wrote."""
    value = {each.name: numpy_helper.to_array(each) for each in model.graph.initializer}

    def numbered(name: str) -> Weights:
        found = [key for key in value if key.startswith(f"{name}_weight_")]
        return [(value[key], value[key.replace("weight", "bias")]) for key in found]

    (first, bias), *between = numbered("estimate")
    last = value["velocity_weight"][:2], value["velocity_bias"][:2]
    return numbered("actor"), [(first[:, integral.SEEN], bias), *between, last]


def build(actor: Weights, estimate: Weights) -> onnx.ModelProto:
    """`obs` (batch, n), `memory` (batch, 96) -> `actions` (batch, 12), `next_memory`.

    n is 45, or more for an actor that sees what comes after these as it is.
    """
    graph = Graph()
    num_obs = actor[0][0].shape[1]
    seen = num_obs - contract.NUM_OBS
    if seen:
        graph.constant("obs_parts", [contract.NUM_OBS, seen], np.int64)
        graph.node("Split", "obs obs_parts", "felt scan", axis=1)
    else:
        graph.node("Identity", "obs", "felt")
    tell(graph, estimate)
    if seen:
        graph.node("Concat", "told scan", "input", axis=1)
    graph.layers("actor", "input" if seen else "told", "actions", actor)
    sizes = {"obs": num_obs, "memory": integral.NUM_MEMORY}
    sizes |= {"actions": len(contract.JOINTS), "next_memory": integral.NUM_MEMORY}
    values = [
        helper.make_tensor_value_info(name, TensorProto.FLOAT, ["batch", size])
        for name, size in sizes.items()
    ]
    name = "go2_stairs" if seen else "go2_velocity"
    model = helper.make_model(
        helper.make_graph(graph.nodes, name, values[:2], values[2:], graph.constants),
        opset_imports=[helper.make_opsetid("", 13)],
        ir_version=8,
        producer_name="unicon_ros",
    )
    onnx.checker.check_model(model, full_check=True)
    return model
