"""Constants of mapping files: from YAML's text and numbers to what the wire type takes."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping

from unicon_core.errors import alternatives
from unicon_msgs_map.codec.ranges import SINGLE_MAX, limits
from unicon_msgs_map.errors import MapStateError
from unicon_msgs_map.layout.messages import Array, Primitive, String, Struct, TypeRef
from unicon_msgs_map.layout.template import Leaf
from unicon_msgs_map.spec import FieldSpec

_FRAMES = ("frame_id", "child_frame_id")
_FRAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_./-]*")  # no leading slash since tf2
LONGEST_NUMBER = 40

__all__ = ["constant", "owner_constants"]


def owner_constants(message: Struct, leaf: Leaf) -> dict[str, bool | int | float | str]:
    """Return the constants of the message that holds a leaf, such as POWER_SUPPLY_STATUS_FULL."""
    owner = message
    for step in leaf.at[:-1]:
        if isinstance(step, str):
            member = owner.field(step)
            kind = member.type if member else None
            if isinstance(kind, Array):
                kind = kind.item
            if isinstance(kind, Struct):
                owner = kind
    return owner.constants


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
            raise MapStateError(
                f"{field.path}: {value!r} is longer than the string's bound of {kind.bound}",
                field.where,
            )
        if "\0" in value:
            raise MapStateError(f"{field.path}: a string cannot hold a NUL character", field.where)
        if field.steps[-1][0] in _FRAMES and value and not _FRAME.fullmatch(value):
            raise MapStateError(
                f"{field.path}: {value[:60]!r} is no frame; write letters, digits and _ . / -, "
                "without a leading slash",
                field.where,
            )
        return value
    if not isinstance(kind, Primitive):
        raise MapStateError(
            f"{field.path}: {value!r} cannot fill a {getattr(kind, 'name', 'message array')}; "
            "map the fields of its elements",
            field.where,
        )
    number = constants.get(value, value) if isinstance(value, str) else value
    if isinstance(number, bytes) and len(number) == 1:
        number = number[0]
    if isinstance(number, str):
        try:
            number = _parse_number(number)
        except ValueError:
            named = alternatives(str(number), constants) if constants else "no constant is named"
            raise MapStateError(
                f"{field.path}: {number!r} is no {kind.name}; {named}", field.where
            ) from None
    if not isinstance(number, (int, float)):
        raise MapStateError(f"{field.path}: {value!r} is no {kind.name}", field.where)
    if kind.name == "bool":
        return bool(number)
    if kind.code in "fd":
        if kind.code == "f" and SINGLE_MAX < abs(number) < math.inf:
            raise MapStateError(f"{field.path}: {value!r} is more than a float32", field.where)
        return float(number)
    low, high = limits(kind.dtype)
    if isinstance(number, float) and number.is_integer():
        number = int(number)
    if not isinstance(number, int) or not low <= number <= high:
        raise MapStateError(
            f"{field.path}: {value!r} is no {kind.name}; give an integer from {low} to {high}",
            field.where,
        )
    return int(number)


def _parse_number(text: str) -> bool | int | float:
    if len(text) > LONGEST_NUMBER:
        raise ValueError("too long")
    if text in ("true", "false"):
        return text == "true"
    try:
        return int(text, 0)
    except ValueError:
        return float(text)
