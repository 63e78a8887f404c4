"""Last words: what a process that ended by itself had printed last; for whoever started it."""

from __future__ import annotations

import os
from pathlib import Path

LAST_WORDS = 4096
"""Bytes of a log that are looked at for a reason."""
LOG_BYTES = 10_000_000
"""Of a log that is kept: an engine that warns in every step must not fill the disk."""


def last_words(path: Path) -> str:
    """Return the last line of a log, in words if there is none."""
    try:
        with path.open("rb") as log:
            log.seek(max(0, os.fstat(log.fileno()).st_size - LAST_WORDS))
            lines = log.read().decode("utf-8", "replace").split("\n")
    except OSError:
        lines = []
    said = [line.strip() for line in lines if line.strip()]
    return said[-1][:300] if said else "it printed nothing"
