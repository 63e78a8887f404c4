"""The part of JSON Schema 2020-12 that `robot.schema.json` uses, as a slow reference for the tests.

An unknown keyword is an error, so that the schema cannot grow past what is checked here.
"""

from __future__ import annotations

import re
from typing import Any

_TYPES = {
    "object": dict,
    "array": list,
    "string": str,
    "number": (int, float),
    "integer": int,
    "boolean": bool,
    "null": type(None),
}
_NOTES = {"$schema", "$id", "$defs", "title", "description"}


def accepts(schema: Any, value: Any, root: Any) -> bool:
    """Return whether a schema accepts a value."""
    if isinstance(schema, bool):
        return schema
    if "if" in schema:
        branch = "then" if accepts(schema["if"], value, root) else "else"
        if not accepts(schema.get(branch, True), value, root):
            return False
    return all(
        _CHECKS[keyword](argument, value, schema, root)
        for keyword, argument in schema.items()
        if keyword not in _NOTES and keyword not in ("if", "then", "else")
    )


def _is(name: str, value: Any) -> bool:
    return isinstance(value, _TYPES[name]) and not (
        name in ("number", "integer") and isinstance(value, bool)
    )


def _type(names: Any, value: Any, schema: Any, root: Any) -> bool:
    return any(_is(n, value) for n in ([names] if isinstance(names, str) else names))


def _ref(path: str, value: Any, schema: Any, root: Any) -> bool:
    target = root
    for part in path.removeprefix("#/").split("/"):
        target = target[part]
    return accepts(target, value, root)


def _additional(inner: Any, value: Any, schema: Any, root: Any) -> bool:
    known = schema.get("properties", {})
    return not _is("object", value) or all(
        accepts(inner, v, root) for k, v in value.items() if k not in known
    )


def _each(pairs: Any, value: Any, root: Any) -> bool:
    return not _is("object", value) or all(
        accepts(inner, value[key], root) for key, inner in pairs.items() if key in value
    )


_CHECKS = {
    "type": _type,
    "$ref": _ref,
    "const": lambda a, v, s, r: a == v,
    "enum": lambda a, v, s, r: v in a,
    "required": lambda a, v, s, r: not _is("object", v) or all(key in v for key in a),
    "properties": lambda a, v, s, r: _each(a, v, r),
    "additionalProperties": _additional,
    "items": lambda a, v, s, r: not _is("array", v) or all(accepts(a, x, r) for x in v),
    "minItems": lambda a, v, s, r: not _is("array", v) or len(v) >= a,
    "maxItems": lambda a, v, s, r: not _is("array", v) or len(v) <= a,
    "uniqueItems": lambda a, v, s, r: not _is("array", v) or len(set(map(repr, v))) == len(v),
    "minLength": lambda a, v, s, r: not _is("string", v) or len(v) >= a,
    "pattern": lambda a, v, s, r: not _is("string", v) or re.search(a, v) is not None,
    "minimum": lambda a, v, s, r: not _is("number", v) or v >= a,
    "maximum": lambda a, v, s, r: not _is("number", v) or v <= a,
    "exclusiveMinimum": lambda a, v, s, r: not _is("number", v) or v > a,
    "anyOf": lambda a, v, s, r: any(accepts(inner, v, r) for inner in a),
    "allOf": lambda a, v, s, r: all(accepts(inner, v, r) for inner in a),
}
