"""The careful path: which message elements go to which state elements, and writing them, checked.

`select` applies the declared policies to what a walk found; `apply` reads, converts and checks
every value in plain Python, and writes only when all of them are good. The fast path must give
the same states; the tests hold both equal.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from typing import Any

import numpy as np

from unicon_msgs_map.codec.binding import SINGLE_MAX, Conversion, limits
from unicon_msgs_map.codec.targets import Target
from unicon_msgs_map.errors import count_of
from unicon_msgs_map.layout.messages import Primitive
from unicon_msgs_map.layout.walker import WalkedFields
from unicon_msgs_map.spec import SubscribeSpec

STAMP, COVARIANCE = -1, -2
"""Numbers of what is read beside the fields: the stamp, an Imu's first orientation covariance."""

UNIT = (0.9, 1.1)
"""Bounds of the square of a quaternion's norm."""


class Rejected(ValueError):
    """The message is well formed, and the mapping's policies refuse it."""


@dataclass(frozen=True)
class Run:
    """Numbers of one field that are read alike.

    Attributes:
        kind: `number`, `time`, `stamp`, `zero` (elements set to zero), `required`, `unit` (elements
            that are a quaternion) or `told` (an orientation's covariance that is not -1).
        target: the field; None for the stamp.
        order: byte order for `struct`.
        primitive: wire type; None for a time.
        offsets: where each number lies, [B].
        elements: where each goes in the state's flat view.
        ranks: position of each in its field, for per-element scale and offset.
        flat: the state's flat view, or the decoder's own stamp.
        conversion: of the whole field, by rank; None where nothing is converted.
    """

    kind: str
    target: Target | None
    order: str
    primitive: Primitive | None = None
    offsets: tuple[int, ...] = ()
    elements: tuple[int, ...] = ()
    ranks: tuple[int, ...] = ()
    flat: Any = None
    conversion: Conversion | None = None


def select(
    found: WalkedFields, spec: SubscribeSpec, targets: list[Target], stamp: list[int]
) -> list[Run]:
    """Return what to read and where to write it.

    Raises:
        Rejected: names, counts or constants are not as declared.
    """
    runs: list[Run] = []
    by_name, carried = False, 0
    for target in targets:
        bound = target.bound
        if bound is None:
            if target.required is not None:
                _require(found, target, runs)
            continue
        places: list[tuple[int, Primitive | None]] = []
        for offset, primitive, count in found.numbers.get(target.number, []):
            size = 0 if primitive is None else primitive.size  # a time is never one of many
            places += [(offset + k * size, primitive) for k in range(count)]
        ranks = _ranks(found, spec, target, len(places))
        absent = sorted(set(range(len(bound.elements))) - set(ranks))
        by_name |= target.by is not None
        if absent and spec.missing == "error":
            raise Rejected(
                f"{target.field.path} lacks {_named(target, absent)}, "
                "and missing: error is declared"
            )
        alike: dict[Primitive | None, list[tuple[int, int, int]]] = {}
        for (offset, primitive), rank in zip(places, ranks):
            if rank is not None:
                carried += 1
                alike.setdefault(primitive, []).append((bound.elements[rank], rank, offset))
        for primitive, members in alike.items():
            elements, own, offsets = zip(*sorted(members))
            there = offsets, elements, own, bound.flat, bound.conversion
            kind = "number" if primitive else "time"
            runs.append(Run(kind, target, found.order, primitive, *there))
        if absent and spec.missing == "zero":
            elements = tuple(bound.elements[k] for k in absent)
            runs.append(Run("zero", target, found.order, elements=elements, flat=bound.flat))
    if not carried and spec.missing != "zero":
        what = "known names" if by_name else "mapped elements"
        raise Rejected(f"it carries none of the {what}")
    for offset, _, _ in found.numbers.get(STAMP, []):
        runs.append(Run("stamp", None, found.order, None, (offset,), (0,), (0,), stamp))
    return runs


def orientation(found: WalkedFields, runs: list[Run], state: str) -> list[Run]:
    """Return what makes sure that a message tells an orientation.

    A quaternion of zeros is what a driver sends that has none, and so is -1 in the first element of
    an Imu's `orientation_covariance` (sensor_msgs/Imu).

    Args:
        found: in the message.
        runs: what `select` returned.
        state: of the quaternion.

    Raises:
        Rejected: nothing in the message is written to that state.
    """
    written = [run for run in runs if state_of(run) == state and run.kind == "number"]
    if not written:
        raise Rejected(f"it carries nothing for {state}")
    offsets = tuple(offset for run in written for offset in run.offsets)
    covariance = found.numbers.get(COVARIANCE, [])
    return [
        Run("unit", written[0].target, found.order, None, offsets),
        *(Run("told", None, found.order, kind, (offset,)) for offset, kind, _ in covariance),
    ]


def state_of(run: Run) -> str:
    """Return the state that a run writes; empty for none."""
    bound = None if run.target is None else run.target.bound
    return "" if bound is None else bound.field.source.name


