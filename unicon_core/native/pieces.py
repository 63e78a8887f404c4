"""A block's tick as pieces that follow each other, in C++ where they have a twin, else in Python.

Copies, index maps and looks at ranges are made of what they declare, policies of their parts: the
observation, the network and the targets; all others have their twin in `twins.py`.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FunctionType
from typing import Any

import numpy as np

from unicon_base.errors import Fault
from unicon_base.generated import parse
from unicon_core.flow.block import Block, LinearMap
from unicon_core.native.network import open_session
from unicon_core.native.operands import NotNative, Table, literal
from unicon_core.native.twins import TWINS


@dataclass
class Piece:
    """A part of a block's tick.

    Attributes:
        name: of the block.
        call: the part in Python: what it does where `text` is None, else what `BAIL` runs.
        text: its C++, expanded; None where Python runs it.
        owner: of a network: its attribute `infer` becomes the native function.
        arrays: of a network: inputs and outputs by name.
        session: of a network: addresses of function, session and binding, int64, shape (3,).
        files: of a network: the model and those beside it that hold its weights.
        why: Python runs it.
    """

    name: str
    call: Callable[[], object]
    text: str | None = None
    owner: Any = None
    arrays: Any = ()
    session: Any = None
    files: tuple[Path, ...] = ()
    why: str = ""


def pieces_of(block: Block, table: Table) -> list[Piece]:
    """Return a block's tick as pieces that follow each other.

    Args:
        block: of the tree.
        table: takes the operands.

    Raises:
        NotNative: Python runs all of it; with the reason.
    """
    moved = len(table.moved)
    try:
        policy = _policy_pieces(block, table)
        return [Piece(block.name, block.tick, _text(block, table))] if policy is None else policy
    except NotNative:
        table.undo(moved)
        raise


def _text(block: Block, table: Table) -> str:
    tick: Any = block.tick
    if block.linear is not None:
        return _linear(block.linear, table)
    if block.parts and block.inline:
        return "\n".join(f"{{ {_text(part, table)} }}" for part in block.parts)
    if block.parts:
        return _looked(block, table)
    if block.inline:
        return f"DONE({_expression(parse(block.inline).body, block.inline_names, table)[0]});"
    return _own_text(tick, table)


def _own_text(tick: Any, table: Table) -> str:
    """Return the twin of a function or an object by what it runs."""
    called = tick if isinstance(tick, FunctionType) else type(tick).__call__
    for (first, *others), twin in TWINS.items():
        if _name(called) == first and all(
            _name(getattr(type(tick), other.rpartition(".")[2], None)) == other for other in others
        ):
            text = twin if isinstance(twin, str) else twin(tick)
            ranges = _within(tick.ranges, table) if "RANGES" in text else ""
            return table.expand(text, tick).replace("RANGES", ranges)
    raise NotNative("it has no twin")


def _name(function: Any) -> str:
    """Return `module:name` of a function of this package's core, without the package."""
    module = getattr(function, "__module__", None) or ""
    return f"{module.removeprefix('unicon_core.')}:{getattr(function, '__qualname__', '')}"


# -- copies and ranges --------------------------------------------------------------------------


def _linear(linear: LinearMap, table: Table) -> str:
    source, target = linear.source, linear.target
    floats = source.dtype.kind in "fbiu" and target.dtype.name in ("float32", "float64")
    if np.may_share_memory(source, target):
        raise NotNative("a map into its own source")
    if (source.dtype != target.dtype and not floats) or not (linear.is_copy or floats):
        raise NotNative(f"a map of {source.dtype} into {target.dtype}")
    if linear.index is not None and source.ndim > 1:
        raise NotNative("a map of several rows")
    flat = source.flags.c_contiguous and target.flags.c_contiguous
    if linear.is_copy and linear.index is None and source.dtype == target.dtype and flat:
        into, out_of = table.array(target), table.array(source)
        return f"__builtin_memcpy({into}, {out_of}, {target.nbytes});"
    kind = "float" if target.dtype.name == "float32" else "double"
    lines = [
        "each(#target) {",
        "auto x = " + ("$source[$index[i]];" if linear.index is not None else "$source[i];"),
    ]
    value = "x"
    if not linear.is_copy or source.dtype != target.dtype:
        value = f"({kind})x"
    for name, sign in (("scale", "*"), ("offset", "+")):
        if (by := getattr(linear, name)) is not None:
            if by.ndim and by.size not in (1, target.size):
                raise NotNative("a map of several rows")
            value = f"{value} {sign} ${name}[{'i' if by.size > 1 else 0}]"
            value = f"({kind})({value})"
    return table.expand("\n".join([*lines, f"$target[i] = {value};", "}"]), linear)


def _within(ranges: Any, table: Table) -> str:
    """Return an expression that holds where all ranges do, as `Screen` compares them."""
    parts = []
    for view, lower, upper in ranges:
        low, high = (
            table.constants(np.broadcast_to(each, view.shape), view.dtype)
            for each in (lower, upper)
        )
        parts.append(f"within({table.array(view)}, {low}, {high}, {view.size})")
    return " && ".join(parts)


