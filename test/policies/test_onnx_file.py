"""What the small protobuf reader sees is what onnx itself sees."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper
from policy_helpers import save, write_linear

from unicon_base.errors import PolicyError
from unicon_core.policies.networks.onnx_file import read_onnx


def agree(path: Path) -> None:
    model = onnx.load(str(path), load_external_data=False)
    file = read_onnx(path)
    assert file.metadata == tuple((p.key, p.value) for p in model.metadata_props)
    weights = {tensor.name for tensor in model.graph.initializer}
    for mine, theirs in ((file.inputs, model.graph.input), (file.outputs, model.graph.output)):
        expected = [value for value in theirs if value.name not in weights]
        assert [tensor.name for tensor in mine] == [value.name for value in expected]
        for tensor, value in zip(mine, expected):
            dims = value.type.tensor_type.shape.dim
            assert tensor.shape == tuple(d.dim_param or d.dim_value for d in dims)
    named = [
        entry.value
        for tensor in model.graph.initializer
        for entry in tensor.external_data
        if entry.key == "location"
    ]
    assert list(file.external) == list(dict.fromkeys(named))


def test_reader_agrees_with_onnx_on_the_assets(assets: Path) -> None:
    for path in sorted((assets / "policies").glob("*/*.onnx")):
        agree(path)


def test_reader_agrees_with_onnx_on_types_free_axes_and_metadata(tmp_path: Path) -> None:
    names = {"h": TensorProto.FLOAT, "k": TensorProto.INT64, "b": TensorProto.BOOL}
    inputs = [helper.make_tensor_value_info(n, t, ["N", 3, 4]) for n, t in names.items()]
    inputs.append(helper.make_tensor_value_info("w", TensorProto.FLOAT, [2]))
    outputs = [helper.make_tensor_value_info(f"{n}2", t, ["N", 3, 4]) for n, t in names.items()]
    nodes = [helper.make_node("Identity", [n], [f"{n}2"]) for n in names]
    graph = helper.make_graph(
        nodes, "g", inputs, outputs, [numpy_helper.from_array(np.zeros(2, np.float32), "w")]
    )
    path = tmp_path / "x.onnx"
    save(path, graph, [("a", "1"), ("ü", "größer"), ("a", "1")])
    agree(path)
    file = read_onnx(path)
    assert [tensor.dtype for tensor in file.inputs] == ["float32", "int64", "bool"]
    assert file.inputs[0].free_batch
    assert str(file.inputs[1]) == "k (N × 3 × 4, int64)"
    assert file.unique_metadata() == {"a": "1", "ü": "größer"}


def test_a_key_twice_is_refused_with_both_values(tmp_path: Path) -> None:
    path = tmp_path / "x.onnx"
    write_linear(path, 3, 2, metadata=[("observation_names", "a,b"), ("observation_names", "b,a")])
    with pytest.raises(PolicyError) as caught:
        read_onnx(path).unique_metadata()
    assert str(caught.value) == (
        f"{path}: metadata key 'observation_names' stands twice, as 'a,b' and as 'b,a'; "
        "export the policy again with one of them"
    )


@pytest.mark.parametrize("data", [b"", b"hello world", b"\x00" * 40, b"\x3a\xff\xff\xff\x7f"])
def test_a_file_that_is_no_model_is_refused(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "x.onnx"
    path.write_bytes(data)
    with pytest.raises(PolicyError) as caught:
        read_onnx(path)
    assert str(caught.value) == f"{path}: not an ONNX model, or cut off; copy it again"


def test_a_model_cut_anywhere_is_refused_or_says_less(tmp_path: Path) -> None:
    whole = tmp_path / "whole.onnx"
    write_linear(whole, 3, 2, metadata=[("joint_names", "a,b")])
    data = whole.read_bytes()
    path = tmp_path / "cut.onnx"
    for size in range(len(data)):
        path.write_bytes(data[:size])
        try:
            file = read_onnx(path)
        except PolicyError:
            continue
        assert file.outputs[0].name == "actions"


def test_a_git_lfs_pointer_is_recognised(tmp_path: Path) -> None:
    path = tmp_path / "x.onnx"
    path.write_bytes(b"version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 1\n")
    with pytest.raises(PolicyError) as caught:
        read_onnx(path)
    assert str(caught.value) == (
        f"{path}: a Git LFS pointer, not the model; run 'git lfs pull' there"
    )


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    path = tmp_path / "x.onnx"
    with pytest.raises(PolicyError) as caught:
        read_onnx(path)
    assert str(caught.value) == f"{path}: no such ONNX file; put it there or correct the path"


def test_importing_policies_loads_neither_onnxruntime_nor_mujoco_nor_torch() -> None:
    code = (
        "import sys, unicon_core.policies\n"
        "loaded = {'onnxruntime', 'onnx', 'mujoco', 'torch', 'rclpy'} & set(sys.modules)\n"
        "assert not loaded, loaded"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)
