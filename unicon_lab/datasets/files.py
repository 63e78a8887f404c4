"""Files of a data set: numbered ones that are long enough, and those of `meta`."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

CHUNK = 1000
"""Files of a folder `chunk-000`."""


class Files:
    """Files of one kind, one after the other.

    Args:
        root: of the data set.
        pattern: of their names below it.
        largest: behind the episode that goes beyond so many MiB a next one begins.

    Attributes:
        began: the last `next_path` was that of another file than before.
    """

    def __init__(self, root: Path, pattern: str, largest: int) -> None:
        self._root, self._pattern, self._largest = root, pattern, largest << 20
        self._number, self.began = -1, False
        self._path = root

    def next_path(self) -> tuple[Path, dict[str, Any]]:
        """Return the file for the next episode, and its place for `meta/episodes`."""
        self.began = self._number < 0 or self._size() >= self._largest
        self._number += self.began
        chunk, file = divmod(self._number, CHUNK)
        place = {"chunk_index": chunk, "file_index": file}
        if self.began:
            self._path = self._root / self._pattern.format(**place)
            self._path.parent.mkdir(parents=True, exist_ok=True)
        return self._path, place

    def _size(self) -> int:
        # An encoder looks far ahead before it writes its first byte.
        return self._path.stat().st_size if self._path.exists() else 0


def task_index() -> dict[str, Any]:
    """Return what lets pandas take the tasks for the index of their numbers."""
    column = {"name": None, "field_name": "__index_level_0__", "metadata": None}
    number = {"name": "task_index", "field_name": "task_index", "metadata": None}
    return {
        "index_columns": ["__index_level_0__"],
        "column_indexes": [],
        "columns": [
            {**number, "pandas_type": "int64", "numpy_type": "int64"},
            {**column, "pandas_type": "unicode", "numpy_type": "object"},
        ],
    }


def write_json(path: Path, content: Mapping[str, Any]) -> None:
    """Write a file of `meta`; its folder is made.

    Raises:
        OSError: it cannot be written.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content, indent=4, ensure_ascii=False), encoding="utf-8")
