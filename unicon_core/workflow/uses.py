"""Uses: blocks that a workflow mentions and its program builds, for the YAML reader and for Python.

    Chain(pose("stand"), Loop(policy("walk"), until=elapsed(10)))

A use is a deferred factory: arrays and period do not exist while the flow is written. `block` makes
a use of any registered block, or of a factory of one's own.

An expression is a predicate over states as text, for `until:` and `when:` in a workflow file:
`"tick > 100 and base_pos_w[2] < 0.2"` becomes inline code of the compiled graph. Names are states,
subscripts are whole numbers; `abs`, `min`, `max`, `any`, `all` may be called; nothing else. What an
expression costs is bounded by its length: powers are small, numbers are those that a state holds.
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Callable, Iterator, Mapping
from itertools import chain
from typing import Any, cast

import numpy as np

from unicon_base import AnyDict, AnyMapping, StateError, WorkflowError
from unicon_base.generated import define, parse
from unicon_core.flow import Block, Node, Tick, as_node, blocks_of
from unicon_core.states import States

EXPRESSION = "expression"
"""Word of a predicate over states that is given as a text."""


class Use(Block):
    """One mention of a block, which is built later.

    Attributes:
        word: registered name of the block, or that of the factory.
        factory: of one's own; None for a registered block.
        first: a single value in place of options; it goes to the factory's first option.
        options: of the factory, by name.
        label: name of the built block; the word if empty.
        rename: parameter of the factory to label of the state that it gets.
        of: member of the robot whose joints alone it is built for; "" for all of it.
    """

    def __init__(
        self,
        word: str,
        *,
        factory: Callable[..., Any] | None = None,
        first: Any = None,
        options: AnyMapping | None = None,
        label: str = "",
        rename: Mapping[str, str] | None = None,
        where: str = "",
    ) -> None:
        super().__init__(label or word, self._not_built, where=where)
        self.word, self.factory, self.first, self.label = word, factory, first, label
        self.options = dict(options or {})
        self.rename = dict(rename or {})
        self.of = ""

    def _not_built(self) -> object:
        raise self.error(" is not built yet; give the flow to a Program")

    def error(self, text: str, *_: str) -> WorkflowError:
        """Return the error of which `text` follows the block's name."""
        return WorkflowError(f"block {self.name!r}{text}", self.where)


def block(
    what: str | Callable[..., Any],
    first: Any = None,
    *,
    name: str = "",
    states: Mapping[str, str] | None = None,
    **options: Any,
) -> Use:
    """Mention a block.

    Args:
        what: name of a registered block, or a factory: a function whose parameters are annotated
            `Reads`, `Writes` or `Amends`.
        first: value of its first option.
        name: label of the block.
        states: parameter to the label of the state that it gets, where that is another.
        options: its options by name.
    """
    return _use(what, first, options, name, states)


def pose(to: Any, **options: Any) -> Use:
    """Mention the block that moves to a pose and is done there: `default`, `rest`, or joints."""
    return _use("pose", None, {"to": to, **options})


def policy(name: str | None = None) -> Use:
    """Mention a policy of the program by its name; without a name the only one."""
    return _use("policy", name, {})


def elapsed(seconds: float) -> Use:
    """Mention the predicate that holds after a time in [s]."""
    return _use("elapsed", seconds, {})


def on(part: str, node: Node | Tick) -> Node:
    """Give a tree to a part of a divided workflow, where it does not belong to one already."""
    made = as_node(node)
    for each in blocks_of(made):
        each.part = each.part or part
    return made


def of(member: str, node: Node | Tick) -> Node:
    """Give a tree to a member of the robot: its blocks see and move the joints of that one alone.

    Raises:
        WorkflowError: a block of it is built already.
    """
    made = as_node(node)
    for each in blocks_of(made):
        if not isinstance(each, Use):
            raise WorkflowError(
                f"block {each.name!r} is built already, with the states of the whole robot; "
                "mention its factory: block(FACTORY)",
                each.where,
            )
        if each.word != EXPRESSION:  # it looks at the whole robot
            each.of = each.of or member
    return made


def _use(
    what: str | Callable[..., Any],
    first: Any,
    options: AnyMapping,
    name: str = "",
    states: Mapping[str, str] | None = None,
) -> Use:
    caller = sys._getframe(2)
    return Use(
        what if isinstance(what, str) else getattr(what, "__name__", type(what).__name__),
        factory=None if isinstance(what, str) else what,
        first=first,
        options=options,
        label=name,
        rename=states,
        where=f"{caller.f_code.co_filename}:{caller.f_lineno}",
    )


