"""Expressions: predicates over states as text, for `until:` and `when:` in a workflow file.

`"tick > 100 and base_pos_w[2] < 0.2"` becomes inline code of the compiled graph. Names are states,
subscripts are whole numbers; `abs`, `min`, `max`, `any`, `all` may be called; nothing else. What an
expression costs is bounded by its length: powers are small, numbers are those that a state holds.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from unicon_base.errors import StateError, WorkflowError
from unicon_base.generated import define, parse
from unicon_core.flow.block import Block
from unicon_core.states import States

MAX_LENGTH = 1000
"""Characters of an expression."""
MAX_NODES = 200
"""Names, numbers and operators of an expression."""
MAX_DEPTH = 30
"""Operators inside each other."""
LARGEST_POWER = 8
LARGEST_NUMBER = 2**63

_CALLS = ("abs", "min", "max", "any", "all")
_ALLOWED = (
    ast.BoolOp,
    ast.And,
    ast.Or,
    ast.UnaryOp,
    ast.Not,
    ast.USub,
    ast.UAdd,
    ast.BinOp,
    ast.Add,
    ast.Sub,
    ast.Mult,
    ast.Div,
    ast.Mod,
    ast.Pow,
    ast.Compare,
    ast.Lt,
    ast.LtE,
    ast.Gt,
    ast.GtE,
    ast.Eq,
    ast.NotEq,
    ast.Name,
    ast.Load,
    ast.Constant,
    ast.Subscript,
    ast.Call,
)


def expression(text: str, states: States, where: str = "") -> Block:
    """Build a predicate from text.

    Args:
        text: the expression.
        states: what its names mean.
        where: `file:line` for messages.

    Raises:
        WorkflowError: a syntax error, an unknown state, or something that is not allowed.
    """
    return _Expression(text, states, where).block()


class EntryCondition:
    """An expression that has to hold, and says with which values it does not.

    Args:
        text: as of `expression`.
        states: likewise.
        where: likewise.

    Attributes:
        reads: states that it reads.

    Raises:
        WorkflowError: as `expression`.
    """

    def __init__(self, text: str, states: States, where: str = "") -> None:
        block = expression(text, states, where)
        self._text, self._holds, self.reads = text, block.tick, block.reads
        self._states = states
        self._parts = dict(_parts(parse(text, "eval")))

    def __call__(self) -> str:
        """Return what does not hold and the values that it looks at; "" where it holds."""
        if self._holds():
            return ""
        told = []
        for part, (name, *places) in self._parts.items():
            value = self._states[name]
            for place in places:
                value = value[place]
            told.append(f"{part} is {np.array2string(value, precision=3, threshold=8)}")
        return f"{self._text} does not hold: {', '.join(told)}"


def _parts(node: ast.AST) -> Iterator[tuple[str, list[Any]]]:
    """Yield the states of an expression as it names them, and each one's name and subscripts."""
    inner, places = node, list[Any]()
    while isinstance(inner, ast.Subscript):
        places.insert(0, ast.literal_eval(inner.slice))
        inner = inner.value
    if isinstance(inner, ast.Name):
        if inner.id not in _CALLS:
            yield ast.unparse(node), [inner.id, *places]
        return
    for child in ast.iter_child_nodes(node):
        yield from _parts(child)


