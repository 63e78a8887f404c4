"""The native tick: stretches of a compiled graph in C++, called by the Python tick.

The compiler's functions are straight-line Python (`unicon show --source`). What calls blocks with
C++ twins alone, with the branches and counters around them, becomes a function of one library; the
Python function calls it in their place, and all other blocks as before. Counters that a stretch
touches lie in an array that both see. A twin that meets what it leaves to Python calls back by one
pointer: a fault is raised by the block's own code, on the same memory.

    native = NativeTick(program.states, warn)
    graph = native.compile(root, trace=True)
"""

from __future__ import annotations

import ast
import ctypes
import math
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from unicon_base.arrays import Int64
from unicon_base.generated import parse
from unicon_core.flow.block import Block
from unicon_core.flow.compiled import CompiledGraph, Lines, Scope, indent
from unicon_core.flow.compiler import compile_graph
from unicon_core.flow.nodes import Node
from unicon_core.native.build import NativeError, load
from unicon_core.native.network import compare
from unicon_core.native.operands import PRELUDE, NotNative, Table
from unicon_core.native.twins import Piece, pieces_of
from unicon_core.states import States

LEAST = 1
"""A stretch has at least so many operations: a call costs 30 ns, one slice copy in Python 80."""

_EXTREMES = np.maximum, np.minimum
_OWN = (
    ("v", "int64_t*"), ("T", "int64_t*"), ("error", "void**"), ("call", "int64_t (*)(int64_t)"),
    ("yes", "void*"), ("no", "void*"), ("counted", "void (*)(void*)"),
    ("raised", "void (*)(void*, void*)"),
)  # fmt: skip
"""What a library gets besides the arrays of its blocks."""
_STEPS = re.compile(r"(step|deferred|part)")
_SIGNS = {
    ast.Eq: "==", ast.NotEq: "!=", ast.GtE: ">=", ast.Gt: ">", ast.LtE: "<=", ast.Lt: "<",
    ast.BitAnd: "&", ast.BitOr: "|", ast.Add: "+", ast.Sub: "-",
}  # fmt: skip


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
        stretches = Stretches()
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
        stretches = Stretches(opens=False)
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


class _Cell:
    """A counter of a graph in the array that native code shares."""

    def __init__(self, values: memoryview, place: int) -> None:
        self._values, self._place = values, place

    @property
    def cell_contents(self) -> int:
        return self._values[self._place]

    @cell_contents.setter
    def cell_contents(self, value: int) -> None:
        self._values[self._place] = value


