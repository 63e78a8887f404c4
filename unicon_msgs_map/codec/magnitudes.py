"""Which floating-point numbers are surely small enough, by one byte of each; for the fast path.

The byte with the sign and the upper seven bits of the exponent tells, without a floating-point flag
that could warn or raise.
"""

from __future__ import annotations

import math
import sys
from typing import Any

import numpy as np

from unicon_msgs_map.codec.careful import Run
from unicon_msgs_map.codec.ranges import DOUBLE_MAX, SINGLE_MAX

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