class _Expression:
    """One text on its way to a block; every check raises WorkflowError."""

    def __init__(self, text: str, states: States, where: str) -> None:
        self.text, self.states, self.where = text, states, where
        self.shown = text if len(text) <= 120 else f"{text[:117]}…"
        self.bound: dict[str, Any] = {}
        self.reads: list[str] = []

    def fail(self, message: str) -> WorkflowError:
        return WorkflowError(f"expression {self.shown!r}: {message}", self.where)

    def block(self) -> Block:
        tree = self.parsed()
        self.check(tree.body)
        self.try_all(tree)
        code = ast.unparse(tree)
        return Block(
            name=self.text,
            tick=self.compiled(tree.body),
            reads=tuple(self.reads),
            where=self.where,
            inline=code,
            inline_names=self.bound,
        )

    def parsed(self) -> ast.Expression:
        if len(self.text) > MAX_LENGTH:
            raise self.fail(f"{len(self.text)} characters; write at most {MAX_LENGTH}")
        try:
            tree: ast.Expression = parse(self.text, "eval")
        except (SyntaxError, ValueError) as error:
            raise self.fail(str(getattr(error, "msg", error))) from error
        except (MemoryError, RecursionError) as error:
            raise self.fail("it is nested too deep; make it flatter") from error
        nodes, depth = 0, 0
        level: list[ast.AST] = [tree.body]
        while level:
            depth += 1
            nodes += len(level)
            if depth > MAX_DEPTH or nodes > MAX_NODES:
                raise self.fail(
                    f"it is too large; write at most {MAX_NODES} names, numbers and operators, "
                    f"{MAX_DEPTH} inside each other"
                )
            level = [child for node in level for child in ast.iter_child_nodes(node)]
        return tree

    def check(self, node: ast.AST) -> None:
        """Check a node and all below it; names become those that the code binds."""
        if not isinstance(node, _ALLOWED):
            raise self.fail(
                f"{type(node).__name__} is not allowed; use states, numbers, "
                "comparisons, arithmetic, and/or/not, abs, min, max, any, all"
            )
        if isinstance(node, ast.Constant):
            value = node.value
            if not isinstance(value, (int, float)) or not abs(value) <= LARGEST_NUMBER:
                raise self.fail(f"{_short(value)} is not a number that a state holds")
        elif isinstance(node, ast.Name):
            self.name(node)
            return
        elif isinstance(node, ast.Call):
            self.call(node)
            return
        elif isinstance(node, ast.Subscript):
            self.subscript(node)
        elif isinstance(node, ast.BinOp) and isinstance(node.op, ast.Pow):
            self.power(node)
        for child in ast.iter_child_nodes(node):
            self.check(child)

    def name(self, node: ast.Name) -> None:
        try:
            view = self.states[node.id]
        except StateError as error:
            raise self.fail(str(error)) from error
        if node.id not in self.reads:
            self.reads.append(node.id)
        node.id = f"s_{node.id}"
        self.bound[node.id] = view

    def call(self, node: ast.Call) -> None:
        function = node.func
        if not isinstance(function, ast.Name):
            self.check(function)
        if not isinstance(function, ast.Name) or function.id not in _CALLS:
            called = ast.unparse(function)
            raise self.fail(f"no function {called!r}; known: {', '.join(_CALLS)}")
        for argument in (*node.args, *node.keywords):
            self.check(argument)

    def subscript(self, node: ast.Subscript) -> None:
        names = isinstance(node.value, (ast.Name, ast.Subscript))
        try:
            place = ast.literal_eval(node.slice)
        except ValueError:
            place = None
        if not names or type(place) is not int:
            raise self.fail(
                f"{ast.unparse(node)}: an element of a state goes by a whole number, as in [2]"
            )

    def power(self, node: ast.BinOp) -> None:
        inside = any(
            isinstance(part, ast.BinOp) and isinstance(part.op, ast.Pow)
            for part in ast.walk(node.left)
        )
        exponent = node.right.value if isinstance(node.right, ast.Constant) else None
        small = isinstance(exponent, (int, float)) and 0 <= exponent <= LARGEST_POWER
        if inside or not small:
            raise self.fail(
                f"{ast.unparse(node)}: a power goes by a number from 0 to {LARGEST_POWER}, once"
            )

    def try_all(self, tree: ast.Expression) -> None:
        """Evaluate all of it, and each operand of and/or: none may fail when first reached."""
        parts: list[ast.expr] = [tree.body]
        for node in ast.walk(tree):
            if isinstance(node, ast.BoolOp):
                parts += node.values
        for part in parts:
            try:
                with np.errstate(all="ignore"):
                    self.compiled(part)()
            except (ArithmeticError, IndexError, TypeError, ValueError) as error:
                raise self.fail(str(error)) from error

    def compiled(self, node: ast.expr) -> Callable[[], bool]:
        source = f"def predicate():\n    return bool({ast.unparse(node)})"
        predicate: Callable[[], bool] = define(source, self.bound, "<expression>")["predicate"]
        return predicate


def _short(value: object) -> str:
    text = repr(value) if not isinstance(value, int) or value.bit_length() < 4096 else "it"
    return text if len(text) <= 60 else f"{text[:57]}…"
