"""Changes of a memory: what blocks came to remember, without what they were built with."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

__all__ = ["changes"]


def changes(content: Mapping[str, Any], built: Mapping[str, Any]) -> dict[str, Any]:
    """Return what of a memory is not as it was when the blocks had just been built.

    What a block holds and never changes, such as a gain, is not a memory: where a workflow with
    another gain is given the rest, the gain stays its own.

    Args:
        content: of `Remembered.content`.
        built: the same before the first tick.

    Raises:
        LookupError, TypeError, ValueError: they are not such contents.
    """
    owners: dict[str, list[Any]] = {}
    for path, pairs in content["owners"].items():
        before = {_key(key): value for key, value in built["owners"].get(path, ())}
        missing = object()
        changed = [[k, value] for k, value in pairs if before.get(_key(k), missing) != value]
        if changed:
            owners[path] = changed
    kept = {p: value for p, value in content["kept"].items() if built["kept"].get(p) != value}
    return {"owners": owners, "kept": kept, "unkept": content.get("unkept", [])}


def _key(key: Any) -> tuple[str, Any]:
    return type(key).__name__, key
