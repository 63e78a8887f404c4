"""What every test of the project shares: a ROS of its own on loopback, and the assets folder."""

from __future__ import annotations

import gc
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace

import pytest
from hypothesis import settings
from passing import let_time_pass
from peer import Peer
from stolen import Stolen
from turns import turn

from unicon_base.errors import UniconError
from unicon_base.resources import find_resource
from unicon_ros.bench.report import free_domain

ROOT = Path(__file__).resolve().parent.parent
stolen = Stolen()
LOG_DIR = tempfile.mkdtemp(prefix="unicon_ros_log_")


# Set before any test imports rclpy, and inherited by the processes that tests start.
os.environ["ROS_DOMAIN_ID"] = str(free_domain())
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
if os.environ.get("ROS_DISTRO") == "humble":
    os.environ["ROS_LOCALHOST_ONLY"] = "1"
os.environ["ROS_LOG_DIR"] = LOG_DIR
os.environ["UNICON_FAULTS"] = f"{LOG_DIR}/faults"  # not the user's
os.environ["UNICON_LATCHES"] = f"{LOG_DIR}/latches"
for name in ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE"):
    os.environ[name] = str(ROOT / "config" / "dds" / "fast_discovery.xml")
# A shell's background job and nohup ignore them, and so would the processes that tests interrupt.
for number, usual in ((signal.SIGINT, signal.default_int_handler), (signal.SIGHUP, signal.SIG_DFL)):
    if signal.getsignal(number) is signal.SIG_IGN:
        signal.signal(number, usual)
settings.register_profile("busy", deadline=None)  # a busy machine takes its time for an example
settings.load_profile("busy")
if (ASSETS := ROOT.parent / "shared" / "assets").is_dir():
    os.environ.setdefault("UNICON_ASSETS", str(ASSETS))
os.environ.setdefault("UNICON_TURNS", LOG_DIR)  # workers have that of who starts them
SMOKE = os.environ.get("UNICON_TESTS") == "smoke"
PROBE = """\
import os
os.environ.setdefault("MUJOCO_GL", "egl")
import mujoco
mujoco.Renderer(mujoco.MjModel.from_xml_string("<mujoco/>"), 8, 8).render()
os._exit(0)
"""


def pytest_ignore_collect(collection_path: Path) -> bool | None:
    """For a quick look leave out whole files: to import all of them takes longer than to test."""
    if not SMOKE or not (collection_path.name.startswith("test_") and collection_path.is_file()):
        return None
    return "mark.smoke" not in collection_path.read_text("utf-8") or None


def pytest_unconfigure(config: pytest.Config) -> None:
    """Remove the log folder of this run."""
    shutil.rmtree(LOG_DIR, ignore_errors=True)


@pytest.hookimpl(hookwrapper=True, tryfirst=True)  # before the test's time begins to count
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """Let a test marked `alone` run while no other worker runs one."""
    stolen.begin()
    if not hasattr(item.config, "workerinput"):  # there is one process only
        yield
        return
    with turn(Path(os.environ["UNICON_TURNS"]), item.get_closest_marker("alone") is not None):
        yield


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Keep only the tests marked `smoke` where UNICON_TESTS=smoke asks for a quick look.

    Repeat what fails while the host took the machine away, and what is `alone`, since it measures
    time: three failures in a row are none of the machine's.
    """
    if config.pluginmanager.hasplugin("rerunfailures"):
        for item in items:
            alone = item.get_closest_marker("alone") is not None
            item.add_marker(pytest.mark.flaky(reruns=2, condition=alone or stolen))
    if not SMOKE:
        return
    kept = [item for item in items if item.get_closest_marker("smoke")]
    config.hook.pytest_deselected(items=[item for item in items if item not in kept])
    items[:] = kept


def pytest_collection_finish(session: pytest.Session) -> None:
    """Keep runs in this process from looking through all that pytest has collected.

    Each run collects garbage before it freezes what there is: 0.24 s and more beside 7,500 tests,
    which was most of what most runs took. Young garbage is enough; all is frozen, as ever.
    """
    from unicon_core import pacing

    young = SimpleNamespace(**vars(gc))
    young.collect = partial(gc.collect, 1)
    pacing.gc = young  # type: ignore[attr-defined]


@pytest.fixture(autouse=True)
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let runs in this process be held up by a busy machine; who tests hangs says `pacing.hang`."""
    from unicon_core import pacing

    for simulated in pacing.HANG:
        monkeypatch.setitem(pacing.HANG, simulated, 20.0)


@pytest.fixture(autouse=True)
def latch_files(monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder for latches of this test alone: domains are taken again by tests that come later."""
    folder = Path(tempfile.mkdtemp(prefix="latches_", dir=LOG_DIR))
    monkeypatch.setenv("UNICON_LATCHES", str(folder))
    return folder


@pytest.fixture
def time_passes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sleeps of the test's thread take no time, and the clocks go on by them."""
    let_time_pass(monkeypatch)


@pytest.fixture
def short_damping(monkeypatch: pytest.MonkeyPatch) -> None:
    """Robots of this process are damped for 0.1 s at their end, which others test, not for 0.5."""
    monkeypatch.setattr("unicon_core.runtime.phases.DAMPING_TIME", 0.1)


@pytest.fixture
def processes() -> Iterator[Callable[..., Peer]]:
    """Starts commands that say JSON lines, and kills them at the end."""
    started: list[Peer] = []

    def start(*command: str) -> Peer:
        started.append(Peer(*command))
        return started[-1]

    yield start
    for peer in started:
        peer.kill()


@pytest.fixture(scope="session")
def under_colcon(request: pytest.FixtureRequest) -> bool:
    """Whether `colcon test` runs this pytest: it names the package as prefix of its report."""
    return request.config.getoption("junitprefix", default=None) == "unicon_ros"


@pytest.fixture(scope="session")
def gl() -> None:
    """Skips where this machine cannot render offscreen."""
    pytest.importorskip("mujoco", reason="mujoco is not installed: pip install 'unicon_ros[sim]'")
    done = subprocess.run(
        [sys.executable, "-c", PROBE], capture_output=True, text=True, check=False
    )
    if done.returncode:
        last = (done.stderr.strip().splitlines() or ["no reason told"])[-1]
        pytest.skip(f"no offscreen OpenGL ({last}): apt install libegl1 libgl1-mesa-dri")


@pytest.fixture(scope="session")
def at_hand(request: pytest.FixtureRequest) -> Callable[[str], None]:
    """Skip where what a shipped workflow needs is absent: an asset, torch, OpenGL of cameras."""

    from unicon_core.workflow import load_document
    from unicon_ros.cli.assets import references

    def ask(name: str) -> None:
        document = load_document(name)
        for reference in sorted(references(document)):
            try:
                find_resource(reference, "asset")
            except UniconError as error:
                pytest.skip(str(error))
        text = document.path.read_text("utf-8")
        if "unicon_ros[torch]" in text and find_spec("torch") is None:
            pytest.skip("TorchScript: pip install 'unicon_ros[torch]'")
        if "- camera: " in text:
            request.getfixturevalue("gl")

    return ask


@pytest.fixture(scope="session")
def assets() -> Path:
    """The folder with other people's models and policies, which are not part of the repository."""
    folder = Path(os.environ.get("UNICON_ASSETS") or ASSETS)
    if not (folder / "README.md").is_file():
        pytest.skip(f"no assets at {folder}: set UNICON_ASSETS to the folder with the test assets")
    return folder
