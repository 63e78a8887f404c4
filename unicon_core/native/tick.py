"""The native tick: stretches of a compiled graph in C++, called by the Python tick.

The compiler's functions are straight-line Python (`unicon show --source`). What calls blocks with
C++ twins alone, with the branches and counters around them, becomes a function of one library; the
Python function calls it in their place, and all other blocks as before. Counters that a stretch
touches lie in an array that both see. A twin that meets what it leaves to Python calls the block's
own code, on the same memory: what that raises goes on through the stretch.

    native = NativeTick(program.states, warn)
    graph = native.compile(root, trace=True)
"""

from __future__ import annotations

import ctypes
import math
import re
import weakref
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from unicon_core.flow.compiled import CompiledGraph, Lines, indent
from unicon_core.flow.compiler import compile_graph
from unicon_core.flow.nodes import Node
from unicon_core.native.build import NativeError, load, unload
from unicon_core.native.network import compare
from unicon_core.native.operands import BINDING, PRELUDE
from unicon_core.native.pieces import Piece
from unicon_core.native.stretches import Stretches
from unicon_core.states import States

_EXTREMES = np.maximum, np.minimum
_OWN = (
    ("v", "int64_t*"), ("T", "int64_t*"), ("calls", "void**"), ("yes", "void*"), ("no", "void*"),
    ("invoke", "void* (*)(void*)"), ("truth", "int (*)(void*)"), ("counted", "void (*)(void*)"),
    ("dropped", "void (*)(void*)"),
)  # fmt: skip
"""What a library gets besides the arrays of its blocks."""


class NativeTick:
    """Makes ticks native, as far as their blocks have twins.

    Args:
        states: of the program; those of several robots stay in Python.
        warn: takes one line where the tick stays in Python.
    """

    def __init__(self, states: States, warn: Callable[[str], object]) -> None:
        self.states = states
        self._warn: Callable[[str], object] | None = warn

    def compile(self, root: Node, *, trace: bool = False) -> CompiledGraph:
        """Compile a tree as `compile_graph` does; after one warning in Python, where it must."""
        stretches = NativeGraph()
        try:
            if self.states.num_robots is not None:
                raise NativeError("it is for one robot; leave out num_robots or --native")
            return compile_graph(root, trace=trace, native=stretches)
        except NativeError as error:
            stretches.table.undo()
            warn, self._warn = self._warn, None
            if warn is not None:
                warn(f"native tick: {error}; the Python tick runs, with the same commands")
            return compile_graph(root, trace=trace)

    def source(self, root: Node) -> str:
        """Return the C++ of a tree, which cannot run afterwards."""
        stretches = NativeGraph(opens=False)
        compile_graph(root, native=stretches)
        stretches.table.undo()
        return stretches.source


NO_ARGUMENTS = 4
"""METH_NOARGS of Python's stable ABI."""


class _Method(ctypes.Structure):
    """PyMethodDef of Python's stable ABI."""

    _fields_ = [
        ("name", ctypes.c_char_p),
        ("function", ctypes.c_void_p),
        ("flags", ctypes.c_int),
        ("about", ctypes.c_char_p),
    ]


_METHODS: list[_Method] = []
"""All that were made: a function looks at its own when it goes."""


class _Cell(ctypes.Structure):
    """A counter of a graph in the array that native code shares."""

    _fields_ = [("cell_contents", ctypes.c_int64)]


