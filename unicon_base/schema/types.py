"""Types of documents: each reads a value, says what is wanted, and describes itself as JSON Schema.

A mistake is noted and reading goes on, so that all mistakes of a document are found at once.
`records` has the types of dataclasses, and makes types of Python's hints.
"""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from unicon_base import AnyDict, alternatives
from unicon_base.located_yaml import Where
from unicon_base.schema.marks import Matches, Size, Within

INVALID: Any = object()
"""What a reader returns where it noted a mistake."""


class Mistakes:
    """What was found in a document: where, and the words behind the place's name.

    Args:
        document: the whole document, whose entries may have a `name` that messages use.
        root: what messages call the document, where it is a part of another.
    """

    def __init__(self, document: Any = None, root: str = "") -> None:
        self.document, self.root = document, root
        self.found: list[tuple[Where, str]] = []

    def value(self, where: Where, text: str) -> Any:
        """Note what a value is: `rate is 3; write …`."""
        self.found.append((where, f"{self.place(where) or 'the document'} {text}"))
        return INVALID

    def note(self, where: Where, text: str, *below: str | int) -> Any:
        """Note something about a mapping: `scene: unknown key …`; `below` is the line's place."""
        place = self.place(where)
        self.found.append(
            ((*where, *below), f"{place}: {text}" if place and not text.startswith(place) else text)
        )
        return INVALID

    def missing(self, where: Where, key: str, wanted: str) -> None:
        """Note a key that has to be there."""
        self.note(where, f"missing key {key!r}; add {key}: {wanted}")

    def place(self, where: Where) -> str:
        """Return what messages call a place: keys with dots, entries by their name or topic."""
        value, words = self.document, [self.root] if self.root else []
        for key in where:
            try:
                value = value[key]
            except (KeyError, IndexError, TypeError):
                value = None
            entry = value if isinstance(key, int) and isinstance(value, dict) else {}
            name = entry.get("name", entry.get("topic"))
            words.append(name[:60] if isinstance(name, str) else str(key))
        return ".".join(words)


class Here:
    """Where a record stands, for the rule between its fields.

    Args:
        where: the place.
        mistakes: notes what is wrong.
        written: the record as it was written, with what is wrong by itself.
    """

    def __init__(self, where: Where, mistakes: Mistakes, written: Mapping[Any, Any]) -> None:
        self.where, self._mistakes, self.written = where, mistakes, written

    @property
    def document(self) -> Any:
        """The whole document as it was written."""
        return self._mistakes.document

    def value(self, text: str, *below: str | int) -> None:
        """Note what a value below is: `is 3; write …`."""
        self._mistakes.value((*self.where, *below), text)

    def note(self, text: str, *below: str | int) -> None:
        """Note something about the record; `below` is the line's place."""
        self._mistakes.note(self.where, text, *below)


def show(value: Any) -> str:
    """Return a value in the words of YAML, not of Python, at most 60 characters."""
    if value is None or isinstance(value, bool):
        return "null" if value is None else str(value).lower()
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}…"


class Type:
    """Anything: the base of all types."""

    wanted = "a value"
    nullable = False

    def accepts(self, value: Any) -> bool:
        """Return whether a value is of this kind at all, for unions."""
        return True

    def fits(self, value: Any) -> bool:
        """Return whether a value is right, but for what is inside it."""
        return self.accepts(value)

    def read(self, value: Any, where: Where, mistakes: Mistakes) -> Any:
        """Return the value as Python has it, or `INVALID` after noting what is wrong."""
        read = self.take if self.fits(value) else self.refuse
        return read(value, where, mistakes)

    def take(self, value: Any, where: Where, mistakes: Mistakes) -> Any:
        """Return what fits as Python has it, or `INVALID` after noting what is wrong inside it."""
        return value

    def json(self, definitions: AnyDict) -> AnyDict:
        """Return the JSON Schema; named records go to `definitions`."""
        return {}

    def refuse(self, value: Any, where: Where, mistakes: Mistakes) -> Any:
        """Note that a value is of another kind."""
        end = ", or null" if self.nullable else ""
        return mistakes.value(where, f"is {show(value)}; write {self.wanted}{end}")


