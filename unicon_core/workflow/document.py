"""WorkflowDocument: the content of a workflow file, with where each value stands."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from unicon_core.errors import WorkflowError
from unicon_core.located_yaml import Located
from unicon_core.schema.read import refuse
from unicon_core.schema.records import type_of
from unicon_core.schema.types import Mistakes

SCHEMA = "unicon.workflow/1"


@dataclass
class WorkflowDocument:
    """A workflow file's content.

    Attributes:
        name: name of the workflow.
        values: the document with overrides applied.
        located: the file, for `file:line`.
        overridden: paths that `--set` changed, keys with dots between them.
    """

    name: str
    values: dict[str, Any]
    located: Located
    overridden: tuple[str, ...] = ()

    @property
    def path(self) -> Path:
        """The file."""
        return self.located.path

    def where(self, *path: str | int) -> str:
        """Return `file:line` of a value."""
        dotted = ".".join(map(str, path))
        if any(f"{dotted}.".startswith(f"{set_path}.") for set_path in self.overridden):
            return f"--set {dotted}"
        if path and path not in self.located.lines:  # made on the way to what was set
            made = (each for each in self.overridden if each.startswith(f"{dotted}."))
            return next((f"--set {each}" for each in made), self.located.where(path))
        return self.located.where(path)

    def error(self, message: str, *path: str | int) -> WorkflowError:
        """Return the error for a value, or for what was set below it and the message names."""
        below = ".".join(map(str, (*path, "")))
        set_below = (x for x in self.overridden if x.startswith(below))
        named = (x for x in set_below if repr(x.rpartition(".")[2]) in message)
        found = next(named, "") if path else ""
        return WorkflowError(message, f"--set {found}" if found else self.where(*path))

    def get(self, key: str, default: Any = None) -> Any:
        """Return a top-level value, the default where it is absent or null."""
        value = self.values.get(key)
        return default if value is None else value


def read_part(document: WorkflowDocument, kind: Any, value: Any, *path: str | int) -> Any:
    """Return a value of a workflow as a hint has it (see `schema`).

    Raises:
        WorkflowError: it is wrong; with file and line of each mistake.
    """
    mistakes = Mistakes(document.values)
    found = type_of(kind).read(value, path, mistakes)
    refuse(mistakes, lambda where, text: document.error(text, *where), f"workflow {document.name}")
    return found
