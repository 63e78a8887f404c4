"""What the tests of records share: the helpers beside them, and a ring that is soon full."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

HERE = Path(__file__).resolve().parent
sys.path += [str(HERE), str(HERE.parent / "attack")]


@pytest.fixture
def short_ring(monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep one second and not ten."""
    monkeypatch.setattr("unicon_core.runtime.tick_ring.KEPT_S", 1.0)
