"""What is in a recording or bag, for `unicon bag info`: of ours the ticks too, cut off or not."""

from __future__ import annotations

import csv
import os
import struct
import zipfile
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from unicon_base import AnyDict, UniconError, cannot, imported
from unicon_base.arrays import Array
from unicon_core.page import refuse_existing
from unicon_core.text_table import aligned
from unicon_lab.recording.import_bag import open_bag
from unicon_lab.recording.read import Record, files_of, missing, open_record
from unicon_lab.recording.scan import scan

TOLD = ("workflow", "robot", "platform", "part", "reason", "written", "imported_from")
"""Facts that are told as they are."""


def info_of(path: Path) -> AnyDict:
    """Return what is in a recording, fault record or bag, as plain values.

    Raises:
        UniconError: it cannot be read.
    """
    if not os.path.exists(path):  # of a name that is too long, too
        raise UniconError(missing(path))
    why: Exception | str = "it says nothing of itself"
    try:
        paths = files_of(path)
        scans = [scan(each) for each in paths]
    except (OSError, UniconError, ValueError, struct.error) as error:
        scans, why = [], error
    if any(each.facts for each in scans):
        counts: Counter[str] = Counter()
        types: dict[str, str] = {}
        for each in scans:
            types |= dict(each.topics.values())
            counts.update(each.messages())
        spans = [each.span for each in scans if each.span is not None]
        span = [min(a for a, _ in spans), max(b for _, b in spans)] if spans else None
        whole = all(each.ended for each in scans)
        return _bag(path, paths, types, counts, span, whole) | _ticks(open_record(path, scans))
    try:
        reader = open_bag(path)
    except UniconError as error:
        if path.suffix == ".partial":
            raise UniconError(
                f"{path} is not a recording that was cut off: {why}; give what a run has left or "
                "is writing"
            ) from error
        raise
    try:  # a bag that is not of unicon, or compressed
        types, counts = {}, Counter()
        for each in reader.connections:
            types.setdefault(each.topic, each.msgtype)
            counts[each.topic] += each.msgcount
        span = [int(reader.start_time), int(reader.end_time)] if reader.message_count else None
    finally:
        reader.close()
    paths = [each for each in path.iterdir() if each.is_file()] if path.is_dir() else [path]
    return _bag(path, sorted(paths), types, counts, span, True)


def _bag(
    path: Path,
    paths: list[Path],
    types: dict[str, str],
    counts: Counter[str],
    span: list[int] | None,
    whole: bool,
) -> AnyDict:
    return {
        "path": str(path),
        "files": [each.name for each in paths],
        "bytes": sum(each.stat().st_size for each in paths),
        "cut_off": not whole,
        "span_ns": span,
        "messages": counts.total(),
        "topics": {name: {"type": kind, "messages": counts[name]} for name, kind in types.items()},
    }


def _ticks(record: Record) -> AnyDict:
    facts, phases = record.facts, np.asarray(record.phases)
    try:
        period = record.period
    except UniconError:
        period = 0.0
    skipped = np.diff(record.ticks) - 1 - (phases[1:] != phases[:-1])  # a new phase skips one
    return {name: facts[name] for name in TOLD if facts.get(name)} | {
        "period_s": period,
        "ticks": len(record.ticks),
        "missing_ticks": int(np.maximum(skipped, 0).sum()),
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


def info_text(info: AnyDict) -> str:
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
    lines = aligned(rows, underlined=False)
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


def _heads(record: Record, begin: int, end: int) -> list[Array]:
    rows = slice(begin, end)
    phases = np.array(record.phases[rows], "U8")
    return [record.stamps[rows], record.ticks[rows], phases, record.ended[rows]]


def _npz(record: Record, path: Path, names: Sequence[str], moment: str) -> None:
    """Write one state after the other, so that only one is in memory."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED, allowZip64=True) as archive:

        def add(name: str, values: Array) -> None:
            with archive.open(f"{name}.npy", "w", force_zip64=True) as file:
                np.lib.format.write_array(file, values, allow_pickle=False)

        for name, values in zip(HEADS, _heads(record, 0, len(record.ticks))):
            add(name, values)
        for name in names:
            add(name, record.states(name, moment))
            if elements := record.layout.specs[name].names:
                add(f"{name}.names", np.array(elements))


def _csv(record: Record, path: Path, names: Sequence[str], moment: str) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        write = csv.writer(file, lineterminator="\n")
        write.writerow(_titles(record, names))
        for columns in _blocks(record, names, moment):  # with bools as 0 and 1
            plain = (each.view(np.uint8) if each.dtype == bool else each for each in columns)
            write.writerows(zip(*(each.tolist() for each in plain)))


def _parquet(record: Record, path: Path, names: Sequence[str], moment: str) -> None:
    pyarrow = imported("pyarrow", "export to Parquet", "parquet")
    from pyarrow import parquet

    with ExitStack() as stack:
        writer = None
        for columns in _blocks(record, names, moment):
            table = pyarrow.table([*map(pyarrow.array, columns)], names=_titles(record, names))
            writer = writer or stack.enter_context(parquet.ParquetWriter(path, table.schema))
            writer.write_table(table)


def _titles(record: Record, names: Sequence[str]) -> list[str]:
    return [*HEADS, *(each for name in names for each in record.layout.elements(name))]


def _blocks(record: Record, names: Sequence[str], moment: str) -> Iterator[list[Array]]:
    """Yield all columns, each of shape (ticks,), some ticks at a time."""
    for begin in range(0, max(len(record.ticks), 1), BLOCK):
        end = min(begin + BLOCK, len(record.ticks))
        columns = _heads(record, begin, end)
        for name in names:
            values = record.states(name, moment, slice(begin, end))
            width = len(record.layout.elements(name))
            columns += map(np.ascontiguousarray, values.reshape(end - begin, width).T)
        yield columns


FORMATS: dict[str, Callable[[Record, Path, Sequence[str], str], None]] = {
    ".npz": _npz,
    ".csv": _csv,
    ".parquet": _parquet,
}
"""Ending of the file to what writes it."""
