"""Code: the decoding function of one payload; here the lines of numbers that go one by one."""

from __future__ import annotations

from typing import Any

import numpy as np

from unicon_msgs_map.codec.binding import DOUBLE_MAX, SINGLE_MAX, AnyArray, limits
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
        self.space: dict[str, Any] = {"size": len(raw)}
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
            bytes_: AnyArray = np.frombuffer(room, np.uint8)
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
            self._zero(number, run)
        elif run.kind == "unit":
            self._unit(run)
        elif run.primitive is None:
            self._time(number, run)
        elif run.kind == "required":
            self._required(number, run, run.primitive)
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

    def _zero(self, number: int, run: Run) -> None:
        self.space[f"z{number}"] = np.array(run.elements, dtype=np.intp)
        self.space[f"f{number}"] = run.flat
        self.writes.append(f"f{number}[z{number}] = 0")

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

    def _required(self, number: int, run: Run, primitive: Primitive) -> None:
        assert run.target is not None
        name = self.read(run.offsets[0], primitive.code)
        self.space[f"r{number}"] = run.target.required
        self.checks.append(f"if {name} != r{number}: return False")

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
