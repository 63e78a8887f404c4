"""Attributes of an object without its `__dict__`, for the walk: to ask for that would slow it down.

CPython 3.11 keeps an object's attributes inside it until somebody wants its dictionary; from then
on, for good, each of them is looked up there: 40 µs of a cold tick of a policy at 50 Hz. Names that
the methods of its class mention are tried, and what the garbage collector sees of the object tells
whether all were found. Otherwise it is the dictionary after all.
"""

from __future__ import annotations

import gc
from collections import Counter
from collections.abc import Iterator
from functools import lru_cache
from types import CodeType, FunctionType
from typing import Any

__all__ = ["Attributes", "attributes_of"]

_ABSENT = object()


class Attributes:
    """What an object holds, as an owner of values under names."""

    def __init__(self, owner: Any) -> None:
        self._owner = owner

    def __getitem__(self, name: int | str) -> Any:
        try:
            return getattr(self._owner, str(name))
        except AttributeError:
            raise KeyError(name) from None

    def __setitem__(self, name: int | str, value: Any) -> None:
        object.__setattr__(self._owner, str(name), value)


def attributes_of(owner: Any) -> dict[str, Any] | None:
    """Return an object's own attributes by name; None where only its dictionary knows them all."""
    kind: Any = type(owner)
    names = _names(kind)
    if names is None:
        return None
    left = Counter(map(id, gc.get_referents(owner)))
    left[id(kind)] -= 1
    found: dict[str, Any] = {}
    for name in names:
        value = getattr(owner, name, _ABSENT)
        if value is _ABSENT:
            continue
        if value is getattr(kind, name, _ABSENT):
            return None  # nobody can tell whose it is
        if left[id(value)] > 0:
            left[id(value)] -= 1
            found[name] = value
    return None if any(count > 0 for count in left.values()) else found


@lru_cache(maxsize=512)
def _names(kind: type) -> tuple[str, ...] | None:
    """Return the names that may be attributes of a class's objects, None where it makes its own."""
    names: set[str] = set()
    for each in kind.__mro__[:-1]:
        if "__getattr__" in vars(each) or "__getattribute__" in vars(each):
            return None
        said = vars(each).get("__annotations__", {})
        names.update(said if isinstance(said, dict) else ())  # Cython's functions have a descriptor
        for value in vars(each).values():
            function = getattr(value, "__func__", getattr(value, "fget", value))
            if isinstance(function, FunctionType):
                names.update(_mentioned(function.__code__))
    return tuple(sorted(name for name in names if _may_be_own(kind, name)))


def _mentioned(code: CodeType) -> Iterator[str]:
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _mentioned(constant)


def _may_be_own(kind: type, name: str) -> bool:
    """Return whether to ask an object for a name runs nothing but a look-up."""
    there = next((vars(each)[name] for each in kind.__mro__ if name in vars(each)), None)
    return not name.startswith("__") and not hasattr(type(there), "__get__")
