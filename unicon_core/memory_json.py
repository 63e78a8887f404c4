"""A memory in files: snapshots as JSON, without the loss of a bit, and what of them has changed."""

from __future__ import annotations

import base64
import math
from collections import deque
from typing import Any

import numpy as np

from unicon_base.errors import StateError
from unicon_core.memory import (
    ATOMS,
    Component,
    EnumMember,
    FromLibrary,
    GeneratorState,
    Snapshot,
)

_WRONG = (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError)
_SAME: Any = object()

_NAMED: dict[str, Any] = {
    "snapshot": Snapshot,
    "component": Component,
    "library": FromLibrary,
    "generator": GeneratorState,
    "member": EnumMember,
    "list": list,
    "tuple": tuple,
    "deque": deque,
    "dict": dict,
}
_NAMES = {kind: name for name, kind in _NAMED.items()}


def to_json(value: Any) -> Any:
    """Return a snapshot, or a value of one, as JSON can write it, without the loss of a bit."""
    kind = type(value)
    if kind is float:
        return value if math.isfinite(value) else {"float": repr(value)}
    if kind in ATOMS:
        return value
    if isinstance(value, (np.ndarray, np.generic)):
        array = np.asarray(value)
        data = base64.b64encode(array.tobytes()).decode()
        content = {"dtype": array.dtype.str, "shape": list(array.shape), "data": data}
        return {"array" if kind is np.ndarray else "scalar": content}
    name = _NAMES[kind]
    if isinstance(value, dict):
        return {name: [[to_json(key), to_json(each)] for key, each in value.items()]}
    elements = [to_json(each) for each in value]
    return {name: [elements, value.maxlen] if kind is deque else elements}


def from_json(value: Any) -> Any:
    """Read what `to_json` returned. Nothing of it is imported or run.

    Raises:
        StateError: it is something else.
    """
    try:
        return _read(value)
    except _WRONG as error:
        raise StateError(f"not a memory of blocks: {error}; write it with to_json") from error


def _read(value: Any) -> Any:
    if not isinstance(value, dict):
        if type(value) not in ATOMS:
            raise ValueError(f"{value!r} stands in it")
        return value
    ((name, content),) = value.items()
    if name == "float":
        return float(content)
    if name in ("array", "scalar"):
        dtype = np.dtype(content["dtype"])
        flat = np.frombuffer(base64.b64decode(content["data"], validate=True), dtype)
        array = flat.reshape(content["shape"]).copy()
        return array if name == "array" else array[()]
    if name == "deque":
        return deque(map(_read, content[0]), content[1])
    kind = _NAMED[name]
    if issubclass(kind, dict):
        return kind((_read(key), _read(each)) for key, each in content)
    return kind(map(_read, content))


def changes(snapshot: Snapshot, built: Snapshot) -> Snapshot:
    """Return what of a snapshot is not as it was when the blocks had just been built.

    A replay with another option restores nothing that the option alone decides.
    """
    found = _changes(snapshot, built)
    return Snapshot() if found is _SAME else found


def _changes(snapshot: Any, built: Any) -> Any:
    if isinstance(snapshot, (Component, Snapshot)) and type(built) is type(snapshot):
        found = {name: _changes(each, built.get(name)) for name, each in snapshot.items()}
        kept = {name: each for name, each in found.items() if each is not _SAME}
        return type(snapshot)(kept) if kept or not snapshot else _SAME
    return _SAME if to_json(snapshot) == to_json(built) else snapshot
