"""Lines of a fast path: numbers that go one by one, and long arrays all at once, by NumPy.

Numbers that lie evenly are copied from where they lie; others, such as joints in an order of the
publisher's own, are gathered first. Measured (NumPy 2.4, Python 3.11, one warm core): one `take` of
all joints of a JointState 160 ns, the range test on their exponents 190 ns (`isfinite().all()`
1000 ns, a dot product warns), one strided cast-copy into three adjacent states 130 ns. In a queue
of ten topics, where caches are cold, the `take` costs three times that.

Which numbers are surely small enough is told by one byte of each, that with the sign and the upper
seven bits of the exponent, without a floating-point flag that could warn or raise.
"""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import as_strided

from unicon_base import AnyDict
from unicon_msgs_map.codec.binding import (
    DOUBLE_MAX,
    SINGLE_MAX,
    AnyArray,
    address,
    fuse,
    limits,
    line,
    memory,
    stack,
    step,
)
from unicon_msgs_map.codec.careful import UNIT, Run, state_of
from unicon_msgs_map.layout.messages import Primitive


class Code:
    """What the function of one payload is made of, collected by those who write its lines.

    Args:
        raw: the payload that was walked.
        order: its byte order for `struct`.
        reject: whether numbers that are not finite are refused.

    Attributes:
        space: values that the lines use, by name.
        checks: lines that look at constants.
        work: lines that read and test numbers.
        writes: lines that write states, after all tests.
        reads: `struct` code and variable of a number that is read by itself, by its offset.
        times: variable of a time by that of its seconds.
        values: what is written to a state one by one, by its name.
    """

    def __init__(self, raw: bytes, order: str, reject: bool) -> None:
        self.raw, self.order, self.reject = raw, order, reject
        self.space: AnyDict = {"size": len(raw)}
        self.checks: list[str] = []
        self.work: list[str] = []
        self.writes: list[str] = []
        self.reads: dict[int, tuple[str, str]] = {}
        self.times: dict[str, str] = {}
        self.values: dict[str, list[str]] = {}

    def stage(self) -> AnyArray:
        """Return the bytes of the present payload, where NumPy reads them, shape (len(raw),)."""
        if "staged" not in self.space:
            # The body starts at byte 4; numbers are aligned in it, so it is aligned in memory.
            room = bytearray(len(self.raw) + 16)
            bytes_ = np.frombuffer(room, np.uint8)
            self.shift = -(bytes_.__array_interface__["data"][0] + 4) % 8
            there = slice(self.shift, self.shift + len(self.raw))
            self.space |= {"staged": bytes_[there], "stage": memoryview(room)[there], "room": room}
        staged: AnyArray = self.space["staged"]
        return staged

    def read(self, offset: int, code: str) -> str:
        """Return the variable of a number that is read by itself."""
        if offset not in self.reads:
            self.reads[offset] = (code, f"v{len(self.reads)}")
        return self.reads[offset][1]

    def add(self, number: int, run: Run) -> None:
        """Write the lines of a run.

        Args:
            number: of the run, for the names of its values.
            run: what to read and where to write it.
        """
        if run.kind == "zero":
            self.space |= {f"z{number}": np.array(run.elements, np.intp), f"f{number}": run.flat}
            self.writes.append(f"f{number}[z{number}] = 0")
        elif run.kind == "unit":
            self._unit(run)
        elif run.primitive is None:
            self._time(number, run)
        elif run.kind == "required":
            assert run.target is not None
            self.space[f"r{number}"] = run.target.required
            name = self.read(run.offsets[0], run.primitive.code)
            self.checks.append(f"if {name} != r{number}: return False")
        elif run.kind == "told":
            covariance = self.read(run.offsets[0], run.primitive.code)
            self.checks.append(f"if {covariance} == -1.0: return False")
        else:
            self._numbers(number, run, run.primitive)

    def _element(self, number: int, position: int, run: Run) -> str:
        stamp = isinstance(run.flat, list)  # a third of the time of a memoryview
        self.space[f"w{number}"] = run.flat if stamp else memoryview(run.flat)
        self.space[f"e{number}_{position}"] = run.elements[position]
        return f"w{number}[e{number}_{position}]"

    def _time(self, number: int, run: Run) -> None:
        for position, offset in enumerate(run.offsets):
            sec, nanosec = self.read(offset, "i"), self.read(offset + 4, "I")
            value = self.times.get(sec)
            if value is None:  # the state and the decoder's own stamp are mostly the same
                value = self.times[sec] = f"t{number}_{position}"
                self.work.append(f"{value} = {sec} * 1000000000 + {nanosec}")
            if run.target is not None and run.flat.dtype != np.int64:
                self._between(number, run, value)
            self.writes.append(f"{self._element(number, position, run)} = {value}")

    def _unit(self, run: Run) -> None:
        parts = self.values.get(state_of(run), [])
        if len(parts) < len(run.offsets):  # of some number type that is read in bulk
            self.checks.append("return False")
            return
        self.space |= {"unit_low": UNIT[0], "unit_high": UNIT[1]}
        square = " + ".join(f"{part} * {part}" for part in parts)
        self.work.append(f"if not unit_low <= {square} <= unit_high: return False")

    def _numbers(self, number: int, run: Run, primitive: Primitive) -> None:
        dtype, conversion = run.flat.dtype, run.conversion
        wire = np.dtype(primitive.dtype)
        real = wire.kind == "f" or conversion is not None
        for position, (offset, rank) in enumerate(zip(run.offsets, run.ranks)):
            value = self.read(offset, primitive.code)
            if conversion is not None:
                scale, summand = f"a{number}_{position}", f"b{number}_{position}"
                self.space[scale] = float(conversion[0][rank])
                self.space[summand] = float(conversion[1][rank])
                self.work.append(f"x{number}_{position} = {value} * {scale} + {summand}")
                value = f"x{number}_{position}"
            self.values.setdefault(state_of(run), []).append(value)
            if dtype.kind == "f":
                narrow = dtype == np.float32 and (wire.itemsize == 8 or conversion is not None)
                if real and (self.reject or narrow):
                    self._finite(value, SINGLE_MAX if dtype == np.float32 else DOUBLE_MAX)
            elif dtype.kind == "b":
                if real and self.reject:
                    self._finite(value, DOUBLE_MAX)
                value = f"{value} != 0"
            elif real or not np.can_cast(wire, dtype, "safe"):
                self._between(number, run, value)
                value = f"round({value})"
            self.writes.append(f"{self._element(number, position, run)} = {value}")

    def _finite(self, value: str, largest: float) -> None:
        name = "single_max" if largest == SINGLE_MAX else "double_max"
        self.space[name] = largest
        self.work.append(f"if not -{name} <= {value} <= {name}: return False")

    def _between(self, number: int, run: Run, value: str) -> None:
        low, high = limits(run.flat.dtype)
        # floats next to the limit round beyond it; the careful path knows what to do with them
        self.space[f"low{number}"], self.space[f"high{number}"] = low, high
        self.work.append(f"if not low{number} <= {value} < high{number}: return False")


