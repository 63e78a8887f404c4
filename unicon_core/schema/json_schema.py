"""JSON Schema (2020-12) of documents, for editors; what compares two places is beyond it."""

from __future__ import annotations

import inspect
from typing import Any

from unicon_core.schema.records import record_of

DRAFT = "https://json-schema.org/draft/2020-12/schema"


def json_schema(*kinds: Any) -> dict[str, Any]:
    """Return the schema of a document of one of these classes.

    Args:
        kinds: dataclasses of documents; a document is one of them.
    """
    definitions: dict[str, Any] = {}
    references = [record_of(kind).json(definitions) for kind in kinds]
    title = (inspect.getdoc(kinds[0]) or "").partition("\n")[0].rstrip(".")
    whole = references[0] if len(references) == 1 else {"anyOf": references}
    return {"$schema": DRAFT, "title": title, **whole, "$defs": definitions}
