"""Writes the policy's network: a linear map, so that the example needs no training.

    python make_network.py      (pip install onnx)

Of joint positions (2), velocities (2) and the gaze that is wanted (2) it makes positions (2): a
tenth of the way from here to there.
"""

from pathlib import Path

import numpy as np
from onnx import TensorProto, checker, helper, numpy_helper, save

OUT = Path(__file__).parent / "config" / "policies" / "pan_tilt_look" / "policy.onnx"
FLOAT = TensorProto.FLOAT

weights = np.vstack([0.9 * np.eye(2), np.zeros((2, 2)), 0.1 * np.eye(2)]).astype(np.float32)
graph = helper.make_graph(
    [helper.make_node("MatMul", ["obs", "weights"], ["actions"])],
    "pan_tilt_look",
    [helper.make_tensor_value_info("obs", FLOAT, [1, 6])],
    [helper.make_tensor_value_info("actions", FLOAT, [1, 2])],
    [numpy_helper.from_array(weights, "weights")],
)
model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
checker.check_model(model)
save(model, OUT)
print(f"{OUT.name}: {OUT.stat().st_size} bytes")
