"""What an ONNX file says about itself, read from its bytes, for importers and checks.

A small reader of the protobuf wire format (onnx/onnx.proto3 gives the field numbers), because
onnxruntime shows metadata as a map that silently keeps the last of two equal keys, and because a
file can so be judged before any session is built. Weights are skipped, not read.
"""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import prod
from pathlib import Path
from typing import Any, Protocol, TypeAlias, runtime_checkable

from unicon_base.arrays import Array
from unicon_base.errors import PolicyError
from unicon_base.located_yaml import is_lfs_pointer


@dataclass(frozen=True)
class Tensor:
    """An input or output: `shape` has an int for a fixed axis and a name (or "") for a free one."""

    name: str
    dtype: str
    shape: tuple[int | str, ...]

    @property
    def free_batch(self) -> bool:
        """Whether the first axis takes any length."""
        return bool(self.shape) and not isinstance(self.shape[0], int)

    @property
    def fixed(self) -> tuple[int, ...]:
        """The shape for one robot: free axes have length 1."""
        return tuple(axis if isinstance(axis, int) else 1 for axis in self.shape)

    @property
    def row(self) -> tuple[int | str, ...]:
        """Axes of one robot: all but the first one, which vectors and scalars have not."""
        return self.shape[1:] if len(self.shape) > 1 else self.shape

    @property
    def size(self) -> int:
        """Number of values of one robot where free axes have length 1."""
        return prod(axis for axis in self.row if isinstance(axis, int))

    @property
    def width(self) -> int | str:
        """Number of values of one robot, or the name of a free axis."""
        return next((axis for axis in self.row if isinstance(axis, str)), self.size)

    def takes(self, size: int) -> bool:
        """Whether it takes this many values of one robot; one free axis takes what is left."""
        fixed, free = self.size, sum(isinstance(axis, str) for axis in self.row)
        return size == fixed if free == 0 else free == 1 and fixed > 0 and size % fixed == 0

    def shaped(self, rows: Array) -> Array:
        """Return a view of contiguous rows, shape (n, …), with the axes of the tensor."""
        if len(self.shape) < 2:
            return rows.reshape(-1 if self.shape else ())
        axes = [axis if isinstance(axis, int) else -1 for axis in self.row]
        return rows.reshape(len(rows), *axes) if axes.count(-1) < 2 else rows

    def __str__(self) -> str:
        axes = " × ".join(str(axis) or "?" for axis in self.shape)
        return f"{self.name} ({axes or 'scalar'}, {self.dtype})"


Arrays: TypeAlias = Mapping[str, Array]
"""Tensors' names to what they are bound to."""


class Network(Protocol):
    """A network that can be bound to arrays."""

    inputs: tuple[Tensor, ...]
    outputs: tuple[Tensor, ...]

    def bind(self, inputs: Arrays, outputs: Arrays) -> Callable[[], None]:
        """Return a function that reads `inputs` and writes `outputs`, which stay where they are.

        Where the network remembers inside itself, the function is `Remembering`.
        """
        ...


@runtime_checkable
class Remembering(Protocol):
    """A bound network with a memory of its own: a call begins with what was kept last."""

    def __call__(self) -> None:
        """Run the network; what it remembers of this is lost unless it is kept."""
        ...

    def commit(self) -> None:
        """Keep what the last call left."""
        ...

    def reset(self) -> None:
        """Keep what the network was loaded with."""
        ...


_Message: TypeAlias = defaultdict[int, list[Any]]
"""Number of a field -> its values, numbers and views of bytes: what has the other kind than the one
that is asked for raises a TypeError or AttributeError."""

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
                    f"{self.path}: metadata key {key!r} stands twice, as "
                    f"{short_text(result[key])} and as {short_text(value)}; export the policy "
                    "again with one of them"
                )
            result[key] = value
        return result

    def lost_weights(self) -> str:
        """Return where weights are that are not beside the model, and the remedy, "" for none."""
        folder = self.path.parent
        lost = next((name for name in self.external if not os.path.isfile(folder / name)), "")
        return lost and f"are in {lost}, which is not beside it; copy {lost} to {folder}"


