"""Workflows: YAML to a built graph, for the command line and the node."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from unicon_core.workflow.document import WorkflowDocument, load_document, workflow_names

if TYPE_CHECKING:
    from unicon_core.workflow.program import Hook, HookBlocks, Program, load_workflow

__all__ = [
    "Hook",
    "HookBlocks",
    "Program",
    "WorkflowDocument",
    "load_document",
    "load_workflow",
    "workflow_names",
]


def __getattr__(name: str) -> Any:
    """Import what builds when it is asked for: documents are read and listed without NumPy."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module("unicon_core.workflow.program"), name)
    globals()[name] = value
    return value
