"""Expressions: predicates over states as text, for `until:` and `when:` in a workflow file.

`"tick > 100 and base_pos_w[2] < 0.2"` becomes inline code of the compiled graph. Names are states,
subscripts are whole numbers; `abs`, `min`, `max`, `any`, `all` may be called; nothing else.
"""

from __future__ import annotations

import ast
from typing import Any

from unicon_core.errors import StateError, WorkflowError
from unicon_core.flow.block import Block
from unicon_core.states import States

__all__ = ["expression"]

_CALLS = {"abs": abs, "min": min, "max": max, "any": any, "all": all}
_ALLOWED = (
    ast.Expression,
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
    try:
        tree = ast.parse(text, mode="eval")
    except SyntaxError as error:
        raise WorkflowError(f"expression {text!r}: {error.msg}", where) from error
    names: dict[str, Any] = {}
    called = {node.func for node in ast.walk(tree) if isinstance(node, ast.Call)}
    for node in ast.walk(tree):
        if not isinstance(node, _ALLOWED):
            raise WorkflowError(
                f"expression {text!r}: {type(node).__name__} is not allowed; use states, numbers, "
                "comparisons, arithmetic, and/or/not, abs, min, max, any, all",
                where,
            )
        if isinstance(node, ast.Constant) and not isinstance(node.value, (int, float)):
            raise WorkflowError(f"expression {text!r}: {node.value!r} is no number", where)
        if isinstance(node, ast.Name):
            if node in called:
                if node.id not in _CALLS:
                    known = ", ".join(_CALLS)
                    raise WorkflowError(
                        f"expression {text!r}: no function {node.id!r}; known: {known}", where
                    )
                continue
            try:
                names[node.id] = states[node.id]
            except StateError as error:
                raise WorkflowError(f"expression {text!r}: {error}", where) from error
    reads = tuple(names)
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and node not in called:
            node.id = f"s_{node.id}"
    bound = {f"s_{name}": view for name, view in names.items()}
    code = compile(tree, f"<{text}>", "eval")
    try:
        bool(eval(code, {"__builtins__": _CALLS}, bound))
    except Exception as error:
        raise WorkflowError(f"expression {text!r}: {error}", where) from error

    def predicate() -> bool:
        return bool(eval(code, {"__builtins__": _CALLS}, bound))

    return Block(
        name=text,
        tick=predicate,
        reads=reads,
        where=where,
        inline=ast.unparse(tree),
        inline_names=bound,
    )
