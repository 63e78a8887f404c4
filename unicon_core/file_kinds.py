"""What kind of file a loader was handed: a YAML document of ours, or a pointer of Git LFS."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

_POINTER = b"version https://git-lfs"
_KINDS = {
    "workflow": "run it with `unicon run FILE`",
    "sweep": "run it with `unicon sweep FILE`",
    "robot": "name it as `robot: FILE` in a workflow, or see it with `unicon robots FILE`",
    "policy": "name its folder under `policies:` in a workflow",
}


def is_lfs_pointer(path: Path) -> bool:
    """Return whether a file only names what `git lfs pull` would bring; False of an unreadable."""
    try:
        with path.open("rb") as file:
            return file.read(len(_POINTER)) == _POINTER
    except OSError:  # its loader says so
        return False


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
