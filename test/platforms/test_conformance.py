"""Every simulator passes the conformance suite; those that are not installed are skipped."""

from __future__ import annotations

from typing import ClassVar

import pytest

from unicon_core.conformance import Conformance

# What these tests run against, the most that config/evidence.yaml may say by them.
EVIDENCE = "vendor"

pytest.importorskip("mujoco", reason="mujoco is not installed: pip install 'unicon_ros[sim]'")


class Installed(Conformance):
    """Of an engine that may not be there; on a class that is not collected itself."""

    __test__ = False
    module: ClassVar[str]

    @pytest.fixture(autouse=True)
    def installed(self) -> None:
        pytest.importorskip(self.module, reason=f"pip install 'unicon_ros[sim-{self.platform}]'")


class TestMujoco(Conformance):
    platform = "mujoco"


class TestPybullet(Installed):
    __test__ = True
    platform = module = "pybullet"


@pytest.mark.slow
class TestMjx(Installed):
    __test__ = True
    platform = "mjx"
    module = "mujoco.mjx"
    near = 1e-3


@pytest.mark.slow
class TestNewton(Installed):
    __test__ = True
    platform = module = "newton"
    near = 1e-3


@pytest.mark.slow
@pytest.mark.timeout(400)  # compiled at first
class TestGenesis(Installed):
    __test__ = True
    platform = module = "genesis"
