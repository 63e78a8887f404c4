"""The fast path: one generated function that reads a payload at the offsets a walk found.

The function first compares length and structural bytes with those that the walk saw. It returns
True when it wrote the states, None when the structure differs (walk again), and False when a
value needs the careful path. It never writes before every check has passed. This one reads a
`cmd_vel` of the default map:

    def decode(raw):
        if len(raw) != size: return None
        g0, v0, v1, v2, = unpack(raw)      # of "<4s2d24xd": header, vx, vy, wz
        if g0 != G0: return None
        if not -single_max <= v0 <= single_max: return False  # NaN too; and so v1, v2
        w0[e0_0] = v0                      # memoryviews of velocity_command, and so v1, v2
        return True

Everything but its own words is bound as a value. Numbers in long arrays go through NumPy
(`bulk.py`).
"""

from __future__ import annotations

import struct
from bisect import bisect_left
from collections.abc import Callable
from functools import lru_cache

import numpy as np

from unicon_core.generated import define
from unicon_msgs_map.codec.bulk import Code, castable, read_in_bulk
from unicon_msgs_map.codec.careful import DOUBLE_MAX, SINGLE_MAX, UNIT, Run, limits, state_of
from unicon_msgs_map.layout.messages import Primitive

__all__ = ["compile_fast", "merge"]

SCALAR_LIMIT = 8  # numbers of one field that are still read one by one
PIECES_LIMIT = 8  # structural pieces that are still compared one by one
BRIDGE = 16  # padding and unread bytes between structural ones that are compared along, [B]


def compile_fast(
    raw: bytes,
    order: str,
    hard: list[tuple[int, int]],
    runs: list[Run],
    nonfinite: str,
    loose: bool,
) -> Callable[[bytes], bool | None]:
    """Return the function for payloads that are built like `raw`.

    Args:
        raw: the payload that was walked.
        order: its byte order for `struct`.
        hard: byte ranges that fix the layout, merged.
        runs: what to read and where to write it.
        nonfinite: `reject` or `accept`.
        loose: compare structural bytes only, not the padding between them.
    """
    return _Fast(raw, order, hard, runs, nonfinite, loose).compile()


