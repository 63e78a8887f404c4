"""What an ONNX file says about itself, read from its bytes, for importers and checks.

A small reader of the protobuf wire format (onnx/onnx.proto3 gives the field numbers), because
onnxruntime shows metadata as a map that silently keeps the last of two equal keys, and because a
file can so be judged before any session is built. Weights are skipped, not read.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from unicon_core.errors import PolicyError
from unicon_core.policies.networks.network import Tensor

__all__ = ["OnnxFile", "read_onnx"]

# onnx/onnx.proto3, TensorProto.DataType
_ELEMENT_TYPES = {1: "float32", 6: "int32", 7: "int64", 9: "bool", 10: "float16", 11: "float64"}


@dataclass(frozen=True)
class OnnxFile:
    """The outside of an ONNX model.

    Attributes:
        path: the file.
        metadata: key and value pairs as they stand, repeated keys included.
        inputs: inputs without initializers.
        outputs: outputs.
        external: names of files beside it that hold weights.
    """

    path: Path
    metadata: tuple[tuple[str, str], ...]
    inputs: tuple[Tensor, ...]
    outputs: tuple[Tensor, ...]
    external: tuple[str, ...]

    def unique_metadata(self) -> dict[str, str]:
        """Return the metadata as a mapping.

        Raises:
            PolicyError: a key stands twice with different values; both are named.
        """
        result: dict[str, str] = {}
        for key, value in self.metadata:
            if result.get(key, value) != value:
                raise PolicyError(
                    f"{self.path}: metadata key {key!r} stands twice, as {_short(result[key])} and "
                    f"as {_short(value)}; export the policy again with one of them"
                )
            result[key] = value
        return result

    def missing_external(self) -> list[Path]:
        """Return the files with weights that the model needs and that are not there."""
        paths = [self.path.parent / name for name in self.external]
        return [path for path in paths if not os.path.isfile(path)]


def read_onnx(path: Path) -> OnnxFile:
    """Read inputs, outputs, metadata and the names of external files of an ONNX model.

    Raises:
        PolicyError: no such file, or it is no ONNX model.
    """
    if not os.path.isfile(path):
        raise PolicyError(f"{path}: no such ONNX file; put it there or correct the path")
    data = path.read_bytes()
    try:
        return _model(path, memoryview(data))
    except (IndexError, ValueError) as error:
        if data.startswith(b"version https://git-lfs"):
            raise PolicyError(
                f"{path}: a Git LFS pointer, not the model; run 'git lfs pull' there"
            ) from error
        raise PolicyError(f"{path}: not an ONNX model, or cut off; copy it again") from error


def _model(path: Path, data: memoryview) -> OnnxFile:
    metadata: list[tuple[str, str]] = []
    graph: memoryview | None = None
    for number, value in _fields(data):
        if number == 7 and isinstance(value, memoryview):
            graph = value
        elif number == 14:
            metadata.append(_pair(value))
    if graph is None:
        raise ValueError("no graph")
    inputs: list[Tensor] = []
    outputs: list[Tensor] = []
    initializers: set[str] = set()
    external: dict[str, None] = {}
    for number, value in _fields(graph):
        if number == 5:
            name, files = _initializer(value)
            initializers.add(name)
            external.update(dict.fromkeys(files))
        elif number == 11:
            inputs.append(_tensor(value))
        elif number == 12:
            outputs.append(_tensor(value))
    if not outputs:
        raise ValueError("no output")
    return OnnxFile(
        path,
        tuple(metadata),
        tuple(tensor for tensor in inputs if tensor.name not in initializers),
        tuple(outputs),
        tuple(external),
    )


def _fields(data: memoryview | int) -> Iterator[tuple[int, memoryview | int]]:
    """Yield field number and value; lengths are views, so that weights are never copied."""
    if isinstance(data, int):
        raise ValueError("a number where a message was expected")
    position, end = 0, len(data)
    while position < end:
        tag, position = _varint(data, position)
        wire = tag & 7
        if wire == 0:
            value, position = _varint(data, position)
            yield tag >> 3, value
        elif wire in (1, 5):
            position += 8 if wire == 1 else 4
        elif wire == 2:
            size, position = _varint(data, position)
            if position + size > end:
                raise ValueError("cut off")
            yield tag >> 3, data[position : position + size]
            position += size
        else:
            raise ValueError(f"wire type {wire}")


def _varint(data: memoryview, position: int) -> tuple[int, int]:
    result = shift = 0
    while True:
        byte = data[position]
        position += 1
        result |= (byte & 0x7F) << shift
        if byte < 0x80:
            return result, position
        shift += 7
        if shift > 63:
            raise ValueError("varint")


def _text(value: memoryview | int) -> str:
    if isinstance(value, int):
        raise ValueError("a number where a text was expected")
    return value.tobytes().decode("utf-8")


def _pair(data: memoryview | int) -> tuple[str, str]:
    key = text = ""
    for number, value in _fields(data):
        if number == 1:
            key = _text(value)
        elif number == 2:
            text = _text(value)
    return key, text


def _initializer(data: memoryview | int) -> tuple[str, list[str]]:
    name, files = "", []
    for number, value in _fields(data):
        if number == 8:
            name = _text(value)
        elif number == 13:
            key, text = _pair(value)
            if key == "location":
                files.append(text)
    return name, files


def _tensor(data: memoryview | int) -> Tensor:
    name, dtype = "", "unknown"
    shape: list[int | str] = []
    for number, value in _fields(data):
        if number == 1:
            name = _text(value)
        elif number == 2:
            for kind, tensor in _fields(value):
                if kind != 1:
                    continue
                for field, content in _fields(tensor):
                    if field == 1 and isinstance(content, int):
                        dtype = _ELEMENT_TYPES.get(content, f"type {content}")
                    elif field == 2:
                        shape = [_axis(axis) for k, axis in _fields(content) if k == 1]
    return Tensor(name, dtype, tuple(shape))


def _axis(data: memoryview | int) -> int | str:
    axis: int | str = ""
    for number, value in _fields(data):
        if number == 1 and isinstance(value, int):
            axis = value
        elif number == 2:
            axis = _text(value)
    return axis


def _short(text: str, limit: int = 60) -> str:
    return repr(text if len(text) <= limit else f"{text[: limit - 1]}…")
