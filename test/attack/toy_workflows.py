"""The toy Go2 of the tests of `unicon check`, for attacks on what check and run refuse."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1] / "check"))

from check_helpers import (
    JOINTS,
    NULL,
    ROOT,
    STAND,
    check,
    codes,
    note_of,
    text_of,
    write_network,
    write_workflow,
)

__all__ = [
    "JOINTS",
    "NULL",
    "ROOT",
    "STAND",
    "check",
    "codes",
    "note_of",
    "text_of",
    "write_network",
    "write_workflow",
]
