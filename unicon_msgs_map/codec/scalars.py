"""Numbers of a payload that are read one by one, on the fast path: their tests and writes."""

from __future__ import annotations

import numpy as np

from unicon_msgs_map.codec.binding import DOUBLE_MAX, SINGLE_MAX, limits
from unicon_msgs_map.codec.careful import UNIT, Run, state_of
from unicon_msgs_map.codec.code import Code
from unicon_msgs_map.layout.messages import Primitive


class Scalars(Code):
    """Writes the lines of single numbers, times, constants and zeros."""

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
