"""Values that a block may remember: copied in the tick, written as JSON, read back to the bit.

Numbers, texts, arrays, and lists, tuples, sets, dictionaries and queues of them. Nothing of a file
is run or imported: what is not one of these is not read back.
"""

from __future__ import annotations

import base64
import math
import random
import sys
from collections import deque
from enum import Enum
from typing import Any

import numpy as np

from unicon_core.errors import StateError

__all__ = ["ATOMS", "NotPlain", "copied", "from_json", "put", "to_json"]

ATOMS = frozenset({type(None), bool, int, float, complex, str, bytes})
"""Types whose values cannot change."""

_WRONG = (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError, ValueError)


class NotPlain(Exception):
    """An object that has parts of its own."""


def copied(value: Any) -> Any:
    """Return a value that does not change when the block goes on.

    Raises:
        NotPlain: it is, or holds, an object of another kind.
    """
    kind = type(value)
    if kind in ATOMS:
        return value
    if kind is np.ndarray:
        if value.dtype.hasobject:
            raise NotPlain
        return value.copy()
    if kind in (list, tuple, set, frozenset):
        return kind(map(copied, value))
    if kind is dict:
        return {copied(key): copied(each) for key, each in value.items()}
    if kind is deque:
        return deque(map(copied, value), value.maxlen)
    if kind is bytearray:
        return bytearray(value)
    if isinstance(value, (np.generic, Enum)):
        return value
    # Its import takes 10 ms of every start, and without it there is none.
    if "numpy.random" in sys.modules and isinstance(value, np.random.Generator):
        return _State(value.bit_generator.state)
    if isinstance(value, random.Random):
        return _State(value.getstate())
    if isinstance(value, _State):
        return value
    raise NotPlain


class _State:
    """The state of a generator of random numbers."""

    def __init__(self, state: Any) -> None:
        self.state = copied(state)


def to_json(value: Any) -> Any:
    """Return a value of `copied` as what JSON can write, without loss of a bit."""
    kind = type(value)
    if kind in (type(None), bool, int, str):
        return value
    if kind is float:
        return value if math.isfinite(value) else {"float": repr(value)}
    if kind is complex:
        return {"complex": [to_json(value.real), to_json(value.imag)]}
    if isinstance(value, (bytes, bytearray)):
        return {kind.__name__: _text(value)}
    if isinstance(value, (np.ndarray, np.generic)):
        array = np.asarray(value)
        content = {"dtype": array.dtype.str, "shape": list(array.shape), "data": _text(array)}
        return {"array" if isinstance(value, np.ndarray) else "scalar": content}
    if isinstance(value, Enum):
        return {"enum": [type(value).__qualname__, value.name]}
    if isinstance(value, _State):
        return {"random": to_json(value.state)}
    if kind is dict:
        return {"dict": [[to_json(key), to_json(each)] for key, each in value.items()]}
    elements = [to_json(each) for each in value]
    return {"deque": [elements, value.maxlen]} if kind is deque else {kind.__name__: elements}


def from_json(value: Any) -> Any:
    """Read back what `to_json` returned; enumerations and random states as pairs for `put`.

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
    ((kind, content),) = value.items()
    if kind == "float":
        return float(content)
    if kind == "complex":
        return complex(*map(_read, content))
    if kind in ("bytes", "bytearray"):
        raw = base64.b64decode(content, validate=True)
        return raw if kind == "bytes" else bytearray(raw)
    if kind in ("array", "scalar"):
        dtype = np.dtype(content["dtype"])
        flat = np.frombuffer(base64.b64decode(content["data"], validate=True), dtype)
        array = flat.reshape(content["shape"]).copy()
        return array if kind == "array" else array[()]
    if kind == "dict":
        return {_read(key): _read(each) for key, each in content}
    if kind == "deque":
        return deque(map(_read, content[0]), content[1])
    if kind == "enum":
        return _Member(*content)
    if kind == "random":
        return _State(_read(content))
    return {"list": list, "tuple": tuple, "set": set, "frozenset": frozenset}[kind](
        map(_read, content)
    )


class _Member:
    """A member of an enumeration, by name: the class is that of what stands there now."""

    def __init__(self, kind: str, name: str) -> None:
        self.kind, self.name = kind, name


def put(owner: Any, key: Any, value: Any) -> None:
    """Set what an owner holds; arrays, lists and the like in place, since others may share them.

    Raises:
        ValueError: an enumeration or generator of random numbers of another kind stands there.
    """
    try:
        there = owner[key]
    except LookupError:
        there = None
    if isinstance(value, _Member):
        if not isinstance(there, Enum) or type(there).__qualname__ != value.kind:
            raise ValueError(f"there is no {value.kind} there")
        owner[key] = type(there)[value.name]
    elif isinstance(value, _State):
        if isinstance(there, np.random.Generator):
            there.bit_generator.state = value.state
        elif isinstance(there, random.Random):
            there.setstate(value.state)
        else:
            raise ValueError("there is no generator of random numbers there")
    elif type(there) is not type(value) or type(value) in ATOMS:
        owner[key] = value
    elif isinstance(value, np.ndarray) and (there.shape, there.dtype) == (value.shape, value.dtype):
        there[...] = value
    elif isinstance(value, (list, bytearray)):
        there[:] = value
    elif isinstance(value, (dict, set)) or (isinstance(value, deque) and not value.maxlen):
        there.clear()
        (there.extend if isinstance(value, deque) else there.update)(value)
    else:
        owner[key] = value


def _text(data: Any) -> str:
    raw = data.tobytes() if isinstance(data, np.ndarray) else bytes(data)
    return base64.b64encode(raw).decode()
