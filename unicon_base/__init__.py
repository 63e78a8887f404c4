"""Below everything: errors, located YAML, schemas, resources, generated code; and types of values.

`AnyDict` and `AnyMapping` hold values of any type by name, as documents, options and reports do; a
`TextSink` takes a line of text, such as a warning.
"""

from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

AnyDict: TypeAlias = dict[str, Any]
AnyMapping: TypeAlias = Mapping[str, Any]
TextSink: TypeAlias = Callable[[str], None]
