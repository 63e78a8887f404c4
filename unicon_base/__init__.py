"""Below everything: errors, located YAML, schemas, resources, generated code; and types of values.

The errors of `errors` are here as well. `AnyDict` and `AnyMapping` hold values of any type by name,
as documents, options and reports do; a `TextSink` takes a line of text, such as a warning.
"""

from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

from unicon_base.errors import (
    CheckError,
    EmergencyStopPressed,
    Fault,
    Hung,
    MissingDependencyError,
    ModelError,
    PlatformError,
    PolicyError,
    RobotError,
    Silence,
    StateError,
    UniconError,
    WorkflowError,
    alternatives,
    cannot,
    imported,
    one_line,
)

__all__ = [
    "AnyDict",
    "AnyMapping",
    "CheckError",
    "EmergencyStopPressed",
    "Fault",
    "Hung",
    "MissingDependencyError",
    "ModelError",
    "PlatformError",
    "PolicyError",
    "RobotError",
    "Silence",
    "StateError",
    "TextSink",
    "UniconError",
    "WorkflowError",
    "alternatives",
    "cannot",
    "imported",
    "one_line",
]

AnyDict: TypeAlias = dict[str, Any]
AnyMapping: TypeAlias = Mapping[str, Any]
TextSink: TypeAlias = Callable[[str], None]
