"""Records of documents: dataclasses whose fields are the keys of a mapping, and types of hints.

`type_of` makes a type of Python's hints: bool, int, float, str, None, Literal, lists, fixed tuples,
mappings, unions by the kind of value, and dataclasses.
"""

from __future__ import annotations

import dataclasses
import inspect
import math
import re
import types
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from difflib import get_close_matches
from functools import cached_property, lru_cache
from pathlib import Path
from pkgutil import resolve_name
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

from unicon_base import AnyDict, UniconError, alternatives
from unicon_base.located_yaml import Where
from unicon_base.schema.marks import (
    Checked,
    Key,
    Later,
    Like,
    Made,
    Matches,
    NotAKey,
    Size,
    Unit,
    Within,
    Write,
)
from unicon_base.schema.types import (
    INVALID,
    Here,
    ListOf,
    MapOf,
    Mistakes,
    Number,
    OneOf,
    Plain,
    TupleOf,
    Type,
    Word,
    show,
)


@dataclasses.dataclass(eq=False)
class Field:
    """A key of a record: its type, whether it may be left out, and what it is.

    Attributes:
        key: in the file.
        hint: of its type, which is made when it is asked for.
        required: whether it has to be there.
        default: where it is not.
        text: what it is.
    """

    key: str
    hint: Any
    required: bool
    default: Any
    text: str

    @cached_property
    def type(self) -> Type:
        """The type."""
        return type_of(self.hint)


class Record(Type):
    """A mapping whose keys are the fields of a dataclass, or the options of a factory.

    Args:
        made: what is made of the values: called with them by name.
        fields: attribute to field.
        example: for the remedy, "" for none.
        raw: the mapping itself is the value.
        is_open: keys that are not known are allowed.
    """

    def __init__(
        self,
        made: Callable[..., Any],
        fields: dict[str, Field],
        example: str = "",
        raw: bool = False,
        is_open: bool = False,
    ) -> None:
        self.made, self.fields, self.raw, self.is_open = made, fields, raw, is_open
        self.keys = {field.key: name for name, field in fields.items()}
        self.name = getattr(made, "__name__", "")
        self.wanted = example or f"a mapping with {', '.join(self.keys)}"

    def accepts(self, value: Any) -> bool:
        made = inspect.isclass(self.made) and isinstance(value, self.made)
        return made or isinstance(value, Mapping)

    def take(self, value: Any, where: Where, mistakes: Mistakes) -> Any:
        if not isinstance(value, Mapping):
            return value  # of Python
        before = len(mistakes.found)
        self.check_keys(value, where, mistakes)
        found = {}
        for name, field in self.fields.items():
            given = value.get(field.key)
            if field.key not in value or (
                given is None and not (field.required or self.raw) and not field.type.accepts(None)
            ):
                continue  # null is as if it were left out
            found[name] = field.type.read(given, (*where, field.key), mistakes)
        rule = getattr(self.made, "between", None)
        if rule is not None:
            sound = {name: each for name, each in found.items() if each is not INVALID}
            rule(sound, Here(where, mistakes, value))
        if len(mistakes.found) > before:
            return INVALID
        if self.raw:
            return value
        try:
            return self.made(**found)
        except UniconError as error:
            return mistakes.note(where, error.message)

    def check_keys(self, value: Mapping[Any, Any], where: Where, mistakes: Mistakes) -> None:
        """Note unknown and missing keys; a missing one that is misspelt is noted once."""
        required = [field for field in self.fields.values() if field.required]
        missing = [field for field in required if field.key not in value]
        misspelt: list[str] = []
        for key in value if not self.is_open else ():
            if key not in self.keys:
                misspelt += meant(key, [field.key for field in missing])
                known = alternatives(str(key), self.keys)
                remedy = getattr(self.made, "remedies", {}).get(key, known)
                mistakes.note(where, f"unknown key {show(key)}; {remedy}", key)
        for field in missing:
            if field.key not in misspelt:
                mistakes.missing(where, field.key, field.type.wanted)

    def json(self, definitions: AnyDict) -> AnyDict:
        if self.name not in definitions:
            definitions[self.name] = {}  # a record may hold itself
            schema = {"type": "object", "additionalProperties": self.is_open}
            required = [field.key for field in self.fields.values() if field.required]
            schema |= {"required": required} if required else {}
            schema["properties"] = {
                field.key: field.type.json(definitions)
                | ({"description": field.text} if field.text else {})
                for field in self.fields.values()
            }
            definitions[self.name] = schema
        return {"$ref": f"#/$defs/{self.name}"}