def merge(hard: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """Return byte ranges in ascending order, touching and overlapping ones united."""
    merged: list[tuple[int, int]] = []
    for start, end in sorted(hard):
        if merged and start <= merged[-1][1]:
            merged[-1] = (merged[-1][0], max(end, merged[-1][1]))
        else:
            merged.append((start, end))
    return merged


@lru_cache(maxsize=256)
def _maker(source: str) -> Callable[..., Callable[[bytes], bool | None]]:
    """Return what binds the constants of one payload: compiling takes 300 µs, calling this 3.

    Payloads that are built alike yield the same source, such as those of a publisher that keeps
    changing its joint order, or of two robots. Their functions share one code, so the constants
    are cells: as globals they would spoil each other's caches of Python's interpreter.
    """
    maker: Callable[..., Callable[[bytes], bool | None]] = define(source, {}, "<decode>")["make"]
    return maker


class _Fast(Code):
    def __init__(
        self,
        raw: bytes,
        order: str,
        hard: list[tuple[int, int]],
        runs: list[Run],
        nonfinite: str,
        loose: bool,
    ) -> None:
        super().__init__(raw, order, nonfinite == "reject")
        self.reads: dict[int, tuple[str, str]] = {}  # offset: struct code, variable
        self.times: dict[str, str] = {}  # variable of the seconds: variable of the time
        self.values: dict[str, list[str]] = {}  # state: what is written to it one by one
        bulk: dict[Primitive, list[Run]] = {}
        for number, run in enumerate(runs):
            if run.kind == "zero":
                self._zero(number, run)
            elif run.kind == "unit":
                self._unit(run)
            elif run.primitive is None:
                self._time(number, run)
            elif run.kind == "required":
                self._required(number, run, run.primitive)
            elif run.kind == "told":
                covariance = self._read(run.offsets[0], run.primitive.code)
                self.checks.append(f"if {covariance} == -1.0: return False")
            elif len(run.offsets) > SCALAR_LIMIT and castable(run):
                bulk.setdefault(run.primitive, []).append(run)
            else:
                self._scalars(number, run, run.primitive)
        for number, (primitive, members) in enumerate(bulk.items()):
            read_in_bulk(self, number, primitive, members)
        self.guards = self._guards(hard, [o for r in runs for o in r.offsets], loose)

    def compile(self) -> Callable[[bytes], bool | None]:
        """Generate and return the function."""
        body = ["if len(raw) != size: return None"]
        if len(self.guards) > PIECES_LIMIT:
            body += ["stage[:] = raw", *self._mask(), *self._unpack([])]
        else:
            body += self._unpack(self.guards)
            if "staged" in self.space:
                body.append("stage[:] = raw")
        body += self.checks
        body += self.work
        body += self.writes
        body.append("return True")
        lines = [
            f"def make({', '.join(self.space)}):",
            "    def decode(raw):",
            *(f"        {line}" for line in body),
            "    return decode",
        ]
        function = _maker("\n".join(lines))(**self.space)
        vars(function)["space"] = self.space  # what it writes to by address stays alive with it
        return function

    def _guards(
        self, hard: list[tuple[int, int]], offsets: list[int], loose: bool
    ) -> list[tuple[int, int]]:
        read = sorted(offsets)
        guards: list[tuple[int, int]] = []
        for start, end in hard:
            if guards and not loose and start - guards[-1][1] <= BRIDGE:
                before = guards[-1][1]
                if bisect_left(read, before) == bisect_left(read, start):
                    guards[-1] = (guards[-1][0], end)
                    continue
            guards.append((start, end))
        return guards

    def _mask(self) -> list[str]:
        """Compare many structural pieces at once: 300 ns for a payload of 1 kB."""
        mask = np.zeros(len(self.raw), np.uint8)
        for start, end in self.guards:
            mask[start:end] = 255
        kept = bytearray(len(self.raw))
        self.stage()
        self.space |= {
            "bitwise_and": np.bitwise_and,
            "mask": mask,
            "masked": np.frombuffer(kept, np.uint8),
            "kept": kept,
            "structure": (np.frombuffer(self.raw, np.uint8) & mask).tobytes(),
        }
        return ["bitwise_and(staged, mask, masked)", "if kept != structure: return None"]

    def _unpack(self, guards: list[tuple[int, int]]) -> list[str]:
        pieces: list[tuple[int, str, str]] = [
            (offset, code, name) for offset, (code, name) in self.reads.items()
        ]
        tests = []
        for number, (start, end) in enumerate(guards):
            pieces.append((start, f"{end - start}s", f"g{number}"))
            self.space[f"G{number}"] = self.raw[start:end]
            tests.append(f"g{number} != G{number}")
        form, position, names = self.order, 0, []
        for offset, code, name in sorted(pieces):
            form += f"{offset - position}x{code}"
            names.append(name)
            position = offset + struct.calcsize(self.order + code)
        form += f"{len(self.raw) - position}x"
        self.space["unpack"] = struct.Struct(form).unpack
        lines = [f"{', '.join(names)}, = unpack(raw)"] if names else []
        return [*lines, f"if {' or '.join(tests)}: return None"] if tests else lines

    def _read(self, offset: int, code: str) -> str:
        if offset not in self.reads:
            self.reads[offset] = (code, f"v{len(self.reads)}")
        return self.reads[offset][1]

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
            sec, nanosec = self._read(offset, "i"), self._read(offset + 4, "I")
            value = self.times.get(sec)
            if value is None:  # the state and the decoder's own stamp are mostly the same
                value = self.times[sec] = f"t{number}_{position}"
                self.work.append(f"{value} = {sec} * 1000000000 + {nanosec}")
            if run.target is not None and run.flat.dtype != np.int64:
                self._between(number, run, value)
            self.writes.append(f"{self._element(number, position, run)} = {value}")

    def _required(self, number: int, run: Run, primitive: Primitive) -> None:
        assert run.target is not None
        name = self._read(run.offsets[0], primitive.code)
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

    def _scalars(self, number: int, run: Run, primitive: Primitive) -> None:
        assert run.target is not None
        dtype, conversion = run.flat.dtype, run.target.conversion
        wire = np.dtype(primitive.dtype)
        real = wire.kind == "f" or conversion is not None
        for position, (offset, rank) in enumerate(zip(run.offsets, run.ranks)):
            value = self._read(offset, primitive.code)
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
