"""Workflows: YAML to a built graph, for the command line and the node."""

from unicon_core.workflow.document import WorkflowDocument, load_document, workflow_names
from unicon_core.workflow.program import Hook, Program, load_workflow

__all__ = [
    "Hook",
    "Program",
    "WorkflowDocument",
    "load_document",
    "load_workflow",
    "workflow_names",
]
