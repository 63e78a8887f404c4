"""What kind of file a YAML document of ours is, for every loader that is handed another one."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

__all__ = ["other_kind"]

_KINDS = {
    "workflow": "run it with `unicon run FILE`",
    "sweep": "run it with `unicon sweep FILE`",
    "robot": "name it as `robot: FILE` in a workflow, or see it with `unicon robots FILE`",
    "policy": "name its folder under `policies:` in a workflow",
}


def other_kind(values: Any, wanted: str) -> str:
    """Return that a document is of another kind and what is done with it, "" where it may be right.

    Args:
        values: the document; a workflow need not have a schema.
        wanted: `workflow`, `sweep`, `robot` or `policy`.
    """
    if not isinstance(values, Mapping):
        return ""
    is_flow = {"robot", "platform", "flow"} <= values.keys()
    schema = str(values.get("schema", "unicon.workflow/1" if is_flow else ""))
    kind = schema.removeprefix("unicon.").rpartition("/")[0]
    if kind not in _KINDS or kind == wanted:
        return ""
    return f"this file is a {kind}, not a {wanted}; {_KINDS[kind]}"
