"""Export of recorded states to NPZ, CSV and Parquet, for `unicon bag export`."""

from __future__ import annotations

import csv
import zipfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

from unicon_base.arrays import Array
from unicon_base.errors import UniconError, cannot, imported
from unicon_core.page import refuse_existing
from unicon_lab.recording.read import Record

HEADS = ("stamp_ns", "tick", "phase", "ended")
"""Columns that stand before the states."""
BLOCK = 4096
"""Ticks that are written at once."""


def export(record: Record, path: Path, states: Sequence[str] = (), moment: str = "sent") -> int:
    """Write states of every tick; return the number of ticks.

    Args:
        record: where they come from.
        path: ends in `.npz`, `.csv` or `.parquet`; it does not exist.
        states: names of those that are wanted; all that are kept at the moment unless told.
        moment: `received`, …, `sent`.

    Raises:
        UniconError: it exists, cannot be written, or has another ending.
        StateError: no such state.
        MissingDependencyError: Parquet without pyarrow.
    """
    write = FORMATS.get(path.suffix)
    if write is None:
        raise UniconError(f"cannot export to {path}; give a name that ends in {', '.join(FORMATS)}")
    record.need(moment, states)
    refuse_existing(path)
    # The columns before the states have these names already.
    names = [name for name in states or record.kept[moment] if name not in HEADS]
    partial = path.with_name(f"{path.name}.partial")
    try:
        with cannot(f"write {path}", "make room or give another path"):
            write(record, partial, names, moment)
            partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)
    return len(record.ticks)


def _heads(record: Record, begin: int = 0, end: int | None = None) -> dict[str, Array]:
    rows = slice(begin, end)
    return {
        "stamp_ns": record.stamps[rows],
        "tick": record.ticks[rows],
        "phase": np.array(record.phases[rows], "U8"),
        "ended": record.ended[rows],
    }


def _npz(record: Record, path: Path, names: Sequence[str], moment: str) -> None:
    """Write one state after the other, so that only one is in memory."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED, allowZip64=True) as archive:

        def add(name: str, values: Array) -> None:
            with archive.open(f"{name}.npy", "w", force_zip64=True) as file:
                np.lib.format.write_array(file, values, allow_pickle=False)

        for name, values in _heads(record).items():
            add(name, values)
        for name in names:
            add(name, record.states(name, moment))
            elements = record.layout.specs[name].names
            if elements:
                add(f"{name}.names", np.array(elements))


def _csv(record: Record, path: Path, names: Sequence[str], moment: str) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        write = csv.writer(file, lineterminator="\n")
        write.writerow([*HEADS, *(each for name in names for each in record.layout.elements(name))])
        for heads, values in _blocks(record, names, moment):
            columns = [_plain(column).tolist() for column in heads.values()]
            columns += [column.tolist() for each in values for column in _plain(each).T]
            write.writerows(zip(*columns))


def _parquet(record: Record, path: Path, names: Sequence[str], moment: str) -> None:
    pyarrow = imported("pyarrow", "export to Parquet", "parquet")
    from pyarrow import parquet

    titles = [*HEADS, *(each for name in names for each in record.layout.elements(name))]
    writer = None
    try:
        for heads, values in _blocks(record, names, moment):
            columns = [pyarrow.array(column) for column in heads.values()]
            columns += [pyarrow.array(np.ascontiguousarray(c)) for v in values for c in v.T]
            table = pyarrow.table(columns, names=titles)
            writer = writer or parquet.ParquetWriter(path, table.schema)
            writer.write_table(table)
    finally:
        if writer is not None:
            writer.close()


def _blocks(
    record: Record, names: Sequence[str], moment: str
) -> Iterator[tuple[dict[str, Array], list[Array]]]:
    """Yield the heads and the states, each of shape (ticks, elements), some ticks at a time."""
    widths = [len(record.layout.elements(name)) for name in names]
    for begin in range(0, max(len(record.ticks), 1), BLOCK):
        end = min(begin + BLOCK, len(record.ticks))
        values = [record.states(name, moment, slice(begin, end)) for name in names]
        flat = [each.reshape(end - begin, width) for each, width in zip(values, widths)]
        yield _heads(record, begin, end), flat


def _plain(values: Array) -> Array:
    """Return bools as 0 and 1."""
    return values.view(np.uint8) if values.dtype == bool else values


FORMATS: dict[str, Callable[[Record, Path, Sequence[str], str], None]] = {
    ".npz": _npz,
    ".csv": _csv,
    ".parquet": _parquet,
}
"""Ending of the file to what writes it."""
