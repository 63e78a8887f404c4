"""What a message takes from states: one `struct` pack for many numbers, copies for long arrays.

Measured (NumPy 2.4, Python 3.11, one warm core): a number, time or text that goes by itself costs
about 20 ns, a cast-copy of any length up to 64 about 130 ns, a strided one of three such arrays
the same.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from unicon_base import AnyDict
from unicon_msgs_map.codec.binding import (
    SINGLE_MAX,
    AnyArray,
    Bound,
    Conversion,
    address,
    fuse,
    limits,
    line,
    memory,
    stack,
    step,
)
from unicon_msgs_map.layout.template import Slot, Template

GAP_LIMIT = 64  # constant bytes that a pack into the buffer may write again, [B]


class Packs:
    """Writes the lines of one function and collects the names that they use."""

    def __init__(self, template: Template, bounds: Mapping[int, Bound]) -> None:
        self.data = template.data
        self.bounds = bounds
        self.space: AnyDict = {}
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
        conversion = bound.conversion
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
        low, high = limits(wire)
        return primitive.code, f"integer({expression}, {low}, {high})"

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
            form += self._gap(arguments, position, slot.offset)
            position = slot.offset
            for code, expression in self.values[slot]:
                form += code
                arguments.append(expression)
                position += struct.calcsize("<" + code)
        return form + self._gap(arguments, position, stop), arguments

    def _gap(self, arguments: list[str], start: int, stop: int) -> str:
        constant = bytes(self.data[start:stop])
        if not any(constant):
            return f"{stop - start}x" if constant else ""  # pad bytes are packed as zeros
        name = f"c{start}"
        self.space[name] = constant
        arguments.append(name)
        return f"{stop - start}s"


def _single(value: float) -> float:
    """Return what float32 can hold: struct raises beyond it, and encode must not."""
    if -SINGLE_MAX <= value <= SINGLE_MAX or value != value:
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


SCALAR_LIMIT = 8  # numbers of one field that still go through struct


@dataclass(frozen=True, eq=False)
class Copy:
    """An array copy: flat source elements at an even step to an even stride in the message.

    Attributes:
        source: number of the field.
        state: name of its state.
        view: the elements.
        offset: of the first in the message, [B].
        stride: from one to the next, [B].
        wire: type in the message.
        conversion: factor and summand per element; None where there is nothing to do.
    """

    source: int
    state: str
    view: AnyArray
    offset: int
    stride: int
    wire: np.dtype[Any]
    conversion: Conversion | None

    def target(self, data: bytearray) -> AnyArray:
        """Return the view of the message that it fills."""
        shape = self.view.shape
        return np.ndarray(shape, self.wire, data, self.offset, (self.stride,))


def as_copy(slots: list[Slot], bound: Bound) -> Copy | None:
    """Return the copy that fills the slots of one field; None where they go one by one."""
    primitive, conversion = slots[0].primitive, bound.conversion
    if primitive is None or len(slots) <= SCALAR_LIMIT:
        return None
    wire = np.dtype(primitive.dtype)
    if wire.kind != "f" and (conversion or not np.can_cast(bound.flat.dtype, wire, "safe")):
        return None  # rounding and saturation are spelled out number by number
    slots = sorted(slots, key=lambda slot: slot.offset)
    elements, stride = [slot.element for slot in slots], step([slot.offset for slot in slots])
    if stride is None or step(elements) is None:
        return None
    if conversion is not None:
        ranks = [slot.rank for slot in slots]
        conversion = conversion[0][ranks], conversion[1][ranks]
    view, state = line(bound.flat, elements), bound.field.source.name
    return Copy(slots[0].source, state, view, slots[0].offset, stride, wire, conversion)


def copy_lines(copies: list[Copy], data: bytearray) -> tuple[list[str], AnyDict]:
    """Return the lines of the copies, fused where distances are even, and the values they use."""
    lines: list[str] = []
    space: AnyDict = {}
    plain = sorted(filter(_plain, copies), key=lambda copy: copy.offset)
    for number, group in enumerate(fuse(plain, _form, _begins)):
        space[f"keep{number}"] = [copy.view for copy in group]  # alive with the function
        space[f"from{number}"] = stack([copy.view for copy in group])
        space[f"into{number}"] = stack([copy.target(data) for copy in group])
        names = ", ".join(copy.state for copy in group)
        lines.append(f"into{number}[...] = from{number}  # {names}")
    for copy in copies:
        if not _plain(copy):
            lines += _converted(copy, data, space)
    return lines, space


def _converted(copy: Copy, data: bytearray, space: AnyDict) -> list[str]:
    number = copy.source
    space |= {f"state{number}": copy.view, f"wire{number}": copy.target(data)}
    if copy.conversion is None:
        lines = [f"wire{number}[...] = state{number}  # {copy.state}"]
    else:
        space |= {
            f"work{number}": np.zeros(len(copy.view)),
            f"scale{number}": copy.conversion[0],
            f"offset{number}": copy.conversion[1],
            "multiply": np.multiply,
            "add": np.add,
        }
        lines = [f"work{number}[...] = state{number}  # {copy.state}"]
        lines.append(f"multiply(work{number}, scale{number}, work{number})")
        if copy.conversion[1].any():
            lines.append(f"add(work{number}, offset{number}, work{number})")
        lines.append(f"wire{number}[...] = work{number}")
    # Overflows to infinity are said in the contract; the warning must not reach a tick.
    space["quiet"] = partial(np.errstate, all="ignore")
    return ["with quiet():", *("    " + each for each in lines)]


def _plain(copy: Copy) -> bool:
    """Tell whether a copy converts nothing and can raise no floating point warning."""
    narrowed = copy.view.dtype == np.float64 and copy.wire == np.float32
    return copy.conversion is None and not narrowed


def _form(copy: Copy) -> object:
    view = copy.view
    return memory(view), view.shape, view.dtype, view.strides, copy.stride, copy.wire


def _begins(copy: Copy) -> tuple[int, int]:
    return copy.offset, address(copy.view)
