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

from unicon_base.generated import define
from unicon_msgs_map.codec.bulk import Code, castable, read_in_bulk
from unicon_msgs_map.codec.careful import Run
from unicon_msgs_map.layout.messages import Primitive

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


def compile_fast(
    raw: bytes,
    order: str,
    hard: list[tuple[int, int]],
    runs: list[Run],
    reject: bool,
    loose: bool,
) -> Callable[[bytes], bool | None]:
    """Generate and return the function for payloads that are built like one.

    Args:
        raw: the payload that was walked.
        order: its byte order for `struct`.
        hard: byte ranges that fix the layout, merged.
        runs: what to read and where to write it.
        reject: whether numbers that are not finite are refused.
        loose: compare structural bytes only, not the padding between them.
    """
    code = Code(raw, order, reject)
    bulk: dict[Primitive, list[Run]] = {}
    for number, run in enumerate(runs):
        many = run.kind == "number" and len(run.offsets) > SCALAR_LIMIT
        if many and run.primitive is not None and castable(run):
            bulk.setdefault(run.primitive, []).append(run)
        else:
            code.add(number, run)
    for number, (primitive, members) in enumerate(bulk.items()):
        read_in_bulk(code, number, primitive, members)
    guards = hard if loose else _bridged(hard, sorted(o for r in runs for o in r.offsets))
    body = ["if len(raw) != size: return None"]
    if len(guards) > PIECES_LIMIT:
        body += ["stage[:] = raw", *_mask(code, guards), *_unpack(code, [])]
    else:
        body += _unpack(code, guards)
        if "staged" in code.space:
            body.append("stage[:] = raw")
    body += [*code.checks, *code.work, *code.writes, "return True"]
    lines = [
        f"def make({', '.join(code.space)}):",
        "    def decode(raw):",
        *(f"        {line}" for line in body),
        "    return decode",
    ]
    function = _maker("\n".join(lines))(**code.space)
    vars(function)["space"] = code.space  # what it writes to by address stays alive with it
    return function


def _bridged(hard: list[tuple[int, int]], read: list[int]) -> list[tuple[int, int]]:
    """Return the pieces to compare, near ones united where nothing between them is read."""
    guards: list[tuple[int, int]] = []
    for start, end in hard:
        before = guards[-1][1] if guards else -BRIDGE - 1
        if start - before <= BRIDGE and bisect_left(read, before) == bisect_left(read, start):
            guards[-1] = (guards[-1][0], end)
        else:
            guards.append((start, end))
    return guards


def _mask(code: Code, guards: list[tuple[int, int]]) -> list[str]:
    """Compare many structural pieces at once: 300 ns for a payload of 1 kB."""
    mask = np.zeros(len(code.raw), np.uint8)
    for start, end in guards:
        mask[start:end] = 255
    kept = bytearray(len(code.raw))
    code.stage()
    code.space |= {
        "bitwise_and": np.bitwise_and,
        "mask": mask,
        "masked": np.frombuffer(kept, np.uint8),
        "kept": kept,
        "structure": (np.frombuffer(code.raw, np.uint8) & mask).tobytes(),
    }
    return ["bitwise_and(staged, mask, masked)", "if kept != structure: return None"]


def _unpack(code: Code, guards: list[tuple[int, int]]) -> list[str]:
    pieces = [(offset, form, name) for offset, (form, name) in code.reads.items()]
    tests = []
    for number, (start, end) in enumerate(guards):
        pieces.append((start, f"{end - start}s", f"g{number}"))
        code.space[f"G{number}"] = code.raw[start:end]
        tests.append(f"g{number} != G{number}")
    whole, position, names = code.order, 0, []
    for offset, form, name in sorted(pieces):
        whole += f"{offset - position}x{form}"
        names.append(name)
        position = offset + struct.calcsize(code.order + form)
    whole += f"{len(code.raw) - position}x"
    code.space["unpack"] = struct.Struct(whole).unpack
    lines = [f"{', '.join(names)}, = unpack(raw)"] if names else []
    return [*lines, f"if {' or '.join(tests)}: return None"] if tests else lines