@dataclass
class Stretches:
    """The native code of one graph.

    Attributes:
        opens: the library is compiled and loaded; else the graph cannot run.
        native: names of blocks in C++.
        python: names of the other blocks, and why Python runs them.
        source: the C++ text, once the graph is rewritten.
        cells: counters of the graph that lie in the shared array, by name.
    """

    opens: bool = True
    table: Table = field(default_factory=Table)
    native: list[str] = field(default_factory=list)
    python: dict[str, str] = field(default_factory=dict)
    source: str = ""
    cells: dict[str, Any] = field(default_factory=dict)
    _pieces: dict[int, list[Piece]] = field(default_factory=dict)
    _texts: dict[str, tuple[Piece, int]] = field(default_factory=dict)
    _inline: dict[str, Lines] = field(default_factory=dict)
    _places: dict[str, int] = field(default_factory=dict)
    _calls: list[Callable[[], object]] = field(default_factory=list)
    _raised: BaseException | None = None
    _error: Int64 = field(default_factory=lambda: np.zeros(2, np.int64))
    _stretches: list[str] = field(default_factory=list)
    _keep: list[object] = field(default_factory=list)

    def call(self, block: Block, scope: Scope) -> str:
        """Return the lines that call a block, "" where it has no twin.

        Args:
            block: of the tree.
            scope: takes their names.
        """
        if id(block) not in self._pieces:
            self._pieces[id(block)] = []
            try:
                self._pieces[id(block)] = pieces_of(block, self.table)
                self.native.append(block.name)
            except NotNative as reason:
                self.python[block.name] = str(reason)
        lines = []
        for piece in self._pieces[id(block)]:
            name = scope.bind("b", piece.call, piece.name)
            lines.append(f"{name}()")
            if piece.text is not None:
                inline = scope.renamed(block.inline, block.inline_names).splitlines()
                self._texts[name] = piece, len(inline) or LEAST
                self._inline[name] = inline or [f"{name}()"]
        return "\n".join(lines)

    # -- from Python to both ---------------------------------------------------------------------

    def rewrite(self, scope: Scope, functions: dict[str, Lines], stamps: Any) -> dict[str, Lines]:
        """Return the functions of a graph with calls of stretches; the scope's own change in place.

        Args:
            scope: of the graph.
            functions: name to body.
            stamps: int64, of the trace.

        Raises:
            NativeError: the library cannot be had.
        """
        self.scope, self._stamps = scope, stamps
        self._outlined = dict(scope.functions)
        self._inside = _names(self._outlined)
        every = self._outlined | functions
        trees = {
            name: parse("\n".join(body)).body for name, body in every.items() if _STEPS.match(name)
        }
        self._python: set[str] = set()
        while True:
            self._touched: set[str] = set()
            self._owned: set[str] = set()
            self._stretches.clear()
            self._at = 0
            made = {name: self.lines(tree) for name, tree in trees.items()}
            clash = (self._touched & self._owned) - set(scope.state)
            if not clash:
                break
            self._python |= clash
        return self._finish(
            {name: made.get(name) or body for name, body in every.items()}, functions
        )

    def lines(self, body: list[ast.stmt]) -> Lines:
        """Return statements as lines, with stretches in the place of native ones."""
        found, run = Lines(), list[ast.stmt]()
        for statement in body:
            if self.is_native(statement):
                run.append(statement)
                continue
            found += self.stretch(run)
            run = []
            found += self.mixed(statement)
        return [*found, *self.stretch(run)]

    def mixed(self, statement: ast.stmt) -> Lines:
        """Return a statement that Python runs, parts of which may be native."""
        if not isinstance(statement, ast.If):
            self._touched |= self.variables(statement)
            return ast.unparse(statement).splitlines()
        self._touched |= self.variables(statement.test)
        lines = [
            f"if {self.tested(statement.test)}:",
            *indent(self.lines(statement.body) or ["pass"]),
        ]
        if not statement.orelse:
            return lines
        other = self.lines(statement.orelse)
        match statement.orelse:
            case [ast.If() as nested] if not self.is_native(nested):
                return [*lines, f"el{other[0]}", *other[1:]]
        return [*lines, "else:", *indent(other)]

    def tested(self, test: ast.expr) -> str:
        """Return the condition of a statement of Python, which may ask a native block."""
        name = _called(test)
        if name not in self._texts or self._texts[name][1] < LEAST:
            return ast.unparse(test)
        number = self.function([f"return {name}();"])
        return f"n{number}()"

    def stretch(self, run: list[ast.stmt]) -> Lines:
        """Return the call of a stretch, or its statements where it has too little to do."""
        calls = [name for statement in run for name in _calls(statement) if name in self._texts]
        if sum(self._texts[name][1] for name in calls) < LEAST:
            for statement in run:
                self._touched |= self.variables(statement)
            texts = (ast.unparse(statement).splitlines() for statement in run)
            return [each for text in texts for each in self._inline.get(text[0][:-2], text)]
        self._given: dict[str, tuple[str, int]] = {}
        body = [line for statement in run for line in self.cpp(statement)]
        clear = [f"v[{place}] = 0;" for _, place in self._given.values()]
        number = self.function(
            ["int64_t c = 0; int gives = 0; (void)c;", *clear, *body, "return gives;"]
        )
        if not self._given:
            return [f"n{number}()"]
        back = []
        for name, (kind, place) in self._given.items():
            back += (
                [f"{name} |= V[{place}]"]
                if kind == "|"
                else [f"if V[{place}]:", f"    {name} = True"]
            )
        return [f"if n{number}():", *indent(back)]

    def function(self, body: Lines) -> int:
        number = len(self._stretches)
        text = "\n".join(
            [f"CODE static int n{number}() {{", *indent(body), "}", f"FUNCTION(n{number})"]
        )
        self._stretches.append(text)
        return number

    # -- what is native --------------------------------------------------------------------------

    def variables(self, tree: ast.AST) -> set[str]:
        """Return the counters and temporaries that a piece of code names."""
        return {
            node.id
            for node in ast.walk(tree)
            if isinstance(node, ast.Name)
            and node.id not in self.scope.names
            and node.id not in self._inside
        }

    def is_native(self, statement: ast.stmt) -> bool:
        """Return whether a statement calls twins alone, or nothing."""
        match statement:
            case ast.Pass():
                return True
            case ast.Expr(value=ast.Call()):
                return self.callable(_called(statement.value))
            case ast.Assign(targets=[ast.Subscript(slice=ast.Constant())]):
                return _called(statement.value) == "now"
            case ast.Assign(targets=[ast.Name()]):
                called = _called(statement.value)
                simple = called in self._texts if called else not _calls(statement)
                return simple and (_is_true(statement.value) or self.free(statement))
            case ast.AugAssign(target=ast.Name()):
                gives = isinstance(statement.op, ast.BitOr)
                return not _calls(statement) and (gives or self.free(statement))
            case ast.If():
                called = _called(statement.test)
                asked = called in self._texts if called else not _calls(statement.test)
                return (
                    asked
                    and self.free(statement.test)
                    and all(map(self.is_native, [*statement.body, *statement.orelse]))
                )
        return False

    def free(self, tree: ast.AST) -> bool:
        return self._python.isdisjoint(self.variables(tree))

    def callable(self, name: str) -> bool:
        return name in self._texts or name.startswith(("reset", "fresh"))

    # -- C++ -------------------------------------------------------------------------------------

    def place(self, name: str) -> str:
        """Return a counter or temporary in C++."""
        self._owned.add(name)
        return f"v[{self._places.setdefault(name, len(self._places))}]"

    def cpp(self, statement: ast.stmt) -> Iterator[str]:
        """Yield a native statement in C++."""
        match statement:
            case ast.Expr(value=ast.Call(func=ast.Name(id=name))):
                if name.startswith("fresh"):
                    for line in parse("\n".join(self._outlined[name])).body:
                        yield from self.cpp(line)
                else:
                    yield f"if ((c = {self.asked(name)}) < 0) return -1;"
            case ast.Assign(targets=[ast.Subscript(slice=ast.Constant(value=int(place)))]):
                yield f"T[{place}] = now();"
            case ast.Assign(targets=[ast.Name(id=name)], value=value):
                if name in (*self._python, "done", "end") and _is_true(value):
                    yield self.given(name, "=", "1")
                elif called := _called(value):
                    yield f"if (({self.place(name)} = {self.asked(called)}) < 0) return -1;"
                else:
                    yield f"{self.place(name)} = {self.expression(value)};"
            case ast.AugAssign(target=ast.Name(id=name), op=op, value=value):
                if name in self._python:
                    yield self.given(name, "|", self.expression(value))
                else:
                    yield f"{self.place(name)} {_SIGNS[type(op)]}= {self.expression(value)};"
            case ast.If(test=test, body=body, orelse=other):
                condition = self.expression(test)
                if called := _called(test):
                    yield f"if ((c = {self.asked(called)}) < 0) return -1;"
                    condition = "c"
                yield f"if ({condition}) {{"
                yield from indent([line for each in body for line in self.cpp(each)])
                yield "} else {"
                yield from indent([line for each in other for line in self.cpp(each)])
                yield "}"

    def given(self, name: str, kind: str, value: str) -> str:
        """Return the statement that hands a flag to the Python function behind the stretch."""
        key = f"{name} given {len(self._stretches)}"
        self._given[name] = kind, self._places.setdefault(key, len(self._places))
        return f"v[{self._given[name][1]}] |= {value}; gives = 1;"

    def asked(self, name: str) -> str:
        """Return the call of a block, or of a reset, which Python runs."""
        if name in self._texts:
            return f"{name}()"
        return f"call({self.number(self.scope.names[name])})"

    def number(self, function: Callable[[], object]) -> int:
        if function not in self._calls:
            self._calls.append(function)
        return self._calls.index(function)

    def expression(self, node: ast.expr) -> str:
        match node:
            case ast.Constant(value=int(value)):
                return str(int(value))
            case ast.Name(id=name):
                return self.place(name)
            case ast.UnaryOp(op=ast.Not(), operand=operand):
                return f"!({self.expression(operand)})"
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                return f"-({self.expression(operand)})"
            case ast.Compare(left=left, ops=[op], comparators=[right]):
                return f"({self.expression(left)} {_SIGNS[type(op)]} {self.expression(right)})"
            case ast.BinOp(left=left, op=op, right=right):
                return f"({self.expression(left)} {_SIGNS[type(op)]} {self.expression(right)})"
            case ast.Call():
                return "0"
        raise NotImplementedError(ast.unparse(node))

    # -- the library -----------------------------------------------------------------------------

    def _finish(self, every: dict[str, Lines], functions: dict[str, Lines]) -> dict[str, Lines]:
        scope, places = self.scope, self._places
        values = np.zeros(max(len(places), 1), np.int64)
        moved = {name: f"V[{place}]" for name, place in places.items() if name in self._owned}
        shared: memoryview = memoryview(values.data)
        for name in [name for name in scope.state if name in moved]:
            values[places[name]] = scope.state.pop(name)
            self.cells[name] = _Cell(shared, places[name])
        word = re.compile(rf"\b({'|'.join(map(re.escape, moved)) or 'V'})\b")
        every = {
            name: [word.sub(lambda found: moved.get(found[0], found[0]), line) for line in body]
            for name, body in every.items()
        }
        used = {name for text in self._stretches for name in re.findall(r"\bb\d+\w*(?=\(\))", text)}
        blocks = [
            f"CODE static int64_t {name}() {{\n{piece.text.replace('BAIL', f'return call({self.number(piece.call)})')}\nreturn 0;\n}}"  # noqa: E501
            for name, (piece, _) in self._texts.items()
            if name in used and piece.text is not None
        ]
        table = self.table
        own = [
            f"{name} = ({kind})t[{len(table.arrays) + i}];" for i, (name, kind) in enumerate(_OWN)
        ]
        self.source = "\n".join(
            [
                f"// native: {', '.join(map(_clean, self.native)) or 'nothing'}",
                *(f"// Python runs {_clean(name)}: {why}" for name, why in self.python.items()),
                PRELUDE,
                *table.declarations,
                *blocks,
                *self._stretches,
                'extern "C" void unicon_bind(void* const* t) {',
                *indent([*table.bindings, *own]),
                "}",
                "",
            ]
        )
        self._values = values
        scope.names["V"] = shared
        scope.functions[:] = [(name, every[name]) for name, _ in scope.functions]
        every["warm_up"] = [*every["warm_up"], "warm()"]
        calls: dict[str, Any] = {f"n{number}": bool for number in range(len(self._stretches))}
        calls["warm"] = bool
        networks = {n: piece for n, (piece, _) in self._texts.items() if piece.owner and n in used}
        calls |= dict.fromkeys(networks, bool)
        self.source += "".join(f"FUNCTION({name})\n" for name in networks)
        if self.opens:
            calls = self._opened(calls)
            for name, piece in networks.items():
                self._replace(piece, calls[name])
        scope.names |= {name: call for name, call in calls.items() if name not in networks}
        return {name: every[name] for name in functions}

    def _opened(self, calls: dict[str, Any]) -> dict[str, Any]:
        """Compile and load the library, bind it, and return its functions.

        Raises:
            NativeError: it cannot be had, or computes otherwise than NumPy here.
        """
        library = load(self.source)
        back = ctypes.PYFUNCTYPE(ctypes.c_int64, ctypes.c_int64)(self._called)
        arrays = [*self.table.arrays, self._values, self._stamps, self._error]
        addresses = [array.__array_interface__["data"][0] for array in arrays]
        python = ctypes.pythonapi
        called, counted, raised = (
            ctypes.cast(each, ctypes.c_void_p).value
            for each in (back, python.Py_IncRef, python.PyErr_SetObject)
        )
        addresses += [called, id(True), id(False), counted, raised]
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
        self._keep += [library, back, arrays]
        return made

    def _replace(self, piece: Piece, network: Callable[[], object]) -> None:
        """Let a policy run its network by a native function, warm-ups too.

        Raises:
            NativeError: it computes otherwise than Python's.
        """
        if not compare(piece.call, network, *piece.arrays):
            raise NativeError(f"{piece.name} gives other bits by ONNX Runtime's C interface")
        piece.owner.infer = network

    def _called(self, number: int) -> int:
        """Run a block's Python twin for the library, which raises what this raises."""
        try:
            return 1 if self._calls[number]() else 0
        except BaseException as error:
            self._raised = error
            self._error[:] = id(type(error)), id(error)
            return -1


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


def _is_true(node: ast.expr) -> bool:
    return isinstance(node, ast.Constant) and node.value is True


def _called(node: ast.AST) -> str:
    """Return the name of the function that an expression calls without arguments, "" for others."""
    match node:
        case ast.Call(func=ast.Name(id=name), args=[], keywords=[]):
            return name
    return ""


def _calls(tree: ast.AST) -> list[str]:
    """Return what a piece of code calls."""
    calls = [node.func for node in ast.walk(tree) if isinstance(node, ast.Call)]
    return [call.id if isinstance(call, ast.Name) else "?" for call in calls]


def _names(functions: dict[str, Lines]) -> set[str]:
    return {*functions, "T", "Z", "now"}


def _clean(name: str) -> str:
    return re.sub(r"\W", "_", name, flags=re.ASCII)
