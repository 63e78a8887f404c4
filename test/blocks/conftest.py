"""Blocks are built on the bench that outsiders have too."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from unicon_core.testing import Bench


@pytest.fixture
def bench() -> Callable[..., Bench]:
    """Builds a Bench of a robot, with a batch axis where asked."""
    return Bench
