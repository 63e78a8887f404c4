"""The one door through which generated Python runs, for the flow compiler, expressions and codecs.

Files name states, topics, blocks and formats. None of that is ever code: a generator writes
identifiers, numbers and its own words, and binds everything else as a value. That is not left to
care: what comes here is parsed first, and only calls, arithmetic, comparisons, assignments and
branches over bound names and numbers are run, without Python's builtins.
"""

from __future__ import annotations

import ast
import keyword
import re
import threading
from typing import Any

from unicon_base import AnyDict, AnyMapping

BUILTINS: AnyDict = {
    f.__name__: f for f in (abs, all, any, bool, bytes, divmod, len, max, min, round)
}
"""What generated code may call without binding it."""

_NODES = (
    ast.Module, ast.FunctionDef, ast.arguments, ast.arg, ast.Return, ast.Assign, ast.AugAssign,
    ast.If, ast.With, ast.withitem, ast.Pass, ast.Expr, ast.Nonlocal, ast.Call, ast.Name,
    ast.Constant, ast.Subscript, ast.Slice, ast.Tuple, ast.BinOp, ast.UnaryOp, ast.BoolOp,
    ast.Compare, ast.Attribute, ast.expr_context, ast.operator, ast.unaryop, ast.boolop, ast.cmpop,
)  # fmt: skip
_ATTRIBUTES = ("translate",)
_IDENTIFIER = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_NUMBERS = (int, float, type(None), type(...))
_PARSING = threading.RLock()


def is_identifier(name: object) -> bool:
    """Return whether a name may stand in generated code: ASCII, no word of Python, no `__`."""
    return (
        isinstance(name, str)
        and _IDENTIFIER.fullmatch(name) is not None
        and not name.startswith("__")
        and not keyword.iskeyword(name)
    )


def define(source: str, names: AnyMapping, label: str) -> AnyDict:
    """Run the text of functions and return what it defined.

    Args:
        source: function definitions, nothing else.
        names: what they may use besides their own names.
        label: what Python calls the text in a trace.

    Raises:
        RuntimeError: the text holds more than generated code may; a mistake of its generator.
    """
    check_source(source, names)
    space = {"__builtins__": BUILTINS, **names}
    exec(compile(source, label, "exec"), space)
    return space


def parse(text: str, mode: str = "exec") -> Any:
    """Return the syntax tree of a text, as `ast.parse` does; one thread at a time.

    Python 3.11 keeps one depth counter of syntax trees for all threads: two that parse at once, and
    change places in a garbage collection, end in a SystemError (python/cpython#106905).
    """
    with _PARSING:
        return ast.parse(text, mode=mode)


def check_source(source: str, names: AnyMapping) -> ast.Module:
    """Return the syntax tree of a generated text, or refuse it; see `define`."""
    tree: ast.Module = parse(source)
    known = {*names, *BUILTINS}
    used: set[str] = set()
    for node in ast.walk(tree):
        if not isinstance(node, _NODES):
            raise _refused(f"{type(node).__name__} stands in it")
        if isinstance(node, ast.Constant) and not isinstance(node.value, _NUMBERS):
            raise _refused(f"the text {node.value!r} stands in it")
        if isinstance(node, ast.Attribute) and node.attr not in _ATTRIBUTES:
            raise _refused(f"it asks for the attribute {node.attr!r}")
        if isinstance(node, ast.FunctionDef):
            if node.decorator_list:
                raise _refused("a function of it has a decorator")
            known.add(node.name)
        elif isinstance(node, ast.arg):
            known.add(node.arg)
        elif isinstance(node, ast.Name):
            (used if isinstance(node.ctx, ast.Load) else known).add(node.id)
    for statement in tree.body:
        if not isinstance(statement, ast.FunctionDef):
            raise _refused("it does more than to define functions")
    for name in (*known, *used):
        if not is_identifier(name):
            raise _refused(f"it uses the name {name!r}")
    for name in used - known:
        raise _refused(f"it uses {name!r}, which is not bound")
    return tree


def _refused(why: str) -> RuntimeError:
    return RuntimeError(f"generated code is refused: {why}; bind it as a value")