MAX_LENGTH = 1000
"""Characters of an expression."""
MAX_NODES = 200
"""Names, numbers and operators of an expression."""
MAX_DEPTH = 30
"""Operators inside each other."""
LARGEST_POWER = 8
LARGEST_NUMBER = 2**63

_CALLS = ("abs", "min", "max", "any", "all")
_ALLOWED = re.compile(
    "BoolOp|And|Or|UnaryOp|Not|USub|UAdd|BinOp|Add|Sub|Mult|Div|Mod|Pow|Compare|Lt|LtE|Gt|GtE|Eq|"
    "NotEq|Name|Load|Constant|Subscript|Call"
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
        self._states, self._parts = states, dict(_parts(parse(text, "eval")))

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
        self.bound: AnyDict = {}

    def fail(self, message: object) -> WorkflowError:
        shown = self.text if len(self.text) <= 120 else f"{self.text[:117]}…"
        return WorkflowError(f"expression {shown!r}: {message}", self.where)

    def block(self) -> Block:
        tree = self.parsed()
        self.check(tree.body)
        # All of it is evaluated, and each operand of and/or: none may fail when first reached.
        operands = (n.values for n in ast.walk(tree) if isinstance(n, ast.BoolOp))
        for part in (tree.body, *chain(*operands)):
            try:
                with np.errstate(all="ignore"):
                    self.compiled(part)()
            except (ArithmeticError, IndexError, TypeError, ValueError) as error:
                raise self.fail(error) from error
        return Block(
            self.text,
            self.compiled(tree.body),
            tuple(name.removeprefix("s_") for name in self.bound),
            where=self.where,
            inline=ast.unparse(tree),
            inline_names=self.bound,
        )

    def parsed(self) -> ast.Expression:
        if len(self.text) > MAX_LENGTH:
            raise self.fail(f"{len(self.text)} characters; write at most {MAX_LENGTH}")
        try:
            tree: ast.Expression = parse(self.text, "eval")
        except (SyntaxError, ValueError) as error:
            raise self.fail(getattr(error, "msg", error)) from error
        except (MemoryError, RecursionError) as error:
            raise self.fail("it is nested too deep; make it flatter") from error
        nodes, depth, level = 0, 0, [cast(ast.AST, tree.body)]
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
        if not _ALLOWED.fullmatch(type(node).__name__):
            raise self.fail(
                f"{type(node).__name__} is not allowed; use states, numbers, "
                "comparisons, arithmetic, and/or/not, abs, min, max, any, all"
            )
        below = ast.iter_child_nodes(node)
        match node:
            case ast.Constant(value=value):
                if not isinstance(value, int | float) or not abs(value) <= LARGEST_NUMBER:
                    raise self.fail(f"{_short(value)} is not a number that a state holds")
            case ast.Name(id=name):
                node.id = f"s_{name}"
                try:
                    self.bound[node.id] = self.states[name]
                except StateError as error:
                    raise self.fail(error) from error
            case ast.Call(func=called):
                if not isinstance(called, ast.Name):
                    self.check(called)
                if not isinstance(called, ast.Name) or called.id not in _CALLS:
                    known = ", ".join(_CALLS)
                    raise self.fail(f"no function {ast.unparse(called)!r}; known: {known}")
                below = iter([*node.args, *node.keywords])
            case ast.Subscript():
                try:
                    place = ast.literal_eval(node.slice)
                except ValueError:
                    place = None
                if type(place) is not int or not isinstance(node.value, ast.Name | ast.Subscript):
                    raise self.fail(
                        f"{ast.unparse(node)}: an element of a state goes by a whole number, "
                        "as in [2]"
                    )
            case ast.BinOp(op=ast.Pow()):
                exponent = node.right.value if isinstance(node.right, ast.Constant) else None
                small = isinstance(exponent, int | float) and 0 <= exponent <= LARGEST_POWER
                if not small or any(isinstance(n, ast.Pow) for n in ast.walk(node.left)):
                    raise self.fail(
                        f"{ast.unparse(node)}: a power goes by a number from 0 to "
                        f"{LARGEST_POWER}, once"
                    )
        for child in below:
            self.check(child)

    def compiled(self, node: ast.expr) -> Callable[[], bool]:
        source = f"def predicate():\n    return bool({ast.unparse(node)})"
        predicate: Callable[[], bool] = define(source, self.bound, "<expression>")["predicate"]
        return predicate


def _short(value: object) -> str:
    text = repr(value) if not isinstance(value, int) or value.bit_length() < 4096 else "it"
    return text if len(text) <= 60 else f"{text[:57]}…"
