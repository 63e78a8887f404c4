"""Do a file's options have the types that a factory asks for? For blocks and platforms alike."""

from __future__ import annotations

import inspect
import math
import types
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np

_PLAIN: dict[Any, tuple[tuple[type, ...], str]] = {
    bool: ((bool,), "true or false"),
    int: ((int,), "a whole number"),
    float: ((int, float), "a number"),
    str: ((str, Path), "a text"),
    Path: ((str, Path), "a path"),
    type(None): ((type(None),), "null"),
}
"""Annotation to the types that a value may have, and to what is asked for."""


def wrong_option(factory: Callable[..., Any], options: Mapping[str, Any]) -> str | None:
    """Return what is wrong with the first option of another type than annotated; None for nothing.

    Only what a YAML file can say is judged: words, numbers, lists and mappings of them. A number is
    never NaN. What is annotated otherwise, or not at all, is the factory's own matter.

    Args:
        factory: function or class that gets the options.
        options: values of the file by name.
    """
    target: Any = factory
    if inspect.isclass(factory):
        target = vars(factory).get("__init__", factory)
    try:
        hints = _hints(target)
    except (AttributeError, NameError, TypeError):
        return None
    for name, value in options.items():
        hint = hints.get(name, Any)
        if not _fits(value, hint):
            name, value, hint = _placed(name, value, hint)
            return f"{name} is {_short(value)}; give {_wanted(hint)}"
    return None


@lru_cache(256)
def _hints(target: Callable[..., Any]) -> dict[str, Any]:
    """Return what a function asks for: evaluated once, since a scene takes 0.6 ms."""
    return get_type_hints(target)


def _fits(value: Any, hint: Any) -> bool:
    if isinstance(value, (np.ndarray, np.generic)):
        return True  # given in Python
    origin, inner = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        return any(_fits(value, each) for each in inner)
    if origin is Literal:
        return any(type(value) is type(each) for each in inner)
    if hint in _PLAIN:
        if isinstance(value, bool):
            return hint is bool
        nan = isinstance(value, float) and math.isnan(value)
        return isinstance(value, _PLAIN[hint][0]) and not nan
    if _is_mapping(origin):
        return isinstance(value, Mapping) and all(
            _fits(k, inner[0]) and _fits(v, inner[1]) for k, v in value.items()
        )
    if isinstance(origin, type) and issubclass(origin, Sequence):
        listed = isinstance(value, Sequence) and not isinstance(value, str)
        return listed and all(_fits(each, inner[0]) for each in value)
    return True


def _placed(name: str, value: Any, hint: Any) -> tuple[str, Any, Any]:
    """Return the place, within mappings, of what does not fit."""
    hints = get_args(hint) if get_origin(hint) in (Union, types.UnionType) else (hint,)
    maps = [get_args(each) for each in hints if _is_mapping(get_origin(each))]
    if isinstance(value, Mapping) and len(maps) == 1:
        keys, inner = maps[0]
        for key, part in value.items():
            if _fits(key, keys) and not _fits(part, inner):
                return _placed(f"{name}.{key}", part, inner)
    return name, value, hint


def _is_mapping(origin: Any) -> bool:
    return isinstance(origin, type) and issubclass(origin, Mapping)


def _wanted(hint: Any) -> str:
    origin, inner = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        return " or ".join(dict.fromkeys(map(_wanted, inner)))
    if origin is Literal:
        return ", ".join(map(str, inner))
    if _is_mapping(origin):
        return f"a mapping of {_wanted(inner[0])} to {_wanted(inner[1])}"
    if isinstance(origin, type) and issubclass(origin, Sequence):
        return f"a list, each {_wanted(inner[0])}"
    return _PLAIN[hint][1] if hint in _PLAIN else "another value"


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}…"
