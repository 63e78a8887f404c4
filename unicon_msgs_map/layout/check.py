"""Checks of a mapping against message types alone, when the file is read (no arrays yet)."""

from __future__ import annotations

from collections.abc import Sequence

from unicon_base.errors import alternatives
from unicon_msgs_map.errors import count_of
from unicon_msgs_map.layout.messages import Array, String, Struct, TypeRef
from unicon_msgs_map.layout.paths import Key, Selector
from unicon_msgs_map.spec import FieldSpec


def check_published(field: FieldSpec, message: Struct) -> None:
    """Check a field of a publish entry.

    Raises:
        MessageTypeError: its path names no field.
        MapFileError: it asks for what only subscriptions have.
    """
    resolve(field, message, receive=False)
    if field.by is not None:
        raise field.file_error("'by' orders received arrays; publish with a $variable of names")
    if field.quat == "wxyz_from_xyzw":
        raise field.file_error("quat wxyz_from_xyzw is of subscriptions; write xyzw_from_wxyz")


def check_received(field: FieldSpec, message: Struct, names: Sequence[str]) -> None:
    """Check a field of a subscribe entry.

    Args:
        field: of the entry.
        message: its type.
        names: paths of the entry's variables, one of which may order this field.

    Raises:
        MessageTypeError: its path names no field.
        MapFileError: it asks for what only published messages have.
    """
    kind = resolve(field, message, receive=True)
    if field.text is not None:
        raise field.file_error("'text' formats published strings; drop it")
    if field.checksum is not None:
        raise field.file_error("checksums are written, not checked on receive; drop it")
    if field.quat == "xyzw_from_wxyz":
        raise field.file_error("quat xyzw_from_wxyz is of publishing; write wxyz_from_xyzw")
    if field.source.kind == "variable" and not (
        isinstance(kind, Array) and isinstance(kind.item, String)
    ):
        raise field.file_error(
            "a variable in a subscription names the elements of an array and stands on an "
            "array of strings; write =text for a required text"
        )
    if field.by not in (None, "none", *names):
        known = alternatives(str(field.by), [*names, "none"])
        raise field.file_error(f"by {field.by!r} is not a mapped array of names; {known}")


def resolve(field: FieldSpec, message: Struct, *, receive: bool) -> TypeRef:
    """Return the type that a path ends at.

    Raises:
        MessageTypeError: a step names no field, or selects what is not there.
    """
    owner: TypeRef = message
    kind: TypeRef = message
    for number, (name, selector) in enumerate(field.steps):
        if not isinstance(owner, Struct):
            raise field.type_error(f"{field.steps[number - 1][0]} has no fields below it")
        if name not in owner.fields:
            known = alternatives(name, owner.fields)
            raise field.type_error(f"{owner.name} has no field {name!r}; {known}")
        kind = owner.fields[name]
        if isinstance(kind, Array):
            if selector is not None:
                _check_selector(field, owner, name, selector, kind, receive=receive)
                kind = kind.item
            elif number < len(field.steps) - 1:
                raise field.type_error(
                    f"{name} of {owner.name} is an array; select elements, as in {name}[0] or "
                    f"{name}[:12]"
                )
        elif selector is not None:
            raise field.type_error(f"{name} of {owner.name} is not an array; drop the [...]")
        owner = kind
    return kind


def _check_selector(
    field: FieldSpec, owner: Struct, name: str, selector: Selector, kind: Array, *, receive: bool
) -> None:
    if isinstance(selector, Key):
        if not receive:
            raise field.type_error(
                "elements are selected by text in subscriptions only; use a number, as in "
                f"{name}[0]"
            )
        fields = kind.item.fields if isinstance(kind.item, Struct) else {}
        if not isinstance(fields.get(selector.field), String):
            raise field.type_error(
                f"elements of {name} have no string field {selector.field!r} to select by"
            )
        return
    top = selector + 1 if isinstance(selector, int) else (selector[1] or selector[0] + 1)
    if kind.most is not None and top > kind.most:
        raise field.type_error(f"{name} of {owner.name} has at most {count_of(kind.most)}")
