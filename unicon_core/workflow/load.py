"""Reads a workflow file, applies `--set`, and checks keys and settings."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from unicon_core.errors import WorkflowError
from unicon_core.file_kinds import other_kind
from unicon_core.located_yaml import Located, read_yaml
from unicon_core.resources import find_config, list_config
from unicon_core.schema.read import refuse
from unicon_core.schema.records import record_of
from unicon_core.schema.types import Mistakes
from unicon_core.workflow.document import WorkflowDocument, read_part
from unicon_core.workflow.file import Workflow
from unicon_core.workflow.overrides import set_value, split_setting


def workflow_names() -> list[str]:
    """Return the names of the workflows that `load_document` finds, sorted."""
    return list_config("workflows")


def description_of(name: str) -> str:
    """Return the description of a workflow, of which the keys alone are checked.

    Raises:
        WorkflowError: no such file, broken YAML, or an unknown or missing key.
    """
    located = read_yaml(find_config("workflows", name, error=WorkflowError), WorkflowError)
    values = located.value if isinstance(located.value, dict) else {}
    mistakes = Mistakes(values)
    record_of(Workflow).check_keys(values, (), mistakes)
    refuse(mistakes, located.error, f"workflow {name}")
    return str(values.get("description") or "")


def load_document(
    name_or_path: str | Path, overrides: Iterable[str] | Mapping[str, Any] = ()
) -> WorkflowDocument:
    """Read a workflow file.

    Args:
        name_or_path: a name in `config/workflows/`, or a path.
        overrides: `path=value` texts as of `--set`, or a mapping of dotted paths to values.

    Raises:
        WorkflowError: no such file, broken YAML, an unknown key, a wrong override.
    """
    path = find_config("workflows", name_or_path, error=WorkflowError)
    return document_at(read_yaml(path, WorkflowError), overrides)


def document_at(
    located: Located, overrides: Iterable[str] | Mapping[str, Any] = ()
) -> WorkflowDocument:
    """Return the document of a workflow that was read; see `load_document`."""
    path, values = located.path, located.value
    if not isinstance(values, dict):
        raise WorkflowError("a workflow is a mapping with robot, platform and flow", f"{path}:1")
    changed = []
    pairs = overrides.items() if isinstance(overrides, Mapping) else map(split_setting, overrides)
    for dotted, value in pairs:
        changed.append(set_value(values, dotted, value))
    return _checked(WorkflowDocument(path.stem, values, located, tuple(changed)))


def document_of(values: Mapping[str, Any], path: Path, line: int) -> WorkflowDocument:
    """Return the document of a workflow that is written in Python.

    Args:
        values: as of a workflow file; flows may be nodes.
        path: the Python file; relative paths are relative to its folder.
        line: where it stands.

    Raises:
        WorkflowError: a key is unknown, missing or wrong.
    """
    given = {key: value for key, value in values.items() if value is not None}
    states = given.get("states")
    if isinstance(states, Mapping):
        from unicon_core.states import StateSpec  # NumPy, which a list of workflows does without

        plain = {
            name: spec.to_dict() if isinstance(spec, StateSpec) else spec
            for name, spec in states.items()
        }
        given["states"] = plain
    return _checked(WorkflowDocument(path.stem, given, Located(path, given, {(): line})))


def _checked(document: WorkflowDocument) -> WorkflowDocument:
    values = document.values
    other = other_kind(values, "workflow")
    if other:
        raise document.error(other, "schema")
    read_part(document, Workflow, values)
    document.name = str(document.get("name", document.name))
    return document