def _ranks(
    found: WalkedFields, spec: SubscribeSpec, target: Target, count: int
) -> list[int | None]:
    assert target.bound is not None
    ours = len(target.bound.elements)
    path = target.field.path
    if target.by is not None and count:
        texts = found.texts.get(target.by, [])
        names = spec.fields[target.by].path
        if texts:
            if len(texts) != count:
                raise Rejected(f"{path} has {count_of(count)} for {len(texts)} in {names}")
            if len(set(texts)) != len(texts):
                twice = next(t for t in texts if texts.count(t) > 1)
                raise Rejected(f"{names} holds {twice!r} twice")
            index = {name: rank for rank, name in enumerate(target.order)}
            ranks = [index.get(text) for text in texts]
            unknown = [text for text, rank in zip(texts, ranks) if rank is None]
            if unknown and spec.extra == "error":
                raise Rejected(
                    f"{names} holds unknown {_some(unknown)}, and extra: error is declared"
                )
            return ranks
        if spec.unnamed == "error":
            raise Rejected(f"{names} is empty, and unnamed: error is declared")
        if count != ours:
            raise Rejected(f"{names} is empty and {path} has {count_of(count)}, not {ours}")
    if count > ours and spec.extra == "error":
        raise Rejected(f"{path} has {count_of(count)}, not {ours}, and extra: error is declared")
    return [k if k < ours else None for k in range(count)]


def _require(found: WalkedFields, target: Target, runs: list[Run]) -> None:
    path, wanted = target.field.path, target.required
    texts = found.texts.get(target.number)
    if texts is not None:
        if texts[0] != wanted:
            raise Rejected(f"{path} is {texts[0]!r}, not the required {wanted!r}")
        return
    numbers = found.numbers.get(target.number)
    if not numbers:
        raise Rejected(f"{path} is absent, and {wanted!r} is required")
    offset, primitive, _ = numbers[0]
    runs.append(Run("required", target, found.order, primitive, (offset,)))


def apply(raw: bytes, runs: list[Run], nonfinite: str) -> None:
    """Read, convert, check and write a message.

    Args:
        raw: the payload; every offset of the runs lies inside it.
        runs: what goes where.
        nonfinite: `reject` or `accept`.

    Raises:
        Rejected: a value is not acceptable; nothing was written.
    """
    writes: list[tuple[Any, int, Any]] = []
    quaternion = next((state_of(run) for run in runs if run.kind == "unit"), "")
    square = 0.0
    for run in runs:
        if run.kind == "zero":
            writes += [(run.flat, element, 0) for element in run.elements]
            continue
        if run.kind == "unit":
            if not UNIT[0] <= square <= UNIT[1]:  # NaN too
                raise Rejected(f"the quaternion's norm is {square**0.5:g}, not 1")
            continue
        if run.primitive is None:
            for offset, element, rank in zip(run.offsets, run.elements, run.ranks):
                sec, nanosec = struct.unpack_from(run.order + "iI", raw, offset)
                value = sec * 1_000_000_000 + nanosec
                if run.target is not None:
                    value = _integral(run, value, rank)
                writes.append((run.flat, element, value))
            continue
        code = run.order + ("B" if run.primitive.code == "?" else run.primitive.code)
        values = [struct.unpack_from(code, raw, offset)[0] for offset in run.offsets]
        if run.primitive.code == "?":
            values = [value != 0 for value in values]
        if run.kind == "required":
            assert run.target is not None
            if values[0] != run.target.required:
                raise Rejected(
                    f"{run.target.field.path} is {values[0]!r}, "
                    f"not the required {run.target.required!r}"
                )
            continue
        if run.kind == "told":
            if values[0] == -1.0:
                raise Rejected("orientation_covariance[0] is -1: it has no orientation")
            continue
        for value, element, rank in zip(values, run.elements, run.ranks):
            converted = _convert(run, value, rank, nonfinite)
            if quaternion and state_of(run) == quaternion:
                square += converted * converted
            writes.append((run.flat, element, converted))
    for flat, element, value in writes:
        flat[element] = value


def _convert(run: Run, value: float, rank: int, nonfinite: str) -> Any:
    dtype = run.flat.dtype
    if run.conversion is not None:
        scale, offset = run.conversion
        value = value * float(scale[rank]) + float(offset[rank])
    if nonfinite == "reject" and isinstance(value, float) and not math.isfinite(value):
        raise Rejected(f"{_element(run, rank)} is {value}, and nonfinite: reject is declared")
    if dtype.kind == "b":
        return bool(value)
    if dtype.kind != "f":
        return _integral(run, value, rank)
    value = float(value)
    if dtype == np.float32 and math.isfinite(value) and abs(value) > SINGLE_MAX:
        raise Rejected(f"{_element(run, rank)} is {value:g}, which float32 cannot hold")
    return value


def _integral(run: Run, value: float, rank: int) -> int:
    low, high = limits(run.flat.dtype)
    if not low <= value <= high:  # NaN too
        raise Rejected(f"{_element(run, rank)} is {value}, which {run.flat.dtype} cannot hold")
    return min(max(round(value), low), high)


def _element(run: Run, rank: int) -> str:
    assert run.target is not None
    return _named(run.target, [rank])


def _named(target: Target, ranks: list[int]) -> str:
    assert target.bound is not None
    names = target.order or target.bound.names
    return _some([names[k] if names else f"{target.field.path}[{k}]" for k in ranks])


def _some(names: list[str]) -> str:
    shown = ", ".join(map(repr, names[:5]))
    return shown if len(names) <= 5 else f"{shown}, … ({len(names)} in all)"
