"""Modules of tools/train, which are no package and no dependency, for the tests of its policies."""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path
from typing import Any

__all__ = ["trainer"]

_FOLDER = str(Path(__file__).resolve().parents[1] / "tools" / "train")


def trainer(*names: str) -> tuple[Any, ...]:
    """Return modules of the trainer by name."""
    sys.path.insert(0, _FOLDER)
    try:
        return tuple(import_module(name) for name in names)
    finally:
        sys.path.remove(_FOLDER)