class Plain(Type):
    """true or false, null, or a constant of `Literal`."""

    def __init__(self, values: tuple[Any, ...], wanted: str) -> None:
        self.values, self.wanted = values, wanted

    def accepts(self, value: Any) -> bool:
        return any(type(value) is type(each) for each in self.values)

    def read(self, value: Any, where: Where, mistakes: Mistakes) -> Any:
        if any(type(value) is type(each) and value == each for each in self.values):
            return value
        if isinstance(value, str) and len(self.values) > 1 and isinstance(self.values[0], str):
            known = alternatives(value, self.values)
            return mistakes.value(where, f"{show(value)} is not known; {known}")
        return self.refuse(value, where, mistakes)

    def json(self, definitions: AnyDict) -> AnyDict:
        if len(self.values) == 1:
            return {"const": self.values[0]}
        return {"type": "boolean"} if self.values[0] is True else {"enum": list(self.values)}


class Number(Type):
    """A number, whole or not, within bounds."""

    def __init__(self, whole: bool, bounds: Within, unit: str) -> None:
        self.whole, self.bounds, self.unit = whole, bounds, unit
        self.wanted = "a whole number" if whole else "a number"
        low, high = bounds.low, bounds.high
        if math.isfinite(low):
            self.wanted += f" above {low:g}" if bounds.above else f" from {low:g}"
        if math.isfinite(high):
            most = str(high) if whole else f"{high:.6g}"
            self.wanted += f" to {most}" if math.isfinite(low) else f" up to {most}"
        self.wanted += f" [{unit}]" if unit else ""

    def accepts(self, value: Any) -> bool:
        if getattr(value, "size", 0) == 1:  # NumPy's
            value = value.item()
        kinds = (int,) if self.whole else (int, float)
        return isinstance(value, kinds) and not isinstance(value, bool)

    def fits(self, value: Any) -> bool:
        bounds = self.bounds
        if not self.accepts(value) or (bounds.above and value == bounds.low):
            return False
        if isinstance(value, int):  # it may be too large for a float
            return abs(value) <= sys.float_info.max and bounds.low <= value <= bounds.high
        endless = bounds.endless and math.isinf(value) and (value > 0.0 or bounds.low < 0.0)
        return endless or (math.isfinite(value) and bounds.low <= value <= bounds.high)

    def take(self, value: Any, where: Where, mistakes: Mistakes) -> Any:
        return value if self.whole else float(value)

    def json(self, definitions: AnyDict) -> AnyDict:
        schema: AnyDict = {"type": "integer" if self.whole else "number"}
        if self.bounds.endless:
            return schema
        if math.isfinite(self.bounds.low):
            schema["exclusiveMinimum" if self.bounds.above else "minimum"] = self.bounds.low
        if math.isfinite(self.bounds.high):
            schema["maximum"] = self.bounds.high
        return schema


class Word(Type):
    """A text; a path in Python, too."""

    def __init__(self, matches: Matches | None, wanted: str) -> None:
        self.matches, self.wanted = matches, wanted

    def accepts(self, value: Any) -> bool:
        return isinstance(value, str | Path)

    def fits(self, value: Any) -> bool:
        if self.matches is None or not self.accepts(value):
            return self.accepts(value)
        short = len(str(value)) <= (self.matches.longest or math.inf)
        return short and re.fullmatch(self.matches.pattern, str(value)) is not None

    def json(self, definitions: AnyDict) -> AnyDict:
        if self.matches is None:
            return {"type": "string"}
        pattern = self.matches.pattern
        pattern = r"\S" if pattern.startswith("(?s)") else f"^({pattern})$"
        return _said(type="string", pattern=pattern, maxLength=self.matches.longest)


def _said(**entries: Any) -> AnyDict:
    """Return the entries of a JSON Schema that say something."""
    return {key: entry for key, entry in entries.items() if entry}


class _Listed(Type):
    def accepts(self, value: Any) -> bool:
        listed = isinstance(value, Sequence) or hasattr(value, "tolist")  # NumPy's
        return listed and not isinstance(value, str | bytes)