def read_onnx(path: Path) -> OnnxFile:
    """Read inputs, outputs, metadata and the names of external files of an ONNX model.

    Raises:
        PolicyError: no such file, or it is not an ONNX model.
    """
    if path.suffix == ".mnn":
        text = "is a network for MNN, which cannot be run here; export the trained network as ONNX"
        raise PolicyError(f"{path}: {text} (torch.onnx.export)")
    if not os.path.isfile(path):
        raise PolicyError(f"{path}: no such ONNX file; put it there or correct the path")
    data = path.read_bytes()
    try:
        return _model(path, memoryview(data))
    except (IndexError, ValueError, TypeError, AttributeError) as error:
        text = "not an ONNX model, or cut off; copy it again"
        if is_lfs_pointer(path):
            text = "a Git LFS pointer, not the model; run 'git lfs pull' there"
        raise PolicyError(f"{path}: {text}") from error


def _model(path: Path, data: memoryview) -> OnnxFile:
    model = _message(data)
    graph = _message(_last(model, 7))
    initializers = [_message(value) for value in graph[5]]
    named = {_text(initializer, 8) for initializer in initializers}
    about = [_pair(value) for initializer in initializers for value in initializer[13]]
    outputs = tuple(_tensor(value) for value in graph[12])
    if not outputs:
        raise ValueError("no output")
    return OnnxFile(
        path,
        tuple(_pair(value) for value in model[14]),
        tuple(tensor for tensor in map(_tensor, graph[11]) if tensor.name not in named),
        outputs,
        tuple(dict.fromkeys(name for key, name in about if key == "location")),
    )


def _message(data: Any) -> _Message:
    """Return field number to values; lengths are views, so that weights are never copied."""
    fields = _Message(list)
    position, end = 0, len(data)
    while position < end:
        tag, position = _varint(data, position)
        wire = tag & 7
        if wire == 0:
            value, position = _varint(data, position)
            fields[tag >> 3].append(value)
        elif wire in (1, 5):
            position += 8 if wire == 1 else 4
        elif wire == 2:
            size, position = _varint(data, position)
            if position + size > end:
                raise ValueError("cut off")
            fields[tag >> 3].append(data[position : position + size])
            position += size
        else:
            raise ValueError(f"wire type {wire}")
    return fields


def _varint(data: memoryview, position: int) -> tuple[int, int]:
    result = 0
    for shift in range(0, 70, 7):
        byte = data[position]
        position += 1
        result |= (byte & 0x7F) << shift
        if byte < 0x80:
            return result, position
    raise ValueError("varint")


def _last(message: _Message, number: int) -> Any:
    """Return the value of a field, of which the last one counts; empty where it is absent."""
    return (message[number] or [memoryview(b"")])[-1]


def _text(message: _Message, number: int) -> str:
    return str(_last(message, number).tobytes(), "utf-8")


def _pair(data: Any) -> tuple[str, str]:
    pair = _message(data)
    return _text(pair, 1), _text(pair, 2)


def _tensor(data: Any) -> Tensor:
    value = _message(data)
    kind = _message(_last(_message(_last(value, 2)), 1))
    element, axes = _last(kind, 1), _message(_last(kind, 2))[1]
    dtype = "unknown"
    if isinstance(element, int):
        dtype = _ELEMENT_TYPES.get(element, f"type {element}")
    return Tensor(_text(value, 1), dtype, tuple(map(_axis, axes)))


def _axis(data: Any) -> int | str:
    axis = _message(data)
    size = _last(axis, 1)
    return size if isinstance(size, int) else _text(axis, 2)


def short_text(text: str) -> str:
    """Return a text in quotes, cut where it is long."""
    return repr(text if len(text) <= 60 else f"{text[:59]}…")