def meant(key: Any, known: Sequence[str]) -> list[str]:
    """Return the key that a misspelt, longer or shorter one stands for, if any."""
    word = str(key)[:80]
    alike = [other for other in known if word.startswith(other) or other.startswith(word)]
    return get_close_matches(word, known, n=1) or (alike if word else [])[:1]


def largest(kind: Type) -> float:
    """Return the upper bound of a number or of null; infinity where there is none."""
    if isinstance(kind, OneOf):
        return min(map(largest, kind.members))
    return kind.bounds.high if isinstance(kind, Number) else math.inf


class _Wrapped(Type):
    inner: Type

    def accepts(self, value: Any) -> bool:
        return self.inner.accepts(value)

    def read(self, value: Any, where: Where, mistakes: Mistakes) -> Any:
        return self.inner.read(value, where, mistakes)

    def json(self, definitions: AnyDict) -> AnyDict:
        return self.inner.json(definitions)


class MadeOf(_Wrapped):
    """What a function makes of a value of another type."""

    def __init__(self, function: Callable[[Any], Any], inner: Type, example: str) -> None:
        self.function, self.inner, self.wanted = function, inner, example or inner.wanted

    def read(self, value: Any, where: Where, mistakes: Mistakes) -> Any:
        self.inner.nullable = self.nullable
        found = super().read(value, where, mistakes)
        try:
            return found if found is INVALID else self.function(found)
        except UniconError as error:
            return mistakes.value(where, error.message)


class LaterType(_Wrapped):
    """A type whose module is imported when it is needed."""

    def __init__(self, target: str, example: str) -> None:
        self.target, self.wanted = target, example or "a mapping"

    @property
    def inner(self) -> Type:  # type: ignore[override]
        """The type."""
        found = resolve_name(self.target)
        return found if isinstance(found, Type) else type_of(found)


def _checked(rules: Sequence[Checked]) -> Callable[[Any], Any]:
    """Return what refuses a value that is against a rule."""

    def check(value: Any) -> Any:
        said = () if value is None else (rule.wrong(value) for rule in rules)  # null, where allowed
        if wrong := next(filter(None, said), ""):
            raise UniconError(wrong)
        return value

    return check


def type_of(hint: Any) -> Type:
    """Return the type of a hint, with the marks of `Annotated`.

    Raises:
        TypeError: documents have no such type.
    """
    marks: list[Any] = []
    while get_origin(hint) is Annotated:
        hint, *more = get_args(hint)
        marks = [*more, *marks]
    if dataclasses.is_dataclass(hint) and not marks:
        return record_of(hint)
    made = _bare(hint, marks)
    rules = [mark for mark in marks if isinstance(mark, Checked)]
    return MadeOf(_checked(rules), made, "") if rules else made


def _one(marks: list[Any], kind: type, default: Any) -> Any:
    found = [mark for mark in marks if isinstance(mark, kind)]
    return found[-1] if found else default


def _bare(hint: Any, marks: list[Any]) -> Type:
    origin, inner = get_origin(hint), get_args(hint)
    example = _one(marks, Write, Write("")).example
    made, later = _one(marks, Made, None), _one(marks, Later, None)
    if later is not None:
        return LaterType(later.target, example)
    if made is not None:
        return MadeOf(made.function, type_of(made.of), example)
    size = _one(marks, Size, Size())
    if dataclasses.is_dataclass(hint):
        return record_of(hint, example)
    if origin in (Union, types.UnionType):
        return OneOf(tuple(type_of(Annotated[(each, *marks)] if marks else each) for each in inner))
    if origin is Literal:
        return Plain(inner, example or " or ".join(map(show, inner)).replace("'", ""))
    if hint in (None, type(None)):
        return Plain((None,), "null")
    if hint is bool:
        return Plain((True, False), "true or false")
    if hint in (int, float):
        bounds = _one(marks, Within, Within())
        number = Number(hint is int, bounds, _one(marks, Unit, Unit(bounds.unit)).symbol)
        number.wanted = example or number.wanted
        return number
    if hint in (str, Path):
        matches = _one(marks, Matches, None)
        wanted = matches.wanted if matches else "a path" if hint is Path else "a text"
        return Word(matches, example or wanted)
    if hint in (dict, Mapping):
        return MapOf(Type(), Type(), size, example or "a mapping")
    if isinstance(origin, type) and issubclass(origin, Mapping):
        like = _one(marks, Like, None)
        if like is not None:
            return Record(like.kind, record_of(like.kind).fields, example, True, like.open)
        return MapOf(type_of(inner[0]), type_of(inner[1]), size, example)
    if hint is list:
        return ListOf(Type(), size, example or "a list")
    if origin is tuple and inner[-1] is not Ellipsis:
        return TupleOf(tuple(map(type_of, inner)), example)
    if isinstance(origin, type) and issubclass(origin, Sequence):
        return ListOf(type_of(inner[0]), size, example, tuple if origin is tuple else list)
    if hint is Any or hint is object:
        return Type()
    raise TypeError(f"{hint!r} is no type of a document")


