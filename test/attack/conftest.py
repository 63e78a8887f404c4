"""What several attacks use."""

from __future__ import annotations

import pytest

from unicon_ros.bench.report import free_domain


@pytest.fixture
def domain(monkeypatch: pytest.MonkeyPatch) -> None:
    """A ROS domain of this test alone."""
    monkeypatch.setenv("ROS_DOMAIN_ID", str(free_domain()))
