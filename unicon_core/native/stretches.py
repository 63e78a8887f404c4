"""Stretches: which parts of a compiled graph are native, and their C++.

The compiler's functions are straight-line Python. Statements that call blocks with twins alone, or
nothing, are native with the branches and counters around them. What both sides touch lies in one
array of integers; a temporary that Python needs afterwards and native code only sets is handed over
behind the stretch.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

from unicon_base.arrays import Int64
from unicon_base.generated import parse
from unicon_core.flow.block import Block
from unicon_core.flow.compiled import Lines, Scope, indent
from unicon_core.native.operands import NotNative, Table
from unicon_core.native.pieces import Piece, pieces_of

STEPS = re.compile(r"(step|deferred|part)")
_SIGNS = {
    ast.Eq: "==", ast.NotEq: "!=", ast.GtE: ">=", ast.Gt: ">", ast.LtE: "<=", ast.Lt: "<",
    ast.BitAnd: "&", ast.BitOr: "|", ast.Add: "+", ast.Sub: "-",
}  # fmt: skip


@dataclass
class Stretches:
    """The stretches of one graph; what makes a library of them is `NativeGraph`.

    Attributes:
        table: the arrays of the blocks.
        native: names of blocks in C++.
        python: names of the other blocks, and why Python runs them.
        cells: counters of the graph that lie in the shared array, by name.
        texts: name of a block's piece with a twin to the piece.
        places: counters and temporaries of native code to their place in the shared array.
        owned: those of them that Python finds there, too.
        calls: functions of Python that native code calls, by their number.
        functions: of the stretches, in C++.
    """

    table: Table = field(default_factory=Table)
    native: list[str] = field(default_factory=list)
    python: dict[str, str] = field(default_factory=dict)
    cells: dict[str, Any] = field(default_factory=dict)
    texts: dict[str, Piece] = field(default_factory=dict)
    places: dict[str, int] = field(default_factory=dict)
    owned: set[str] = field(default_factory=set)
    calls: list[Callable[[], object]] = field(default_factory=list)
    functions: list[str] = field(default_factory=list)
    _pieces: dict[int, list[Piece]] = field(default_factory=dict)

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
                self.texts[name] = piece
        return "\n".join(lines)

    # -- from Python to both ---------------------------------------------------------------------

    def rewrite(self, scope: Scope, functions: dict[str, Lines], stamps: Int64) -> dict[str, Lines]:
        """Return the functions of a graph with calls of stretches; the scope's own change in place.

        Args:
            scope: of the graph.
            functions: name to body.
            stamps: int64, of the trace.

        Raises:
            NativeError: the library cannot be had.
        """
        self.scope, self.stamps = scope, stamps
        self._outlined = dict(scope.functions)
        self._inside = {*self._outlined}
        every = self._outlined | functions
        trees = {
            name: parse("\n".join(body)).body for name, body in every.items() if STEPS.match(name)
        }
        self._python: set[str] = set()
        while True:
            self._touched: set[str] = set()
            self.owned = set()
            self.functions.clear()
            self._at = 0
            made = {name: self.lines(tree) for name, tree in trees.items()}
            clash = (self._touched & self.owned) - set(scope.state)
            if not clash:
                break
            self._python |= clash
        every = {name: made.get(name) or body for name, body in every.items()}
        return self.finish(every, functions)

    def finish(self, every: dict[str, Lines], functions: dict[str, Lines]) -> dict[str, Lines]:
        """Return the functions as they run; makes the library.

        Args:
            every: name to body of all functions, with calls of stretches.
            functions: those that are returned; the scope has the others.
        """
        raise NotImplementedError

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
        if name not in self.texts:
            return ast.unparse(test)
        return f"n{self.function([f'return {name}();'])}()"

    def stretch(self, run: list[ast.stmt]) -> Lines:
        """Return the call of a stretch, or its statements where it calls no twin."""
        if self.texts.keys().isdisjoint(name for each in run for name in _calls(each)):
            for statement in run:
                self._touched |= self.variables(statement)
            return [line for each in run for line in ast.unparse(each).splitlines()]
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
        number = len(self.functions)
        text = "\n".join(
            [f"CODE static int n{number}() {{", *indent(body), "}", f"FUNCTION(n{number})"]
        )
        self.functions.append(text)
        return number

    def used(self) -> set[str]:
        """Return the names of the pieces that the functions call."""
        return {name for text in self.functions for name in re.findall(r"\bb\d+\w*(?=\(\))", text)}

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
                simple = self.callable(called) if called else not _calls(statement)
                return simple and (_is_true(statement.value) or self.free(statement))
            case ast.AugAssign(target=ast.Name()):
                gives = isinstance(statement.op, ast.BitOr)
                return not _calls(statement) and (gives or self.free(statement))
            case ast.If():
                called = _called(statement.test)
                asked = self.callable(called) if called else not _calls(statement.test)
                return (
                    asked
                    and self.free(statement.test)
                    and all(map(self.is_native, [*statement.body, *statement.orelse]))
                )
        return False

    def free(self, tree: ast.AST) -> bool:
        names = {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)}
        return names.isdisjoint({*self._python, *self.scope.names} - self.texts.keys())

    def callable(self, name: str) -> bool:
        return name in self.texts or name.startswith(("reset", "fresh"))

    # -- C++ -------------------------------------------------------------------------------------

    def place(self, name: str) -> str:
        """Return a counter or temporary in C++."""
        self.owned.add(name)
        return f"v[{self.places.setdefault(name, len(self.places))}]"

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
                yield f"if (bool({condition})) {{"  # clang warns of ((a == b))
                yield from indent([line for each in body for line in self.cpp(each)])
                yield "} else {"
                yield from indent([line for each in other for line in self.cpp(each)])
                yield "}"

    def given(self, name: str, kind: str, value: str) -> str:
        """Return the statement that hands a flag to the Python function behind the stretch."""
        key = f"{name} given {len(self.functions)}"
        self._given[name] = kind, self.places.setdefault(key, len(self.places))
        return f"v[{self._given[name][1]}] |= {value}; gives = 1;"

    def asked(self, name: str) -> str:
        """Return the call of a block, or of a reset, which Python runs."""
        if name in self.texts:
            return f"{name}()"
        return f"call({self.number(self.scope.names[name])})"

    def number(self, function: Callable[[], object]) -> int:
        if function not in self.calls:
            self.calls.append(function)
        return self.calls.index(function)

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
            case (
                ast.Compare(left=left, ops=[op], comparators=[right])
                | ast.BinOp(left=left, op=op, right=right)
            ):
                return f"({self.expression(left)} {_SIGNS[type(op)]} {self.expression(right)})"
            case ast.Call():
                return "0"
        raise NotImplementedError(ast.unparse(node))


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
