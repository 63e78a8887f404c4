"""Every simulator passes the conformance suite; those that are not installed are skipped."""

from __future__ import annotations

import pytest

from unicon_core.conformance import Conformance

pytest.importorskip("mujoco", reason="mujoco is not installed: pip install 'unicon_ros[sim]'")


class TestMujoco(Conformance):
    platform = "mujoco"


class TestPybullet(Conformance):
    platform = "pybullet"

    @pytest.fixture(autouse=True)
    def installed(self) -> None:
        pytest.importorskip("pybullet", reason="pip install 'unicon_ros[sim-pybullet]'")
