"""Bytes that are not a message of anybody: random ones, and messages that were cut or bent."""

from __future__ import annotations

import struct

import numpy as np

_HEADER = 4  # bytes that tell how a body is encoded


def garbage(rng: np.random.Generator, good: bytes) -> bytes:
    """Return bytes which no careful reader takes for a message of that type.

    They are never longer than a good message: Fast DDS refuses to write more of a type without
    arrays.

    Args:
        rng: draws.
        good: a message of the type, serialized.
    """
    size = int(rng.integers(1, len(good) - _HEADER))
    kind = rng.integers(4)
    if kind == 0:  # cut off anywhere, in the header too
        return good[:size]
    if kind == 1:  # an encoding that does not exist, then anything
        return b"\x7f" + rng.bytes(len(good) - 1)
    if kind == 2:  # noise, too short
        return b"\xff" + rng.bytes(size - 1)
    return good[:_HEADER] + b"\xff" * size  # NaN, and lengths of 4 GB


def random_bits(rng: np.random.Generator, good: bytes, numbers: int) -> bytes:
    """Return a whole message whose last numbers, of 64 bits, are random bits.

    Args:
        rng: draws.
        good: a message of the type, serialized.
        numbers: how many.
    """
    bits = (int(x) for x in rng.integers(1 << 64, size=numbers, dtype=np.uint64))
    return good[: -8 * numbers] + struct.pack(f"<{numbers}Q", *bits)
