"""Checksums that some robots want inside a message: Unitree's CRC over its C structs.

Facts from unitreerobotics/unitree_ros2, example/src/src/common/motor_crc.cpp: polynomial
0x04c11db7, start 0xffffffff, most significant bit of each 32-bit word first, over the message as a
C struct (natural alignment, padding zero) without its last word, which is the checksum itself.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from unicon_msgs_map.layout.messages import PRIMITIVES, Array, Primitive, String, Struct, TypeRef
from unicon_msgs_map.spec import FieldSpec

# zlib's CRC has the same polynomial with bits reversed: reverse the input's and the result's.
_REVERSED = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))


def unitree_crc(field: FieldSpec, message: Struct, buffer: bytearray) -> Callable[[], int]:
    """Return a function that computes the checksum of what the buffer holds (about 3 µs).

    Args:
        field: the mapping's entry, which names the last field.
        message: its type.
        buffer: payload with header; its first byte is zero and stands for all padding.

    Raises:
        MapStateError: the message is not a C struct that ends in a uint32 checksum.
    """
    last = list(message.fields)[-1]
    if field.path != last or message.fields[last] is not PRIMITIVES["uint32"]:
        raise field.state_error(
            f"Unitree's checksum is a uint32 at the end of the message; "
            f"{message.name} ends in {last}"
        )
    places = _Places(field)
    places.walk(message)
    index = np.zeros(places.memory, np.intp)
    for wire, memory, size in places.pairs:
        index[memory : memory + size] = np.arange(wire, wire + size)
    return _crc_of(buffer, index[:-4])


def words_crc(buffer: bytearray, words: int) -> Callable[[], int]:
    """Return a function that computes the checksum of the first words of a buffer (about 2 µs).

    Args:
        buffer: little-endian 32-bit words without gaps, such as a datagram of unitree_legged_sdk.
        words: how many of them count.
    """
    return _crc_of(buffer, np.arange(4 * words))


def _crc_of(buffer: bytearray, index: NDArray[np.intp]) -> Callable[[], int]:
    """Return what computes the checksum of the words whose bytes stand at an index, low first."""
    index = np.ascontiguousarray(index.reshape(-1, 4)[:, ::-1]).reshape(-1)
    source = np.frombuffer(buffer, np.uint8)
    image = bytearray(len(index))
    target = np.frombuffer(image, np.uint8)

    def compute() -> int:
        source.take(index, None, target, "clip")
        value = zlib.crc32(image.translate(_REVERSED)) ^ 0xFFFFFFFF
        return int.from_bytes(value.to_bytes(4, "little").translate(_REVERSED), "big")

    return compute


class _Places:
    """Where each number lies on the wire and in the C struct."""

    def __init__(self, field: FieldSpec) -> None:
        self.field = field
        self.wire = 4
        self.memory = 0
        self.pairs: list[tuple[int, int, int]] = []

    def walk(self, kind: TypeRef) -> None:
        if isinstance(kind, Primitive):
            self.wire += -(self.wire - 4) % kind.size
            self.memory += -self.memory % kind.size
            self.pairs.append((self.wire, self.memory, kind.size))
            self.wire += kind.size
            self.memory += kind.size
        elif isinstance(kind, Struct):
            self.memory += -self.memory % _alignment(kind)
            for member in kind.fields.values():
                self.walk(member)
            self.memory += -self.memory % _alignment(kind)
        elif isinstance(kind, Array) and kind.length is not None:
            for _ in range(kind.length):
                self.walk(kind.item)
        else:
            raise self.field.state_error(
                "a message with strings or sequences is not a C struct; Unitree's checksum covers "
                "LowCmd and its kin"
            )


def _alignment(kind: TypeRef) -> int:
    if isinstance(kind, Primitive):
        return kind.size
    if isinstance(kind, Array):
        return _alignment(kind.item)
    if isinstance(kind, String):
        return 4
    return max(map(_alignment, kind.fields.values()))
