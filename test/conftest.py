"""What every test of the project shares: a ROS of its own on loopback, and the assets folder."""

from __future__ import annotations

import os
import random
import shutil
import socket
import tempfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
LOG_DIR = tempfile.mkdtemp(prefix="unicon_ros_log_")


# Set before any test imports rclpy, and inherited by the processes that tests start. Domains above
# 101 would reach into Linux's ephemeral ports (7400 + 250 × domain).
def _is_free(domain: int) -> bool:
    """Tell whether no participant of this machine is in a domain (RTPS 9.6.2: ports from it)."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(("", 7400 + 250 * domain + 10))
        except OSError:
            return False
    return True


_domains = random.SystemRandom().sample(range(1, 102), 101)
os.environ["ROS_DOMAIN_ID"] = str(next(filter(_is_free, _domains), _domains[0]))
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
if os.environ.get("ROS_DISTRO") == "humble":
    os.environ["ROS_LOCALHOST_ONLY"] = "1"
os.environ["ROS_LOG_DIR"] = LOG_DIR
for name in ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE"):
    os.environ[name] = str(ROOT / "config" / "dds" / "fast_discovery.xml")


def pytest_unconfigure(config: pytest.Config) -> None:
    """Remove the log folder of this run."""
    shutil.rmtree(LOG_DIR, ignore_errors=True)


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Keep only the tests marked `smoke` where UNICON_TESTS=smoke asks for a quick look."""
    if os.environ.get("UNICON_TESTS") != "smoke":
        return
    kept = [item for item in items if item.get_closest_marker("smoke")]
    config.hook.pytest_deselected(items=[item for item in items if item not in kept])
    items[:] = kept


@pytest.fixture(scope="session")
def under_colcon(request: pytest.FixtureRequest) -> bool:
    """Whether `colcon test` runs this pytest: it names the package as prefix of its report."""
    return request.config.getoption("junitprefix", default=None) == "unicon_ros"


@pytest.fixture(scope="session")
def assets() -> Path:
    """The folder with other people's models and policies, which are not part of the repository."""
    named = os.environ.get("UNICON_ASSETS")
    folder = Path(named) if named else ROOT.parent / "shared" / "assets"
    if not (folder / "README.md").is_file():
        pytest.skip(f"no assets at {folder}: set UNICON_ASSETS to the folder with the test assets")
    return folder
