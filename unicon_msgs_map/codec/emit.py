"""The code behind `Encoder.encode`: slots of a template become one flat Python function.

Measured (NumPy 2.4, Python 3.11, one warm core): a cast-copy of any length up to 64 costs about
130 ns, a strided one of three such arrays the same, packing a scalar about 20 ns; so up to eight
numbers go through `struct`, longer arrays through a copy.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray

from unicon_core.generated import define
from unicon_msgs_map.codec.binding import Bound
from unicon_msgs_map.layout.messages import Primitive
from unicon_msgs_map.layout.template import Slot, Template

__all__ = ["generate"]

AnyArray = NDArray[Any]
Conversions = Mapping[int, tuple[AnyArray, AnyArray] | None]

SCALAR_LIMIT = 8  # numbers of one field that still go through struct
GAP_LIMIT = 64  # constant bytes that a pack into the buffer may write again, [B]


@dataclass(frozen=True, eq=False)
class _Copy:
    """An array copy: flat source elements at an even step to an even stride in the message."""

    source: int
    view: AnyArray
    offset: int
    stride: int
    primitive: Primitive
    ranks: tuple[int, ...]


def generate(
    template: Template,
    bounds: Mapping[int, Bound],
    conversions: Conversions,
    checksum: Callable[[], int] | None = None,
) -> tuple[Callable[[], bytes], str]:
    """Return the encode function and its source.

    Args:
        template: bytes and slots.
        bounds: state per field number.
        conversions: factor and summand per field number, None where there is nothing to do.
        checksum: computes the last four bytes from the others, where the message has one.
    """
    copies: list[_Copy] = []
    scalars: list[Slot] = []
    for key, slots in _by_field(template.slots).items():
        found = _as_copy(slots, bounds[key[0]], conversions[key[0]])
        if found is None:
            scalars += slots
        else:
            copies.append(found)
    writer = _Writer(template, bounds, conversions)
    body = writer.loads(scalars)
    if copies or checksum:
        body += writer.packs_into(scalars)
        body += writer.copies(copies)
        if checksum:
            writer.space |= {"checksum": checksum, "sign": struct.Struct("<I").pack_into}
            body.append(f"sign(buffer, {len(template.data) - 4}, checksum())")
        body.append("return bytes(buffer)")
    else:
        body.append(f"return {writer.pack(scalars)}")
    lines = ["def encode():", f"    # {len(template.data)} bytes"]
    source = "\n".join(lines + ["    " + line for line in body]) + "\n"
    encode: Callable[[], bytes] = define(source, writer.space, "<encode>")["encode"]
    return encode, source


def _by_field(slots: list[Slot]) -> dict[tuple[int, str], list[Slot]]:
    groups: dict[tuple[int, str], list[Slot]] = {}
    for slot in slots:
        key = (slot.source, slot.primitive.name if slot.primitive else slot.kind)
        groups.setdefault(key, []).append(slot)
    return groups


def _as_copy(
    slots: list[Slot], bound: Bound, conversion: tuple[AnyArray, AnyArray] | None
) -> _Copy | None:
    primitive = slots[0].primitive
    if primitive is None or len(slots) <= SCALAR_LIMIT:
        return None
    wire = np.dtype(primitive.dtype)
    state = bound.flat.dtype
    if wire.kind != "f" and (conversion is not None or not np.can_cast(state, wire, "safe")):
        return None  # rounding and saturation are spelled out number by number
    slots = sorted(slots, key=lambda slot: slot.offset)
    stride, step = _step([s.offset for s in slots]), _step([s.element for s in slots])
    if stride is None or step is None:
        return None
    first = slots[0].element
    view = as_strided(
        bound.flat[first : first + 1],
        (len(slots),),
        (step * bound.flat.strides[0],),
        writeable=False,
    )
    ranks = tuple(slot.rank for slot in slots)
    return _Copy(slots[0].source, view, slots[0].offset, stride, primitive, ranks)


def _step(values: list[int]) -> int | None:
    steps = {b - a for a, b in pairwise(values)}
    return steps.pop() if len(steps) == 1 else None


class _Writer:
    """Writes the lines of one function and collects the names that they use."""

    def __init__(
        self, template: Template, bounds: Mapping[int, Bound], conversions: Conversions
    ) -> None:
        self.data = template.data
        self.bounds = bounds
        self.conversions = conversions
        self.space: dict[str, Any] = {}
        self.values: dict[Slot, list[tuple[str, str]]] = {}

    def loads(self, scalars: list[Slot]) -> list[str]:
        """Return the lines that read the scalars; note what to pack for each slot."""
        lines: list[str] = []
        wanted: dict[str, tuple[AnyArray, set[int]]] = {}
        for slot in scalars:
            bound = self.bounds[slot.source]
            wanted.setdefault(bound.field.source.name, (bound.flat, set()))[1].add(slot.element)
        for state, (flat, members) in wanted.items():
            elements = sorted(members)
            names = [f"v_{state}_{element}" for element in elements]
            first, last = elements[0], elements[-1]
            view = f"in_{state}"
            self.space[view] = flat[first : last + 1].data
            if len(elements) == last - first + 1 > 1:
                lines.append(f"{', '.join(names)} = {view}")
            else:
                lines += [f"{n} = {view}[{e - first}]" for n, e in zip(names, elements)]
        split: set[str] = set()
        for slot in scalars:
            name = f"v_{self.bounds[slot.source].field.source.name}_{slot.element}"
            if slot.kind == "time":
                sec, nanosec = f"{name}_sec", f"{name}_nanosec"
                if name not in split:
                    lines.append(f"{sec}, {nanosec} = divmod({name}, 1000000000)")
                    split.add(name)
                # masked: struct raises beyond 32 bits, and encode must not
                self.values[slot] = [("I", f"{sec} & 0xffffffff"), ("I", nanosec)]
            else:
                self.values[slot] = [self._scalar(slot, name)]
        return lines

    def _scalar(self, slot: Slot, name: str) -> tuple[str, str]:
        bound = self.bounds[slot.source]
        conversion = self.conversions[slot.source]
        expression, state = name, bound.flat.dtype
        if conversion is not None:
            scale, offset = float(conversion[0][slot.rank]), float(conversion[1][slot.rank])
            if scale == -1.0:
                expression = f"-{expression}"
            elif scale != 1.0:
                expression = f"{expression} * {self._number(scale)}"
            if offset:
                expression = f"{expression} + {self._number(offset)}"
        if slot.kind == "text":
            form = f"form{slot.source}"
            self.space |= {"text": _text, form: bound.field.text or ""}
            return f"{slot.width}s", f"text({expression}, {form}, {slot.width})"
        primitive = slot.primitive
        assert primitive is not None
        wire = np.dtype(primitive.dtype)
        if primitive.code == "?":
            return "?", expression
        if primitive.code == "d":
            return "d", expression
        if primitive.code == "f":
            if conversion is None and (state == np.float32 or state.kind in "biu"):
                return "f", expression
            self.space["single"] = _single
            return "f", f"single({expression})"
        if conversion is None and np.can_cast(state, wire, "safe"):
            return primitive.code, expression
        self.space["integer"] = _integer
        info = np.iinfo(wire)
        return primitive.code, f"integer({expression}, {info.min}, {info.max})"

    def _number(self, value: float) -> str:
        if math.isfinite(value):
            return f"({value!r})" if value < 0 else repr(value)
        name = f"beyond{len(self.space)}"
        self.space[name] = value
        return name

    def pack(self, scalars: list[Slot]) -> str:
        """Return the expression that makes the whole message with one pack."""
        if not scalars:
            self.space["message"] = bytes(self.data)
            return "message"
        form, arguments = self._run(scalars, 0, len(self.data))
        self.space["pack"] = struct.Struct(form).pack
        return f"pack({', '.join(arguments)})"

    def packs_into(self, scalars: list[Slot]) -> list[str]:
        """Return the lines that pack the scalars into the buffer, near ones together."""
        self.space["buffer"] = self.data
        runs: list[list[Slot]] = []
        end = -GAP_LIMIT - 1
        for slot in sorted(scalars, key=lambda s: s.offset):
            if slot.offset - end > GAP_LIMIT:
                runs.append([])
            runs[-1].append(slot)
            end = slot.offset + self._size(slot)
        lines = []
        for number, run in enumerate(runs):
            start, stop = run[0].offset, run[-1].offset + self._size(run[-1])
            form, arguments = self._run(run, start, stop)
            self.space[f"pack{number}"] = struct.Struct(form).pack_into
            lines.append(f"pack{number}(buffer, {start}, {', '.join(arguments)})")
        return lines

    def _size(self, slot: Slot) -> int:
        return sum(struct.calcsize("<" + code) for code, _ in self.values[slot])

    def _run(self, slots: list[Slot], start: int, stop: int) -> tuple[str, list[str]]:
        form, position = "<", start
        arguments: list[str] = []
        for slot in sorted(slots, key=lambda s: s.offset):
            form, position = self._gap(form, arguments, position, slot.offset)
            for code, expression in self.values[slot]:
                form += code
                arguments.append(expression)
                position += struct.calcsize("<" + code)
        form, _ = self._gap(form, arguments, position, stop)
        return form, arguments

    def _gap(self, form: str, arguments: list[str], start: int, stop: int) -> tuple[str, int]:
        if start == stop:
            return form, stop
        constant = bytes(self.data[start:stop])
        if not any(constant):
            return f"{form}{stop - start}x", stop  # pad bytes are packed as zeros
        name = f"c{start}"
        self.space[name] = constant
        arguments.append(name)
        return f"{form}{stop - start}s", stop

    def copies(self, copies: list[_Copy]) -> list[str]:
        """Return the lines of the array copies, fused where distances are even."""
        lines: list[str] = []
        plain = [c for c in copies if self.conversions[c.source] is None and _quiet(c)]
        for number, group in enumerate(_fuse(plain)):
            first, count = group[0], len(group[0].ranks)
            shape: tuple[int, ...] = (count,)
            wire: tuple[int, ...] = (first.stride,)
            memory: tuple[int, ...] = first.view.strides
            if len(group) > 1:
                shape = (len(group), count)
                wire = (group[1].offset - first.offset, *wire)
                memory = (_address(group[1].view) - _address(first.view), *memory)
                # Every element touched lies in one of the group's arrays, all kept alive here.
                self.space[f"keep{number}"] = [c.view for c in group]
            self.space[f"from{number}"] = as_strided(first.view, shape, memory, writeable=False)
            self.space[f"into{number}"] = self._target(first, shape, wire)
            names = ", ".join(self.bounds[c.source].field.source.name for c in group)
            lines.append(f"into{number}[...] = from{number}  # {names}")
        for copy in copies:
            if copy in plain:
                continue
            lines += self._converted(copy)
        return lines

    def _target(self, first: _Copy, shape: tuple[int, ...], strides: tuple[int, ...]) -> AnyArray:
        dtype = np.dtype(first.primitive.dtype)
        target: AnyArray = np.ndarray(shape, dtype, self.data, first.offset, strides)
        return target

    def _converted(self, copy: _Copy) -> list[str]:
        number, conversion = copy.source, self.conversions[copy.source]
        count = len(copy.ranks)
        self.space[f"state{number}"] = copy.view
        self.space[f"wire{number}"] = self._target(copy, (count,), (copy.stride,))
        name = self.bounds[number].field.source.name
        if conversion is None:
            lines = [f"wire{number}[...] = state{number}  # {name}"]
        else:
            ranks = list(copy.ranks)
            self.space[f"work{number}"] = np.zeros(count)
            self.space[f"scale{number}"] = np.ascontiguousarray(conversion[0][ranks])
            self.space[f"offset{number}"] = np.ascontiguousarray(conversion[1][ranks])
            self.space |= {"multiply": np.multiply, "add": np.add}
            lines = [f"work{number}[...] = state{number}  # {name}"]
            lines.append(f"multiply(work{number}, scale{number}, work{number})")
            if conversion[1].any():
                lines.append(f"add(work{number}, offset{number}, work{number})")
            lines.append(f"wire{number}[...] = work{number}")
        # Overflows to infinity are said in the contract; the warning must not reach a tick.
        self.space["quiet"] = _ignore
        return ["with quiet():", *("    " + line for line in lines)]


def _ignore() -> np.errstate:
    return np.errstate(all="ignore")


def _quiet(copy: _Copy) -> bool:
    """Tell whether a plain copy can raise no floating point warning."""
    return not (copy.view.dtype == np.float64 and copy.primitive.code == "f")


def _fuse(copies: list[_Copy]) -> list[list[_Copy]]:
    """Group copies of equal form whose addresses and offsets are both evenly spaced."""
    groups: list[list[_Copy]] = []
    for copy in sorted(copies, key=lambda c: c.offset):
        group = groups[-1] if groups else None
        if group is not None and _alike(group[-1], copy):
            steps = (copy.offset - group[-1].offset, _address(copy.view) - _address(group[-1].view))
            if len(group) == 1 or steps == (
                group[1].offset - group[0].offset,
                _address(group[1].view) - _address(group[0].view),
            ):
                group.append(copy)
                continue
        groups.append([copy])
    return groups


def _alike(a: _Copy, b: _Copy) -> bool:
    return (len(a.ranks), a.view.dtype, a.view.strides, a.stride, a.primitive) == (
        len(b.ranks),
        b.view.dtype,
        b.view.strides,
        b.stride,
        b.primitive,
    )


def _address(view: AnyArray) -> int:
    return int(view.__array_interface__["data"][0])


_SINGLE_MAX = float(np.finfo(np.float32).max)


def _single(value: float) -> float:
    """Return what float32 can hold: struct raises beyond it, and encode must not."""
    if -_SINGLE_MAX <= value <= _SINGLE_MAX or value != value:
        return value
    return math.inf if value > 0 else -math.inf


def _integer(value: float, low: int, high: int) -> int:
    """Round to the nearest integer that the field can hold; NaN becomes 0."""
    if value != value:
        return 0
    if value <= low:
        return low
    return high if value >= high else round(value)


def _text(value: float, form: str, width: int) -> bytes:
    """Format at the fixed width; what does not fit becomes asterisks."""
    text = format(value, form).encode()
    return text if len(text) == width else b"*" * width
