"""ONNX networks by the C interface of ONNX Runtime, from the shared library in its wheel.

The session is a second one, with the settings of `networks/onnx.py`, bound to the same arrays. It
takes the place of Python's after both have given the same bits for random inputs. It goes with the
array of its addresses.
"""

from __future__ import annotations

import ctypes
import json
import weakref
from collections.abc import Mapping
from contextlib import ExitStack
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from unicon_base.arrays import Array, Int64
from unicon_core.native.operands import NotNative

Arrays: TypeAlias = Mapping[str, Array]
VERSION = 12
"""Of the interface; later libraries keep its functions in their places."""
_API = json.loads(Path(__file__).with_name("onnxruntime_api.json").read_text("ascii"))
PLACES: dict[str, int] = _API["places"]
"""Functions that are used, by their place in the table of the interface (OrtApi)."""
RELEASES: dict[str, int] = _API["releases"]
"""The place of what releases an object, by the function that gives it."""
TYPES = {"float32": 1, "int32": 6, "int64": 7, "bool": 9, "float64": 11}
SEVERE = 3
"""Log level of errors."""
OPTIONS = {
    "SetIntraOpNumThreads": 1, "SetInterOpNumThreads": 1, "SetSessionExecutionMode": 0,
    "SetSessionLogSeverityLevel": SEVERE,
}  # fmt: skip
SPINNING = "session.intra_op.allow_spinning"


@lru_cache(maxsize=1)
def _table() -> Any:
    """Return the table of the interface.

    Raises:
        NotNative: there is no library, or it has no such interface.
    """
    import onnxruntime

    folder = Path(onnxruntime.__file__).parent / "capi"
    found = sorted(folder.glob("libonnxruntime.so*"))
    if not found:
        raise NotNative("a network of ONNX Runtime without a shared library")
    try:
        base = ctypes.CDLL(str(found[0])).OrtGetApiBase
    except (OSError, AttributeError) as error:
        raise NotNative(f"a network of ONNX Runtime that does not load: {error}") from error
    base.restype = ctypes.POINTER(ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_uint32))
    table = base()[0](VERSION)
    if not table:
        raise NotNative("a network of an ONNX Runtime without this interface")
    return ctypes.cast(table, ctypes.POINTER(ctypes.c_void_p))


def _call(name: str, *arguments: Any) -> None:
    if ctypes.CFUNCTYPE(ctypes.c_void_p)(_table()[PLACES[name]])(*arguments):
        raise NotNative(f"a network for which ONNX Runtime refuses {name}")


def _made(made: ExitStack, name: str, *arguments: Any) -> ctypes.c_void_p:
    """Call a function that gives an object, which the stack releases."""
    out = ctypes.c_void_p()
    _call(name, *arguments, ctypes.byref(out))
    made.callback(ctypes.CFUNCTYPE(None, ctypes.c_void_p)(_table()[RELEASES[name]]), out)
    return out


@lru_cache(maxsize=1)
def _environment() -> ctypes.c_void_p:
    return _made(ExitStack(), "CreateEnv", SEVERE, b"unicon")


def open_session(path: Path, inputs: Arrays, outputs: Arrays) -> Int64:
    """Return the addresses of what runs a network on some arrays, shape (3,).

    They are those of the function, the session and the binding, which live as long as this array.

    Args:
        path: of the model; it runs in one thread.
        inputs: name to contiguous array.
        outputs: likewise.

    Raises:
        NotNative: it cannot be had so.
    """
    with ExitStack() as made:
        options = _made(made, "CreateSessionOptions")
        for name, setting in OPTIONS.items():
            _call(name, options, setting)
        _call("AddSessionConfigEntry", options, SPINNING.encode(), b"0")
        session = _made(made, "CreateSession", _environment(), str(path).encode(), options)
        binding = _made(made, "CreateIoBinding", session)
        memory = _made(made, "CreateCpuMemoryInfo", 0, 0)
        for bind, arrays in (("BindInput", inputs), ("BindOutput", outputs)):
            for name, array in arrays.items():
                if array.dtype.name not in TYPES:
                    raise NotNative(f"a network with {array.dtype}")
                value = _made(
                    made, "CreateTensorWithDataAsOrtValue", memory,
                    ctypes.c_void_p(array.ctypes.data), ctypes.c_size_t(array.nbytes),
                    (ctypes.c_int64 * array.ndim)(*array.shape), ctypes.c_size_t(array.ndim),
                    TYPES[array.dtype.name],
                )  # fmt: skip
                _call(bind, binding, name.encode(), value)
        found = np.array([_table()[PLACES["RunWithBinding"]], session.value, binding.value])
        weakref.finalize(found, made.pop_all().close).atexit = False
    return found


def compare(one: Any, other: Any, inputs: Arrays, outputs: Arrays) -> bool:
    """Return whether two functions write the same bits; the arrays keep their values."""
    arrays = [*inputs.values(), *outputs.values()]
    before = [array.copy() for array in arrays]
    random = np.random.default_rng(0)
    same = True
    for _ in range(3):
        for array in inputs.values():
            array[...] = random.normal(size=array.shape)
        found = []
        for function in (one, other):
            function()
            found.append([array.tobytes() for array in outputs.values()])
        same &= found[0] == found[1]
    for array, values in zip(arrays, before):
        array[...] = values
    return same
