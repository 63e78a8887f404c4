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

Everything but its own words is bound as a value. The lines about single numbers come from
`scalars.py`, those about long arrays, which NumPy reads, from `bulk.py`.
"""

from __future__ import annotations

import struct
from bisect import bisect_left
from collections.abc import Callable
from functools import lru_cache

import numpy as np

from unicon_core.generated import define
from unicon_msgs_map.codec.bulk import castable, read_in_bulk
from unicon_msgs_map.codec.careful import Run
from unicon_msgs_map.codec.code import Code
from unicon_msgs_map.codec.scalars import Scalars
from unicon_msgs_map.layout.messages import Primitive

__all__ = ["Fast", "merge"]

SCALAR_LIMIT = 8  # numbers of one field that are still read one by one
PIECES_LIMIT = 8  # structural pieces that are still compared one by one
BRIDGE = 16  # padding and unread bytes between structural ones that are compared along, [B]


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


class Fast(Code):
    """The function for payloads that are built like one: structure, then tests, then writes.

    Args:
        raw: the payload that was walked.
        order: its byte order for `struct`.
        hard: byte ranges that fix the layout, merged.
        runs: what to read and where to write it.
        reject: whether numbers that are not finite are refused.
        loose: compare structural bytes only, not the padding between them.
    """

    def __init__(
        self,
        raw: bytes,
        order: str,
        hard: list[tuple[int, int]],
        runs: list[Run],
        reject: bool,
        loose: bool,
    ) -> None:
        super().__init__(raw, order, reject)
        scalars = Scalars(self)
        bulk: dict[Primitive, list[Run]] = {}
        for number, run in enumerate(runs):
            many = run.kind == "number" and len(run.offsets) > SCALAR_LIMIT
            if many and run.primitive is not None and castable(run):
                bulk.setdefault(run.primitive, []).append(run)
            else:
                scalars.add(number, run)
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
