"""Constants of mapping files: from YAML's text and numbers to what the wire type takes."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping

from unicon_core.errors import alternatives
from unicon_msgs_map.codec.ranges import SINGLE_MAX, limits
from unicon_msgs_map.layout.messages import Primitive, String, TypeRef
from unicon_msgs_map.spec import FieldSpec

_FRAMES = ("frame_id", "child_frame_id")
_FRAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_./-]*")  # no leading slash since tf2
LONGEST_NUMBER = 40


def constant(
    field: FieldSpec, kind: TypeRef, value: object, constants: Mapping[str, object]
) -> object:
    """Return a constant as the wire type takes it.

    Args:
        field: the mapping's entry, for messages.
        kind: the wire type.
        value: text, number or boolean; text may be the name of a constant or a number.
        constants: named constants of the message that holds the field.

    Raises:
        MapStateError: it does not fit.
    """
    if isinstance(kind, String):
        if not isinstance(value, str):
            value = str(value)
        if kind.bound and len(value.encode()) > kind.bound:
            raise field.state_error(f"{value!r} is longer than the string's bound of {kind.bound}")
        if "\0" in value:
            raise field.state_error("a string cannot hold a NUL character")
        if field.steps[-1][0] in _FRAMES and value and not _FRAME.fullmatch(value):
            raise field.state_error(
                f"{value[:60]!r} is not a frame; write letters, digits and _ . / -, without a "
                "leading slash"
            )
        return value
    if not isinstance(kind, Primitive):
        raise field.state_error(
            f"{value!r} cannot fill a {getattr(kind, 'name', 'message array')}; map the fields of "
            "its elements"
        )
    number = constants.get(value, value) if isinstance(value, str) else value
    if isinstance(number, bytes) and len(number) == 1:
        number = number[0]
    if isinstance(number, str):
        try:
            number = _parse_number(number)
        except ValueError:
            named = alternatives(str(number), constants) if constants else "no constant is named"
            raise field.state_error(f"{number!r} is not {_one(kind)}; {named}") from None
    if not isinstance(number, (int, float)):
        raise field.state_error(f"{value!r} is not {_one(kind)}")
    if kind.name == "bool":
        return bool(number)
    if kind.code in "fd":
        if kind.code == "f" and SINGLE_MAX < abs(number) < math.inf:
            raise field.state_error(f"{value!r} is more than a float32")
        return float(number)
    low, high = limits(kind.dtype)
    if isinstance(number, float) and number.is_integer():
        number = int(number)
    if not isinstance(number, int) or not low <= number <= high:
        raise field.state_error(
            f"{value!r} is not {_one(kind)}; give an integer from {low} to {high}"
        )
    return int(number)


def _one(kind: Primitive) -> str:
    return f"{'an' if kind.name.startswith('i') else 'a'} {kind.name}"


def _parse_number(text: str) -> bool | int | float:
    if len(text) > LONGEST_NUMBER:
        raise ValueError("too long")
    if text in ("true", "false"):
        return text == "true"
    try:
        return int(text, 0)
    except ValueError:
        return float(text)
