"""Shards: Parquet files with rows of a sweep, and what they were made with in their metadata."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from unicon_core.errors import UniconError
from unicon_ros.sweep.figures import COLUMNS
from unicon_ros.sweep.plan import Plan, Row

METADATA = b"unicon.sweep"
"""Key of the schema's metadata whose value is JSON: identity, code, versions, programs."""
SETTINGS = "settings"
"""Column with the texts of `--set` of a row, as a JSON list."""
VARIED = "set."
"""What stands before the path of a parameter in the name of its column."""


def shard_names(folder: Path) -> list[Path]:
    """Return the shards of a folder, in order."""
    return sorted(folder.glob("shard-[0-9][0-9][0-9][0-9].parquet"))


def write_shard(
    path: Path,
    plan: Plan,
    rows: Sequence[tuple[Row, Mapping[str, Any]]],
    facts: Mapping[str, Any],
) -> None:
    """Write a shard, whole or not at all, and on the disk when it returns.

    Args:
        path: of the file.
        plan: of the sweep.
        rows: with their figures.
        facts: for the metadata.

    Raises:
        OSError: it cannot be written.
    """
    import pyarrow
    from pyarrow import parquet

    kinds = {bool: pyarrow.bool_(), int: pyarrow.int64(), float: pyarrow.float64()}
    varied = {VARIED + each.path: each.type for each in plan.sweep.parameters}
    types = {"row": int, "repetition": int, **varied, SETTINGS: str}
    types |= {name: column.kind for name, column in COLUMNS.items()}
    told = []
    for row, figures in rows:
        values = zip(varied.items(), row.values)
        told.append(
            {"row": row.index, "repetition": row.repetition, **figures}
            | {SETTINGS: json.dumps(row.settings, ensure_ascii=False)}
            | {name: _text(v) if kind is str else v for (name, kind), v in values}
        )
    schema = pyarrow.schema(
        [(name, kinds.get(kind, pyarrow.string())) for name, kind in types.items()],
        metadata={METADATA: json.dumps(facts)},
    )
    table = pyarrow.Table.from_pylist(told, schema)
    half = path.with_name(f".{path.name}.half")
    try:
        with half.open("wb") as file:
            parquet.write_table(table, file)
            file.flush()
            os.fsync(file.fileno())
        half.replace(path)
    except OSError:
        half.unlink(missing_ok=True)
        raise
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


def _text(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value)


def read_shards(
    folder: Path, sha256: str, names: Sequence[str] | None = None
) -> dict[str, list[Any]]:
    """Return columns of all shards of a folder, by name.

    Args:
        folder: of the sweep.
        sha256: of the sweep.
        names: of the columns, None for all.

    Raises:
        UniconError: a file is not a shard, or one of another sweep.
    """
    import pyarrow
    from pyarrow import parquet

    found: dict[str, list[Any]] = {name: [] for name in names or ()}
    for path in shard_names(folder):
        try:
            table = parquet.read_table(path, columns=None if names is None else list(names))
            facts = json.loads((table.schema.metadata or {}).get(METADATA, b"{}"))
            if facts.get("sha256") != sha256:
                raise ValueError("it is not a shard of this sweep")
        except (OSError, ValueError, pyarrow.ArrowException) as error:
            raise UniconError(
                f"cannot read {path}: {str(error).splitlines()[0][:100]}; move it away, and its "
                "rows are run again"
            ) from error
        for name in table.column_names:
            found.setdefault(name, []).extend(table.column(name).to_pylist())
    return found