def record_of(kind: Any, example: str = "") -> Record:
    """Return the type of a dataclass: its fields are the keys; their texts stand in its docstring.

    A field is required unless it has a default. A static method `between(found, here)` of the class
    may note what lies between fields; `found` has the values that are right, by attribute.
    """
    if (kind, example) not in _RECORDS:
        _RECORDS[kind, example] = Record(kind, _fields(kind), example)
    return _RECORDS[kind, example]


_RECORDS: dict[tuple[Any, str], Record] = {}


def _fields(kind: Any) -> dict[str, Field]:
    hints = get_type_hints(kind, include_extras=True)
    texts: dict[str, str] = {}
    for base in kind.__mro__[::-1]:
        texts |= described(inspect.cleandoc(base.__doc__ or ""))
    fields = {}
    for each in dataclasses.fields(kind):
        if not each.init:
            continue
        marks = get_args(hints[each.name]) if get_origin(hints[each.name]) is Annotated else ()
        if any(isinstance(mark, NotAKey) for mark in marks):
            continue
        factory = each.default_factory
        default = each.default if factory is dataclasses.MISSING else factory()
        required = default is dataclasses.MISSING
        default = None if required else default
        said = next((mark for mark in marks if isinstance(mark, str)), texts.get(each.name, ""))
        key = _one(list(marks), Key, Key(each.name)).name
        fields[each.name] = Field(key, hints[each.name], required, default, said)
    return fields


@lru_cache(256)
def option_hints(factory: Callable[..., Any]) -> AnyDict:
    """Return the hints of what a function, or a class, takes by name; {} where they say nothing."""
    target = factory.__init__ if inspect.isclass(factory) else factory
    try:
        return get_type_hints(target, include_extras=True)
    except (AttributeError, NameError, SyntaxError, TypeError):  # not written for files
        return {}


@lru_cache(1024)
def option_type(factory: Callable[..., Any], name: str) -> Type | None:
    """Return the type of an option, None where a file cannot say it."""
    hints = option_hints(factory)
    with suppress(TypeError):
        return _unbounded(type_of(hints[name])) if name in hints else None
    return None


def _unbounded(kind: Type) -> Type:
    """Let numbers without bounds be infinite: a factory says better what its bounds are."""
    if isinstance(kind, Number) and kind.bounds == Within():
        kind.bounds = Within(endless=True)
    for inner in (*getattr(kind, "members", ()), *getattr(kind, "entries", ())):
        _unbounded(inner)
    if isinstance(kind, ListOf | MapOf):
        _unbounded(kind.entry)
    return kind


@lru_cache(256)
def described(docstring: str) -> dict[str, str]:
    """Return what a docstring says under `Args:` or `Attributes:`, name to text."""
    found: dict[str, str] = {}
    names: list[str] = []
    inside = False
    for line in docstring.splitlines():
        if line in ("Args:", "Attributes:"):
            inside = True
        elif line.strip() and not line.startswith(" "):
            inside = False
        elif inside and (entry := re.match(r"    (\w[\w, ]*?)(?: \(.*?\))?: (.*)", line)):
            names = entry[1].split(", ")
            found |= dict.fromkeys(names, entry[2])
        elif inside and line.strip() and names:
            found |= {name: f"{found[name]} {line.strip()}" for name in names}
    return found
