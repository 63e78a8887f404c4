"""What a run left on disk: report, trace, picture, and how much of its recording can be read."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

_CHUNK, _MESSAGE = 0x06, 0x05  # opcodes, mcap.dev/spec
_MAGIC = 8


def report_of(folder: Path) -> dict[str, Any]:
    """Return the report; empty where there is none or it is not whole."""
    values = _json(folder / "report.json")
    return values if isinstance(values, dict) else {}


def what_is_there(folder: Path) -> list[str]:
    """Return words for what is there and whole enough to be read."""
    words = [word for word in ("report", "trace") if _json(folder / f"{word}.json")]
    picture = folder / "picture.png"
    if picture.is_file() and picture.stat().st_size:
        words.append("picture")
    return words


def recorded_span(folder: Path) -> tuple[int, int] | None:
    """Return first and last time of the messages in a recording in [ns]; None where there are none.

    Reads what is whole, also where the file was never closed.
    """
    spans = [_span(path) for path in folder.rglob("*") if path.is_file() and _is_mcap(path)]
    found = [span for span in spans if span is not None]
    return (min(a for a, _ in found), max(b for _, b in found)) if found else None


def _json(path: Path) -> Any:
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None


def _is_mcap(path: Path) -> bool:
    with path.open("rb") as file:
        return file.read(5) == b"\x89MCAP"


def _span(path: Path) -> tuple[int, int] | None:
    data = path.read_bytes()
    first, last, at = 1 << 63, -1, _MAGIC
    while at + 9 <= len(data):
        kind, size = struct.unpack_from("<BQ", data, at)
        at += 9
        if at + size > len(data):
            break  # the end was not written
        if kind == _CHUNK and size >= 16:
            begin, end = struct.unpack_from("<QQ", data, at)
            first, last = (min(first, begin), max(last, end)) if end else (first, last)
        elif kind == _MESSAGE and size >= 14:
            (stamp,) = struct.unpack_from("<Q", data, at + 6)
            first, last = min(first, stamp), max(last, stamp)
        at += size
    return (first, last) if last >= 0 else None
