"""What is in a recording or bag, for `unicon bag info`: of ours the ticks too, cut off or not."""

from __future__ import annotations

import csv
import os
import struct
import zipfile
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from unicon_base.arrays import Array
from unicon_base.errors import UniconError, cannot, imported
from unicon_core.page import refuse_existing
from unicon_core.text_table import aligned
from unicon_lab.recording.import_bag import open_bag
from unicon_lab.recording.read import Record, files_of, missing, open_record
from unicon_lab.recording.scan import Scan, scan

TOLD = ("workflow", "robot", "platform", "part", "reason", "written", "imported_from")
"""Facts that are told as they are."""


def info_of(path: Path) -> dict[str, Any]:
    """Return what is in a recording, fault record or bag, as plain values.

    Raises:
        UniconError: it cannot be read.
    """
    if not os.path.exists(path):  # of a name that is too long, too
        raise UniconError(missing(path))
    try:
        paths = files_of(path)
        scans = [scan(each) for each in paths]
    except (OSError, UniconError, ValueError, struct.error) as error:
        return _foreign(path, error)
    if not any(each.facts for each in scans):
        return _foreign(path, None)
    return _ours(path, paths, scans) | _ticks(open_record(path, scans))


def _ours(path: Path, paths: list[Path], scans: list[Scan]) -> dict[str, Any]:
    counts: Counter[str] = Counter()
    types: dict[str, str] = {}
    for each in scans:
        types |= dict(each.topics.values())
        counts.update(each.messages())
    spans = [each.span for each in scans if each.span is not None]
    return {
        "path": str(path),
        "files": [each.name for each in paths],
        "bytes": sum(each.stat().st_size for each in paths),
        "cut_off": not all(each.ended for each in scans),
        "span_ns": [min(a for a, _ in spans), max(b for _, b in spans)] if spans else None,
        "messages": counts.total(),
        "topics": {name: {"type": kind, "messages": counts[name]} for name, kind in types.items()},
    }


def _ticks(record: Record) -> dict[str, Any]:
    facts = record.facts
    told = {name: facts[name] for name in TOLD if facts.get(name)}
    try:
        period = record.period
    except UniconError:
        period = 0.0
    phases = np.asarray(record.phases)
    skipped = np.diff(record.ticks) - 1 - (phases[1:] != phases[:-1])  # a new phase skips one
    missing = int(np.maximum(skipped, 0).sum())
    return told | {
        "period_s": period,
        "ticks": len(record.ticks),
        "missing_ticks": missing,
        "phases": dict(Counter(record.phases)),
        "moments": {moment: len(names) for moment, names in record.kept.items()},
        "states": len(record.layout.specs),
        "num_robots": record.layout.num_robots,
        "memories": len(record.memories),
        "policies": record.policies,
        "versions": record.told("versions", dict),
        "overridden": record.told("overridden", list),
        "layout_hash": record.layout.hash,
        "attachments": {name: len(content) for name, content in record.files.items()},
    }


def _foreign(path: Path, why: Exception | None) -> dict[str, Any]:
    """Return what rosbags tells of a bag that is not of unicon, or compressed."""
    try:
        reader = open_bag(path)
    except UniconError as error:
        if path.suffix == ".partial":
            raise UniconError(
                f"{path} is not a recording that was cut off: "
                f"{why or 'it says nothing of itself'}; give what a run has left or is writing"
            ) from error
        raise
    try:
        topics: dict[str, dict[str, Any]] = {}
        for each in reader.connections:
            entry = topics.setdefault(each.topic, {"type": each.msgtype, "messages": 0})
            entry["messages"] += each.msgcount
        count = reader.message_count
        span = [int(reader.start_time), int(reader.end_time)] if count else None
    finally:
        reader.close()
    files = [each for each in path.iterdir() if each.is_file()] if path.is_dir() else [path]
    return {
        "path": str(path),
        "files": sorted(each.name for each in files),
        "bytes": sum(each.stat().st_size for each in files),
        "cut_off": False,
        "span_ns": span,
        "messages": count,
        "topics": topics,
    }


def info_text(info: dict[str, Any]) -> str:
    """Return it for people, a line for each fact."""
    rows: list[tuple[str, str]] = [("recording", info["path"])]
    if info["files"] != [Path(info["path"]).name]:
        rows.append(("files", ", ".join(info["files"])))
    size = f"{info['bytes'] / 1e6:.1f} MB, {info['messages']} messages"
    if info["span_ns"]:
        first, last = info["span_ns"]
        size += f", {(last - first) * 1e-9:.2f} s"
    rows.append(("size", size))
    if info["cut_off"]:
        rows.append(("cut off", "it was killed, or is being written; unicon bag recover mends it"))
    rows += [(name.replace("_", " "), info[name]) for name in TOLD if name in info]
    if "ticks" in info:
        rate = f" at {1.0 / info['period_s']:g} Hz" if info["period_s"] else ""
        missing = f", {info['missing_ticks']} missing" if info["missing_ticks"] else ""
        phases = ", ".join(f"{name} {count}" for name, count in info["phases"].items())
        rows.append(("ticks", f"{info['ticks']}{rate}{missing} ({phases})"))
        moments = ", ".join(f"{name} {count}" for name, count in info["moments"].items())
        rows.append(("states", f"{info['states']}, layout {info['layout_hash'][:12]} ({moments})"))
        for name, policy in info["policies"].items():
            rows.append((f"policy {name}", f"sha256 {policy['sha256'][:12]}"))
        versions = ", ".join(f"{name} {number}" for name, number in info["versions"].items())
        rows.append(("versions", versions))
    width = max(len(name) for name, _ in rows)
    lines = [f"{name:<{width}}  {text}" for name, text in rows]
    topics = [("topic", "type", "messages")]
    topics += [(name, each["type"], str(each["messages"])) for name, each in info["topics"].items()]
    return "\n".join([*lines, "", *aligned(topics, right={2})])


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
