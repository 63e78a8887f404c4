"""Reads documents by the types of `schema.types`; every mistake of a document is raised at once."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any, TypeVar

from unicon_base import AnyDict, UniconError
from unicon_base.located_yaml import Located, Where
from unicon_base.schema.records import record_of, type_of
from unicon_base.schema.types import Mistakes

T = TypeVar("T")


def read(
    kind: type[T],
    located: Located,
    what: str,
    also: Callable[[Mistakes], None] = lambda mistakes: None,
) -> T:
    """Return a document as its class has it.

    Args:
        kind: dataclass of the document; of another `schema` than its own nothing else is said.
        located: the file.
        what: kind of file, such as `robot file`, for the messages.
        also: notes mistakes that the document alone does not show.

    Raises:
        UniconError: of the file's type of errors: it is wrong; all mistakes, in the order of lines.
    """
    value, name = located.value, f"{what} {located.path}"
    mistakes = Mistakes(value)
    fields = record_of(kind).fields
    if not isinstance(value, dict):
        schema = fields["schema"].type.wanted
        raise located.error((), f"a {what} is a mapping; begin with `schema: {schema}`")
    if "schema" in value:
        fields["schema"].type.read(value["schema"], ("schema",), mistakes)
        refuse(mistakes, located.error, name)
    found = record_of(kind).read(value, (), mistakes)
    also(mistakes)
    refuse(mistakes, located.error, name)
    made: T = found
    return made


def read_value(kind: Any, value: Any, error: Callable[[Where, str], UniconError], what: str) -> Any:
    """Return a value as a hint has it.

    Args:
        kind: hint that the value fits.
        value: as YAML or Python has it.
        error: returns the error of a place.
        what: the document, for the first line of several mistakes.

    Raises:
        UniconError: as `error` makes it: the value is wrong.
    """
    mistakes = Mistakes(value, what)
    found = type_of(kind).read(value, (), mistakes)
    refuse(mistakes, error, what)
    return found


def check_made(made: Any, error: type[UniconError], place: str) -> None:
    """Check a dataclass of a document that Python made, for its `__post_init__`.

    Args:
        made: the object; fields that have their default are taken as they are.
        error: class of the error.
        place: where the document has it, such as `scene`.

    Raises:
        UniconError: of that class: a value is wrong.
    """
    mistakes = Mistakes()
    for name, field in record_of(type(made)).fields.items():
        value = getattr(made, name)
        if type(value) is not type(field.default) or value != field.default:
            field.type.read(value, (place, field.key), mistakes)
    refuse(mistakes, lambda where, text: error(text), place)


def refuse(mistakes: Mistakes, error: Callable[[Where, str], UniconError], what: str) -> None:
    """Raise what was noted, if anything."""
    if mistakes.found:
        problems = [error(where, text) for where, text in mistakes.found]
        raise type(problems[0]).of(what, sorted(problems, key=_line))


def _line(problem: UniconError) -> int:
    last = (problem.where or "").rpartition(":")[2]
    return int(last) if last.isdecimal() else 0


DRAFT = "https://json-schema.org/draft/2020-12/schema"


def json_schema(*kinds: Any) -> AnyDict:
    """Return the schema of a document of one of these classes.

    Args:
        kinds: dataclasses of documents; a document is one of them.
    """
    definitions: AnyDict = {}
    references = [record_of(kind).json(definitions) for kind in kinds]
    title = (inspect.getdoc(kinds[0]) or "").partition("\n")[0].rstrip(".")
    whole = references[0] if len(references) == 1 else {"anyOf": references}
    return {"$schema": DRAFT, "title": title, **whole, "$defs": definitions}
