"""A guarded walk over a CDR payload: where is what, with every length checked before it is used.

The decoder's slow path. It knows message definitions, not NumPy: it finds the offsets of wanted
numbers, the text of wanted strings, and the structural bytes (lengths, wanted texts) that must
stay the same for those offsets to hold in the next message.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from functools import cache

from unicon_msgs_map.layout.messages import Array, Primitive, String, Struct, TypeRef
from unicon_msgs_map.layout.paths import Key, Path, Selector

CDR_BE = b"\x00\x00"
CDR_LE = b"\x00\x01"
# Writers may pad a payload to a multiple of four; more than that is another message.
MAX_TRAILING = 3
# rmw_fastrtps reserves alignment for empty sequences of 8-byte numbers that CDR does not use, and
# rclpy's serialize_message() keeps those bytes behind the message.
TRAILING_PER_EMPTY = 8


class Malformed(ValueError):
    """The payload is not a message of this type, or not one that the mapping accepts."""


@dataclass
class Want:
    """What is wanted below one point of a message: field numbers that end here, and deeper.

    Deeper are fields by name, and elements of an array by what selects them.
    """

    ends: list[int] = field(default_factory=list)
    fields: dict[str, Want] = field(default_factory=dict)
    elements: dict[Selector, Want] = field(default_factory=dict)

    def add(self, number: int, steps: Path, kind: TypeRef) -> None:
        """Want what a path ends at, under a field number."""
        if not steps:
            if isinstance(kind, Struct) and not kind.is_time:
                for name, member in kind.fields.items():
                    self.fields.setdefault(name, Want()).add(number, (), member)
            else:
                self.ends.append(number)
            return
        assert isinstance(kind, Struct)
        (name, selector), rest = steps[0], steps[1:]
        member = kind.fields[name]
        below = self.fields.setdefault(name, Want())
        if selector is None:
            below.add(number, rest, member)
            return
        assert isinstance(member, Array)
        below.elements.setdefault(selector, Want()).add(number, rest, member.item)


@dataclass
class WalkedFields:
    """What a walk found.

    Attributes:
        order: byte order for `struct`, `<` or `>`.
        numbers: per field number, (offset, primitive, count) runs in message order; a time is a
            run with primitive None.
        texts: per field number, strings in message order.
        hard: byte ranges that fix the layout: encapsulation, lengths, wanted texts; in any order.
    """

    order: str
    numbers: dict[int, list[tuple[int, Primitive | None, int]]] = field(default_factory=dict)
    texts: dict[int, list[str]] = field(default_factory=dict)
    hard: list[tuple[int, int]] = field(default_factory=list)


def walk(raw: bytes, message: Struct, want: Want) -> WalkedFields:
    """Walk a payload.

    Args:
        raw: encapsulation header and body.
        message: its type.
        want: what to report.

    Raises:
        Malformed: it is cut, too long, or holds a length that cannot be.
    """
    if len(raw) < 4:
        raise Malformed(f"{len(raw)} bytes are not a CDR payload; it starts with a 4-byte header")
    kind = raw[:2]
    if kind not in (CDR_LE, CDR_BE):
        raise Malformed(
            f"encapsulation 0x{kind.hex()} is not plain CDR (0x0000 big or 0x0001 little endian)"
        )
    walker = _Walker(raw, "<" if kind == CDR_LE else ">")
    end = walker.struct(message, 4, want)
    if len(raw) - end > MAX_TRAILING + TRAILING_PER_EMPTY * walker.empty:
        raise Malformed(f"{len(raw) - end} bytes are left over behind a whole {message.name}")
    return walker.found


class _Walker:
    def __init__(self, raw: bytes, order: str) -> None:
        self.raw = raw
        self.size = len(raw)
        self.empty = 0
        self.found = WalkedFields(order, hard=[(0, 4)])
        self.word = struct.Struct(order + "I").unpack_from

    def any(self, kind: TypeRef, at: int, want: Want | None) -> int:
        if isinstance(kind, Primitive):
            return self.numbers(kind, at, 1, want)
        if isinstance(kind, String):
            return self.string(kind, at, want)
        if isinstance(kind, Struct):
            return self.struct(kind, at, want)
        return self.array(kind, at, want)

    def struct(self, kind: Struct, at: int, want: Want | None) -> int:
        if want is None:
            size = static_size(kind, (at - 4) % 8)
            if size is not None:
                return self.need(at, size, kind.name)
        elif want.ends:  # a Time or Duration as a whole
            at += -at % 4
            for number in want.ends:
                self.found.numbers.setdefault(number, []).append((at, None, 1))
            if not want.fields:
                return self.need(at, 8, kind.name)
        fields = want.fields if want else {}
        for name, member in kind.fields.items():
            at = self.any(member, at, fields.get(name))
        return at

    def numbers(self, kind: Primitive, at: int, count: int, want: Want | None) -> int:
        at += -(at - 4) % kind.size
        end = self.need(at, count * kind.size, kind.name)
        wanted = [(want, 0, count)] if want else []
        if want:
            wanted += [(each, *_range(place, count)) for place, each in want.elements.items()]
        for each, start, stop in wanted:
            for number in each.ends if start < stop else ():
                run = (at + start * kind.size, kind, stop - start)
                self.found.numbers.setdefault(number, []).append(run)
        return end

    def string(self, kind: String, at: int, want: Want | None) -> int:
        at += -at % 4
        self.need(at, 4, "string length")
        length = int(self.word(self.raw, at)[0])
        start, end = at + 4, at + 4 + length
        if length > self.size - start:
            raise Malformed(f"a string of {length} bytes at {at} runs past the end ({self.size})")
        if length and self.raw[end - 1]:
            raise Malformed(f"the string at {at} does not end in NUL")
        if kind.bound and length - 1 > kind.bound:
            raise Malformed(f"the string at {at} is longer than its bound of {kind.bound}")
        if want is not None and want.ends:
            try:
                text = self.raw[start : max(start, end - 1)].decode()
            except UnicodeDecodeError:
                raise Malformed(f"the string at {at} is not UTF-8") from None
            for number in want.ends:
                self.found.texts.setdefault(number, []).append(text)
            self.found.hard.append((at, end))
        else:  # nobody reads the text; its length and its terminator must stay
            self.found.hard += [(at, start), (max(start, end - 1), end)]
        return end

    def array(self, kind: Array, at: int, want: Want | None) -> int:
        count, item = kind.length, kind.item
        if count is None:
            at += -at % 4
            self.need(at, 4, "sequence length")
            count = int(self.word(self.raw, at)[0])
            self.found.hard.append((at, at + 4))
            if kind.bound and count > kind.bound:
                raise Malformed(f"a sequence of {count} at {at} exceeds its bound of {kind.bound}")
            at += 4
            if count * _least(item) > self.size - at:
                raise Malformed(
                    f"a sequence of {count} at {at - 4} runs past the end ({self.size})"
                )
        if count == 0:
            self.empty += isinstance(item, Primitive) and item.size == 8
            return at
        if isinstance(item, Primitive):
            return self.numbers(item, at, count, want)
        if want is None:
            return self.skip(item, at, count)
        matched: set[Key] = set()
        for index in range(count):
            # Several selectors may meet in one element: it is walked for each.
            wants = self.below(want, item, at, index, matched) or [None]
            at = [self.any(item, at, each) for each in wants][-1]
        return at

    def below(
        self, want: Want, item: TypeRef, at: int, index: int, matched: set[Key]
    ) -> list[Want | None]:
        wants: list[Want | None] = [Want(ends=want.ends)] if want.ends else []
        for selector, inner in want.elements.items():
            if isinstance(selector, Key):
                if not self.key(item, at, selector):
                    continue
                if selector in matched:
                    raise Malformed(f"two elements have {selector.field} {selector.value!r}")
                matched.add(selector)
            elif index not in range(*_range(selector, index + 1)):
                continue
            wants.append(inner)
        return wants

    def key(self, item: TypeRef, at: int, key: Key) -> bool:
        """Tell whether an element's string has the wanted text, and make that text structural."""
        probe = _Walker(self.raw, self.found.order)
        inner = Want()
        inner.add(0, ((key.field, None),), item)
        probe.any(item, at, inner)
        self.found.hard += [piece for piece in probe.found.hard if piece != (0, 4)]
        return probe.found.texts[0][0] == key.value

    def skip(self, item: TypeRef, at: int, count: int) -> int:
        """Skip elements; those of fixed size are not visited once their rhythm is known."""
        seen: dict[int, tuple[int, int]] = {}
        index = 0
        while index < count:
            phase = (at - 4) % 8
            if phase in seen and static_size(item, phase) is not None:
                before, start = seen[phase]
                rounds = (count - index) // (index - before)
                at = self.need(at, rounds * (at - start), "sequence")
                index += rounds * (index - before)
                seen.clear()
                if index >= count:
                    break
            seen[phase] = (index, at)
            at = self.any(item, at, None)
            index += 1
        return at

    def need(self, at: int, size: int, what: str) -> int:
        end = at + size
        if end > self.size:
            raise Malformed(f"{what} at {at} runs past the end ({self.size} bytes)")
        return end


@cache
def static_size(kind: TypeRef, phase: int) -> int | None:
    """Return bytes that a type takes from an alignment phase (0 to 7) on; None where it varies."""
    if isinstance(kind, Primitive):
        return -phase % kind.size + kind.size
    if isinstance(kind, String):
        return None
    if isinstance(kind, Struct):
        members = list(kind.fields.values())
    elif kind.length is None:
        return None
    else:
        members = [kind.item] * kind.length
    total = 0
    for member in members:
        size = static_size(member, (phase + total) % 8)
        if size is None:
            return None
        total += size
    return total


def _least(kind: TypeRef) -> int:
    """Return the fewest bytes that one element can take."""
    if isinstance(kind, Primitive):
        return kind.size
    if isinstance(kind, String):
        return 4
    if isinstance(kind, Array):
        return 4 if kind.length is None else kind.length * _least(kind.item)
    return sum(map(_least, kind.fields.values()))


def _range(selector: Selector, count: int) -> tuple[int, int]:
    if isinstance(selector, int):
        return selector, min(selector + 1, count)
    assert not isinstance(selector, Key)
    return selector[0], count if selector[1] is None else min(selector[1], count)