def _looked(block: Block, table: Table) -> str:
    """Return the twin of blocks that act beyond ranges, which `fuse` put together."""
    stops = [part for part in block.parts if not part.amends]
    amending = [part for part in block.parts if part.amends]
    lines = [f"if ({_within([r for p in block.parts for r in p.tick.ranges], table)}) return 0;"]  # type: ignore[attr-defined]
    if stops:
        tripped = _within([r for p in stops for r in p.tick.ranges], table)  # type: ignore[attr-defined]
        lines.append(f"if (!({tripped})) BAIL;")
    return "\n".join([*lines, *(f"{{ {_text(part, table)} }}" for part in amending)])


# -- expressions --------------------------------------------------------------------------------

_COMPARED = {ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!="}
_KINDS = {"float32": "float", "float64": "double", "int64": "int64_t", "bool": "bool"}
_ALIKE = (
    {"float"}, {"double"}, {"int64_t"}, {"bool"}, {"float", "double"}, {"float", "number"},
    {"double", "number"}, {"int64_t", "number"}, {"bool", "number"},
)  # fmt: skip
"""Kinds that C++ compares as NumPy does; a number of Python counts as what stands beside it."""


def _expression(node: Any, names: Mapping[str, Any], table: Table) -> tuple[str, str]:
    """Return an expression of a workflow over single elements in C++, and its kind.

    Raises:
        NotNative: it has what NumPy may compute otherwise.
    """

    def of(part: Any) -> tuple[str, str]:
        return _expression(part, names, table)

    match node:
        case [ast.Expr(value=value)]:
            return of(value)
        case ast.Name() | ast.Subscript():
            places: list[int] = []
            while isinstance(node, ast.Subscript):
                places.insert(0, ast.literal_eval(node.slice))
                node = node.value
            view = names[node.id]
            known = isinstance(view, np.ndarray) and view.dtype.name in _KINDS
            if known and view.ndim == len(places):
                return f"{table.array(view[(*places, None)])}[0]", _KINDS[view.dtype.name]
        case ast.Constant(value=int(value) | float(value)) if abs(value) < 1 << 53:
            return literal(value), "number"
        case ast.UnaryOp(op=ast.USub(), operand=ast.Constant(value=int(value) | float(value))):
            return literal(-value), "number"
        case ast.UnaryOp(op=ast.Not(), operand=operand):
            return f"!({of(operand)[0]})", "bool"
        case ast.BoolOp(op=junction, values=values):
            sign = " && " if isinstance(junction, ast.And) else " || "
            return f"({sign.join(f'({of(each)[0]})' for each in values)})", "bool"
        case ast.BinOp(left=left, op=ast.Mod(), right=ast.Constant(value=int(value))) if value > 0:
            text, kind = of(left)
            if kind == "int64_t":
                return f"((({text}) % {value} + {value}) % {value})", kind
        case ast.Compare(left=left, ops=ops, comparators=others):
            sides = [of(each) for each in (left, *others)]
            parts = []
            for (one, kind), op, (other, beside) in zip(sides, ops, sides[1:]):
                if {kind, beside} not in _ALIKE:
                    raise NotNative("an expression of several types")
                if "float" in (kind, beside) and "number" in (kind, beside):
                    one, other = f"(float){one}", f"(float){other}"
                parts.append(f"{one} {_COMPARED[type(op)]} {other}")
            return f"({' && '.join(parts)})", "bool"
    raise NotNative("an expression with more than elements, comparisons, and, or and not")


# -- policies -----------------------------------------------------------------------------------


def _policy_pieces(block: Block, table: Table) -> list[Piece] | None:
    """Return what a policy does before and behind its network, None where it is no plain one.

    Raises:
        NotNative: the policy has what Python runs.
    """
    policy: Any = block.tick
    if _name(type(policy).__call__) != "policies.policy:Policy.__call__":
        return None
    lane, action_map = policy.lane, policy.action_map
    observation = lane.observation
    plain = {
        "pictures": not policy.contract.images,
        "a motion": policy.tracker is None and not policy._motion,
        "inputs beside the observation": observation is not None and not lane.inputs,
        "a network that remembers inside itself": not lane._remembering,
        "filters": not (observation and observation._filters) and action_map.filter is None,
        "actions that are not positions": action_map.positions_only,
    }
    for what, lacks in plain.items():
        if not lacks:
            raise NotNative(f"a policy with {what}")

    def refuse(blame: Callable[[], str]) -> Callable[[], object]:
        def fault() -> None:
            raise Fault(blame())

        return fault

    before = [Piece(f"{block.name}_{k}", part) for k, part in enumerate(policy._before)]
    for piece in before:
        with _explained(piece):
            piece.text = _own_text(piece.call, table)
    assemble = "\n".join([_observation(observation), "each(#obs) if (!finite($obs[i])) BAIL;"])
    holder = _Operands(lane, observation, policy)
    return [
        *before,
        Piece(block.name, refuse(policy._blame_observation), table.expand(assemble, holder)),
        _network(block, table),
        Piece(block.name, refuse(policy._blame_action), table.expand(_action(policy), holder)),
    ]


def _network(block: Block, table: Table) -> Piece:
    """Return the network as a piece: in Python where the C interface cannot run it."""
    policy: Any = block.tick
    lane = policy.lane
    piece = Piece(f"{block.name}_network", lane.infer)
    with _explained(piece):
        own = _name(lane.infer) == "policies.networks.onnx:OnnxNetwork.bind.<locals>.run"
        if not own or policy.contract.provider != "cpu":  # or it is native in another graph
            raise NotNative("a network of another runtime")
        *_, inputs, outputs = lane.infer.__defaults__[0]
        piece.session = open_session(policy.contract.model, inputs, outputs)
        made = table.array(piece.session)
        piece.text = (
            f"auto run = (void* (*)(void*, const void*, void*)){made}[0];\n"
            f"if (run((void*){made}[1], 0, (void*){made}[2])) BAIL;"
        )
        piece.owner, piece.arrays = lane, (inputs, outputs)
        model = policy.network.file
        piece.files = model.path, *(model.path.parent / name for name in model.external)
    return piece


@contextmanager
def _explained(piece: Piece) -> Iterator[None]:
    """Leave a piece to Python, and say why, where no C++ can be made inside."""
    try:
        yield
    except NotNative as reason:
        piece.why = str(reason)


class _Operands:
    """Names for what a policy's twin uses."""

    def __init__(self, lane: Any, observation: Any, policy: Any) -> None:
        self.lane, self.observation, self.map = lane, observation, policy.action_map
        self.obs, self.action = lane.obs, lane.action
        self.target = policy._computed[0]
        self.published, self.recurrent = policy._published, lane.recurrent
        if observation._clip is not None:
            span, self.low, self.high = observation._clip
            self.first, self.last = span.start, span.stop
        if self.map._clip is not None:  # of the action, or of targets
            self.least, self.most = self.map._clip


def _observation(observation: Any) -> str:
    """Return the twin of `Observation.bind_parts`'s `write`, into `obs` or the ring."""
    lines = ["float x = $observation._buffer[$observation._index[i]];"]
    if observation._subtract is not None:
        lines.append("x = x - $observation._subtract[i];")
    if observation._clip is not None:
        clip = "x = lesser(greater(x, $low[i - $first]), $high[i - $first]);"
        lines.append(f"if (i >= $first && i < $last) {clip}")
    if observation._scale is not None:
        lines.append("x = x * $observation._scale[i];")
    size = observation._index.size
    frame = f"each({size}) {{ {' '.join(lines)} OUT[i] = x; }}"
    history = observation._history
    if history == 1:
        return frame.replace("OUT", "$obs")
    fresh = "0.0f" if observation._zeros else f"slot[i % {size}]"
    return f"""
    float* slot = &$observation._ring[$observation._head * {size}];
    {frame.replace("OUT", "slot")}
    if ($observation._fresh) {{
      float kept[{size}];
      each({size}) kept[i] = slot[i];
      each(#observation._ring) $observation._ring[i] = {fresh.replace("slot", "kept")};
      each({size}) slot[i] = kept[i];
    }}
    each({size}) slot[{history * size} + i] = slot[i];
    const float* window = &$observation._ring[($observation._head + 1) * {size}];
    each(#obs) $obs[i] = window[$observation._window_index[i]];
    """


def _action(policy: Any) -> str:
    action_map, lane = policy.action_map, policy.lane
    lines = ["each(#action) if (!finite($action[i])) BAIL;"]
    clip, target = action_map._clip is not None, "$action[$map._index[i]]"
    if clip and action_map._feed_clipped:
        lines.append("each(#action) $action[i] = lesser(greater($action[i], $least[i]), $most[i]);")
    elif clip:
        target = f"lesser(greater({target}, $least[i]), $most[i])"
    lines.append(
        f"each(#target) {{ float x = {target}; x = x * $map._scale[i];"
        " $target[i] = x + $map._offset[i]; }"
    )
    lines += _copies("published", len(policy._published))
    if lane.advance.__name__ == "_go_on":
        if lane.observation._history > 1:
            lines.append(
                "$observation._head = $observation._head + 1 < $observation._history"
                " ? $observation._head + 1 : 0; $observation._fresh = 0;"
            )
        lines += [
            f"each(#recurrent.{k}.0) $recurrent.{k}.1[i] = $recurrent.{k}.0[i];"
            for k in range(len(lane.recurrent))
        ]
        lines.append("$lane._steps += 1.0;")
    return "\n".join(lines)


def _copies(path: str, count: int) -> Iterator[str]:
    for k in range(count):
        yield f"each(#{path}.{k}.0) ${path}.{k}.0[i] = ${path}.{k}.1[i];"