class ListOf(_Listed):
    """A list of any length, each entry of one type, which is made a list or a tuple."""

    def __init__(self, entry: Type, size: Size, example: str, made: type = list) -> None:
        self.entry, self.size, self.made = entry, size, made
        self.wanted = example or f"a list, each {entry.wanted}"

    def fits(self, value: Any) -> bool:
        least, most = self.size
        return self.accepts(value) and least <= len(value) <= (math.inf if most is None else most)

    def take(self, value: Any, where: Where, mistakes: Mistakes) -> Any:
        found = [self.entry.read(each, (*where, i), mistakes) for i, each in enumerate(value)]
        return INVALID if any(each is INVALID for each in found) else self.made(found)

    def json(self, definitions: AnyDict) -> AnyDict:
        schema = {"type": "array", "items": self.entry.json(definitions)}
        return schema | _said(minItems=self.size.least, maxItems=self.size.most)


class TupleOf(_Listed):
    """A list of a fixed length, such as a point."""

    def __init__(self, entries: tuple[Type, ...], example: str) -> None:
        self.entries = entries
        of = entries[0].wanted.removeprefix("a ")
        alike = all(each.wanted == entries[0].wanted for each in entries)
        listed = f"a list of {len(entries)}" + (f", each a {of}" if alike else "")
        self.wanted = example or listed

    def fits(self, value: Any) -> bool:
        return self.accepts(value) and len(value) == len(self.entries)

    def take(self, value: Any, where: Where, mistakes: Mistakes) -> Any:
        pairs = enumerate(zip(self.entries, value))
        found = tuple(entry.read(each, (*where, i), mistakes) for i, (entry, each) in pairs)
        return INVALID if any(each is INVALID for each in found) else found

    def json(self, definitions: AnyDict) -> AnyDict:
        entries = [entry.json(definitions) for entry in self.entries]
        count = len(entries)
        same = {"items": entries[0]} if entries == entries[:1] * count else {"prefixItems": entries}
        return {"type": "array", **same, "minItems": count, "maxItems": count}


class MapOf(Type):
    """A mapping of names to values of one type."""

    def __init__(self, key: Type, entry: Type, size: Size, example: str) -> None:
        self.key, self.entry, self.size = key, entry, size
        self.wanted = example or f"a mapping of {key.wanted} to {entry.wanted}"

    def accepts(self, value: Any) -> bool:
        return isinstance(value, Mapping)

    def fits(self, value: Any) -> bool:
        return self.accepts(value) and len(value) >= self.size.least

    def take(self, value: Any, where: Where, mistakes: Mistakes) -> Any:
        found = {}
        for key, each in value.items():
            if self.key.read(key, where, Mistakes()) is INVALID:
                remedy = f"write {self.key.wanted}"
                if isinstance(self.key, Plain):
                    remedy = alternatives(str(key), self.key.values)
                found[key] = mistakes.note(where, f"unknown key {show(key)}; {remedy}", key)
            else:
                found[key] = self.entry.read(each, (*where, key), mistakes)
        return INVALID if any(each is INVALID for each in found.values()) else found

    def json(self, definitions: AnyDict) -> AnyDict:
        keys = self.key.json(definitions)
        names = keys if keys != {"type": "string"} else {}
        schema = _said(type="object", propertyNames=names, minProperties=self.size.least)
        return schema | {"additionalProperties": self.entry.json(definitions)}


class OneOf(Type):
    """A union: the kind of the value decides which member reads it."""

    def __init__(self, members: tuple[Type, ...]) -> None:
        self.members = members
        self.wanted = " or ".join(dict.fromkeys(each.wanted for each in members))
        null = [each for each in members if isinstance(each, Plain) and each.values == (None,)]
        self.null = bool(null)
        for each in members if null else ():
            each.nullable = True

    def accepts(self, value: Any) -> bool:
        return any(each.accepts(value) for each in self.members)

    def read(self, value: Any, where: Where, mistakes: Mistakes) -> Any:
        if value is None and self.null:
            return None
        fitting = [each for each in self.members if each.accepts(value)]
        tried = mistakes
        for member in fitting:
            tried = type(mistakes)(mistakes.document, mistakes.root)
            found = member.read(value, where, tried)
            if found is not INVALID:
                return found
        others = not all(isinstance(each, Plain) for each in self.members)
        if not fitting or (others and all(isinstance(each, Plain) for each in fitting)):
            return self.refuse(value, where, mistakes)  # a word that is none, or a number
        mistakes.found += tried.found
        return INVALID

    def json(self, definitions: AnyDict) -> AnyDict:
        return {"anyOf": [each.json(definitions) for each in self.members]}
