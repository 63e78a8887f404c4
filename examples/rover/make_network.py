"""Writes the rover's network: a linear map that closes its loops on gyroscope and wheel speeds.

    python make_network.py      (pip install onnx)

An action of 1 is 1 m/s of a wheel's rim. With s and d, half the sum and half the difference of the
right and the left one, and h, half the distance of the wheels:

    s = s_before + 0.3 (vx − half the sum of the rims' speeds)       follows the forward speed
    d = d_before + 0.3 h (wz − gyroscope)                            and the turn
    mast = 0.4 wz                                                    looks where it drives
"""

import sys
from pathlib import Path

import numpy as np
from onnx import TensorProto, checker, helper, numpy_helper, save

HALF_TRACK = 0.18  # [m]
GAIN = 0.3

OUT = Path(__file__).parent / "policy" / "policy.onnx"
FLOAT = TensorProto.FLOAT
# Inputs: vx, vy, wz; gyroscope z; rims left, right [m/s]; last action: left, right, mast.
s = np.array([GAIN, 0, 0, 0, -GAIN / 2, -GAIN / 2, 0.5, 0.5, 0])
d = np.array([0, 0, GAIN * HALF_TRACK, -GAIN * HALF_TRACK, 0, 0, -0.5, 0.5, 0])
mast = np.array([0, 0, 0.4, 0, 0, 0, 0, 0, 0])


def write(out: Path) -> None:
    """Write the network."""
    weights = np.stack([s - d, s + d, mast], axis=1).astype(np.float32)
    graph = helper.make_graph(
        [helper.make_node("MatMul", ["obs", "weights"], ["actions"])],
        "rover",
        [helper.make_tensor_value_info("obs", FLOAT, [1, len(s)])],
        [helper.make_tensor_value_info("actions", FLOAT, [1, 3])],
        [numpy_helper.from_array(weights, "weights")],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    checker.check_model(model)
    save(model, out)
    print(f"{out.name}: {out.stat().st_size} bytes")


if __name__ == "__main__":
    write(Path(sys.argv[1]) if len(sys.argv) > 1 else OUT)