@dataclass
class NativeGraph(Stretches):
    """The native code of one graph, in a library.

    Attributes:
        opens: the library is compiled and loaded; else the graph cannot run.
        source: the C++ text, once the graph is rewritten.
    """

    opens: bool = True
    source: str = ""
    _keep: list[object] = field(default_factory=list)

    def finish(self, every: dict[str, Lines], functions: dict[str, Lines]) -> dict[str, Lines]:
        scope, places = self.scope, self.places
        values = np.zeros(max(len(places), 1), np.int64)
        moved = {name: f"V[{place}]" for name, place in places.items() if name in self.owned}
        for name in [name for name in scope.state if name in moved]:
            values[places[name]] = scope.state.pop(name)
            self.cells[name] = _Cell.from_buffer(values.data, 8 * places[name])
        word = re.compile(rf"\b({'|'.join(map(re.escape, moved)) or 'V'})\b")
        every = {
            name: [word.sub(lambda found: moved.get(found[0], found[0]), line) for line in body]
            for name, body in every.items()
        }
        used = self.used()
        blocks = [
            self.block(name, piece.text or "", piece.call)
            for name, piece in self.texts.items()
            if name in used
        ]
        table = self.table
        own = [
            f"{name} = ({kind})t[{len(table.arrays) + i}];" for i, (name, kind) in enumerate(_OWN)
        ]
        self.source = "\n".join(
            [
                f"// native: {', '.join(map(clean, self.native)) or 'nothing'}",
                *(f"// Python runs {clean(name)}: {why}" for name, why in self.python.items()),
                PRELUDE,
                BINDING,
                *table.declarations,
                *blocks,
                *self.functions,
                'extern "C" void unicon_bind(void* const* t) {',
                *indent([*table.bindings, *own]),
                "}",
                "",
            ]
        )
        self._values = values
        scope.names["V"] = values.data
        scope.functions[:] = [(name, every[name]) for name, _ in scope.functions]
        every["warm_up"] = [*every["warm_up"], "warm()"]
        networks = {n: piece for n, piece in self.texts.items() if piece.owner and n in used}
        stretches = [f"n{number}" for number in range(len(self.functions))]
        calls: dict[str, Any] = dict.fromkeys([*stretches, "warm", *networks], bool)
        self.source += "".join(f"FUNCTION({name})\n" for name in networks)
        if self.opens:
            calls = self._opened(calls)
            for name, piece in networks.items():
                self._replace(piece, calls[name])
        scope.names |= {name: call for name, call in calls.items() if name not in networks}
        return {name: every[name] for name in functions}

    def block(self, name: str, text: str, twin: Callable[[], object]) -> str:
        """Return the function of a block, or of a part of it."""
        body = re.sub("BAIL|PYTHON|WARN", f"return call({self.number(twin)})", text)
        return f"CODE static int64_t {name}() {{\n{body}\nreturn 0;\n}}"

    def _opened(self, calls: dict[str, Any]) -> dict[str, Any]:
        """Compile and load the library, bind it, and return its functions.

        Raises:
            NativeError: it cannot be had, or computes otherwise than NumPy here.
        """
        library = load(self.source)
        weakref.finalize(self, unload, library).atexit = False
        twins = np.array([*map(id, self.calls)], np.int64)
        arrays = [*self.table.arrays, self._values, self.stamps, twins]
        addresses = [array.__array_interface__["data"][0] for array in arrays]
        python = ctypes.pythonapi
        used = "PyObject_CallNoArgs", "PyObject_IsTrue", "Py_IncRef", "Py_DecRef"
        functions = (ctypes.cast(python[name], ctypes.c_void_p).value for name in used)
        addresses += [id(True), id(False), *functions]
        library.unicon_bind((ctypes.c_void_p * len(addresses))(*addresses))
        _compare(library)
        # Functions of the interpreter's own kind, which hold this object: a call takes 30 ns,
        # where ctypes takes 100.
        kinds = ctypes.c_void_p, ctypes.py_object, ctypes.c_void_p
        make = ctypes.PYFUNCTYPE(ctypes.py_object, *kinds)(("PyCFunction_NewEx", python))
        made = {}
        for name in calls:
            address = ctypes.cast(getattr(library, f"python_{name}"), ctypes.c_void_p)
            method = _Method(name.encode(), address, NO_ARGUMENTS, None)
            _METHODS.append(method)
            made[name] = make(ctypes.addressof(method), self, None)
        self._keep += [library, arrays]
        return made

    def _replace(self, piece: Piece, network: Callable[[], object]) -> None:
        """Let a policy run its network by a native function, warm-ups too.

        Raises:
            NativeError: it computes otherwise than Python's.
        """
        if not compare(piece.call, network, *piece.arrays):
            raise NativeError(f"{piece.name} gives other bits by ONNX Runtime's C interface")
        piece.owner.infer = network


def _compare(library: ctypes.PyDLL) -> None:
    """Compare what depends on NumPy's build and on the C library with what the library computes.

    Raises:
        NativeError: they differ here.
    """
    special = [0.0, -0.0, 1.0, -1.5, np.inf, -np.inf, np.nan, 5e-324, 1e-45, 3.4e38]
    doubles = [each.ravel() for each in np.meshgrid(special, special)]
    floats = [each.astype(np.float32) for each in doubles]
    angles = np.linspace(0.0, math.pi, 100)
    cosines = np.array([*map(math.cos, angles.tolist())])
    cases = [(operator(*pair), *pair) for pair in (floats, doubles) for operator in _EXTREMES]
    for way, (expected, first, second) in enumerate([*cases, (cosines, angles, angles)]):
        out = np.empty_like(expected)
        pointers = (ctypes.c_void_p(each.ctypes.data) for each in (first, second, out))
        library.unicon_compare(way, *pointers, ctypes.c_int64(out.size))
        same = (out == expected) & (np.signbit(out) == np.signbit(expected))
        if not (same | (np.isnan(out) & np.isnan(expected))).all():
            raise NativeError("maximum, minimum or cosine differ from C++ on this machine")


def clean(name: str) -> str:
    return re.sub(r"\W", "_", name, flags=re.ASCII)