@dataclass(frozen=True)
class Grid:
    """Where the numbers of a group lie in a payload, [B].

    Attributes:
        start: of the first number.
        between: from a run to the next.
        step: from a number to the next.
    """

    start: int
    between: int
    step: int


def castable(run: Run) -> bool:
    """Tell whether NumPy's cast gives the value, with no rounding, saturation or wrapping."""
    assert run.primitive is not None
    wire, state = np.dtype(run.primitive.dtype), run.flat.dtype
    if wire.kind == "b" or state.kind == "b":
        return False
    if state.kind == "f":
        return True
    return run.conversion is None and bool(np.can_cast(wire, state, "safe"))


def read_in_bulk(code: Code, number: int, primitive: Primitive, runs: list[Run]) -> None:
    """Read all long runs of one wire type with one gather, write them with few copies."""
    stage = code.stage()
    wire = np.dtype(primitive.dtype).newbyteorder("<" if code.order == "<" else ">")
    converted = any(run.conversion for run in runs)
    groups = fuse(runs, _form, _begin)
    grids = [_grid_of(group) for group in groups]
    if wire.isnative and not converted and all(grids):
        _direct(code, number, wire, groups, [grid for grid in grids if grid])
        return
    flat = stage[4 : 4 + (len(stage) - 4) // wire.itemsize * wire.itemsize].view(wire)
    index = np.array([(o - 4) // wire.itemsize for r in runs for o in r.offsets], np.intp)
    room = bytearray(len(index) * wire.itemsize)
    read = np.frombuffer(room, wire.newbyteorder("="))
    code.space |= {f"index{number}": index, f"read{number}": read}
    if wire.isnative:
        code.space |= {f"take{number}": flat.take, "clip": "clip"}
        code.work.append(f"take{number}(index{number}, None, read{number}, clip)")
    else:
        code.space[f"flat{number}"] = flat
        code.work.append(f"read{number}[...] = flat{number}[index{number}]")
    if wire.kind == "f":
        code.space[f"room{number}"] = room
        whole = [slice(high_byte(wire), None, wire.itemsize)]
        _bounded(code, number, wire, f"room{number}", whole, whole, runs)
    result = _convert(code, number, runs) if converted else read
    start = 0
    for group in groups:
        count = sum(len(run.elements) for run in group)
        _copy(code, f"{number}_{start}", group, result[start : start + count])
        start += count


def _direct(
    code: Code, number: int, wire: np.dtype[Any], groups: list[list[Run]], grids: list[Grid]
) -> None:
    """Copy evenly spaced numbers from where they lie, without gathering them first."""
    stage = code.stage()
    if wire.kind == "f":
        high = code.shift + high_byte(wire)
        exact = [
            slice(high + min(run.offsets), high + max(run.offsets) + 1, abs(grid.step))
            for group, grid in zip(groups, grids)
            for run in group
        ]
        runs = [run for group in groups for run in group]
        _bounded(code, number, wire, "room", spans(exact), exact, runs)
    for index, (group, grid) in enumerate(zip(groups, grids)):
        first = stage[grid.start : grid.start + wire.itemsize].view(wire)
        shape = (len(group), len(group[0].offsets))
        piece = as_strided(first, shape, (grid.between, grid.step))
        _copy(code, f"{number}_{index}", group, piece if len(group) > 1 else piece[0])


def _convert(code: Code, number: int, runs: list[Run]) -> AnyArray:
    scales, summands = [], []
    for run in runs:
        for rank in run.ranks:
            scales.append(float(run.conversion[0][rank]) if run.conversion else 1.0)
            summands.append(float(run.conversion[1][rank]) if run.conversion else 0.0)
    real = np.zeros(len(scales))
    code.space |= {
        f"real{number}": real,
        f"scale{number}": np.array(scales),
        f"summand{number}": np.array(summands),
        "multiply": np.multiply,
        "add": np.add,
    }
    code.work.append(f"real{number}[...] = read{number}")
    code.work.append(f"multiply(real{number}, scale{number}, real{number})")
    code.work.append(f"add(real{number}, summand{number}, real{number})")
    return real


def _copy(code: Code, key: str, group: list[Run], piece: AnyArray) -> None:
    run = group[0]
    if len(group) == 1 and step(run.elements) is None:
        code.space |= {
            f"out{key}": run.flat,
            f"at{key}": np.array(run.elements, np.intp),
            f"piece{key}": piece,
        }
        code.writes.append(f"out{key}[at{key}] = piece{key}")
        return
    target = stack([line(member.flat, member.elements) for member in group])
    if len(group) > 1:
        piece = piece.reshape(target.shape)
        code.space[f"keep{key}"] = [member.flat for member in group]  # alive with the function
    code.space |= {f"out{key}": target, f"piece{key}": piece}
    code.writes.append(f"out{key}[...] = piece{key}")


def _bounded(
    code: Code,
    number: int,
    wire: np.dtype[Any],
    room: str,
    quick: list[slice],
    exact: list[slice],
    runs: list[Run],
) -> None:
    """Send a payload to the careful path if any number read may be beyond the bound.

    The high bytes of numbers that are surely small are deleted, and nothing must be left.

    Args:
        number: of the bulk.
        wire: type of the numbers.
        room: name of the bytes.
        quick: the high bytes, perhaps with some of the padding between the numbers.
        exact: those bytes alone.
        runs: where the numbers go.
    """
    bound = largest_of(runs, wire, code.reject)
    if bound is None:
        return
    code.space[f"ordinary{number}"] = ordinary_bytes(wire, bound)
    tests = []
    for kind, slices in (("quick", quick), ("exact", exact)):
        for i, highs in enumerate(slices):
            code.space[f"{kind}{number}_{i}"] = highs
        left = [
            f"{room}[{kind}{number}_{i}].translate(None, ordinary{number})"
            for i in range(len(slices))
        ]
        tests.append(" or ".join(left))
    test = tests[0] if quick == exact else f"({tests[0]}) and ({tests[1]})"
    code.work.append(f"if {test}: return False")


def _form(run: Run) -> object:
    distance = step(run.elements)
    if distance is None:
        return object()  # uneven: like no other
    return memory(run.flat), distance, len(run.elements), run.flat.dtype, run.flat.strides


def _begin(run: Run) -> tuple[int]:
    return (address(run.flat[run.elements[0] :]),)


def _grid_of(group: list[Run]) -> Grid | None:
    """Return how the numbers of runs of equal form lie in the payload; None if unevenly."""
    steps = {step(run.offsets) for run in group}
    between = step([run.offsets[0] for run in group]) if len(group) > 1 else 0
    spacing = steps.pop()
    if steps or between is None or spacing is None:
        return None
    return Grid(group[0].offsets[0], between, spacing)


GAP = 16  # bytes between two arrays of a message that are looked at along


def high_byte(wire: np.dtype[Any]) -> int:
    """Return which byte of a number in this machine's order has the sign."""
    return wire.itemsize - 1 if sys.byteorder == "little" else 0


def ordinary_bytes(wire: np.dtype[Any], bound: float) -> bytes:
    """Return the high bytes of numbers that are surely not beyond a bound, of either sign."""
    bias, spare = (1023, 4) if wire.itemsize == 8 else (127, 1)  # of the exponent; its lower bits
    largest = math.log2(max(bound, 5e-324))
    ordinary = [high for high in range(128) if ((high + 1) << spare) - bias <= largest]
    return bytes([*ordinary, *(128 + high for high in ordinary)])


def largest_of(runs: list[Run], wire: np.dtype[Any], reject: bool) -> float | None:
    """Return the size up to which every number is acceptable; None where any is.

    Args:
        runs: where the numbers go, and how they are converted.
        wire: their type in the message.
        reject: whether numbers that are not finite are refused.
    """
    bound = math.inf
    for run in runs:
        pair, single = run.conversion, run.flat.dtype == np.float32
        if not reject and pair is None and not (single and wire.itemsize == 8):
            continue
        largest = SINGLE_MAX if single or wire.itemsize == 4 else DOUBLE_MAX
        if pair is not None:  # with room for rounding; beyond it the careful path decides
            scale = max(float(np.abs(pair[0]).max()), 1.0)
            largest = max(largest / 2 - float(np.abs(pair[1]).max()), 0.0) / scale
        bound = min(bound, largest)
    return None if bound == math.inf else bound


def spans(slices: list[slice]) -> list[slice]:
    """Unite slices of one rhythm with little between them: fewer, perhaps with some bytes more."""
    united: list[slice] = []
    for each in sorted(slices, key=lambda each: each.start):
        last = united[-1] if united else None
        if last is not None and last.step == each.step:
            apart = each.start - last.stop
            if apart <= GAP and (each.start - last.start) % each.step == 0:
                united[-1] = slice(last.start, max(last.stop, each.stop), each.step)
                continue
        united.append(each)
    return united
