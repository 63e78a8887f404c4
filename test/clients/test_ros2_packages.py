"""`ros2 pkg|run|interface|topic` beside the example package: its executable, message and topics."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from their_clients import ROOT, Clients

pytestmark = [pytest.mark.ros, pytest.mark.slow, pytest.mark.timeout(400)]

PACKAGE = ROOT / "examples" / "pan_tilt"
GAZE = "pan_tilt/msg/Gaze"


@pytest.fixture(scope="module")
def install(tmp_path_factory: pytest.TempPathFactory, under_colcon: bool) -> Path:
    """The example, built by colcon with all in one prefix."""
    if under_colcon:
        pytest.skip("colcon runs these tests already")
    beside = Path(sys.executable).with_name("colcon")
    colcon = str(beside) if beside.exists() else shutil.which("colcon")
    if colcon is None:
        pytest.skip("colcon is not installed: pip install colcon-common-extensions 'setuptools<80'")
    root = tmp_path_factory.mktemp("packages")
    built = shutil.ignore_patterns("build", "*.egg-info", "__pycache__")
    shutil.copytree(PACKAGE, root / "src" / "pan_tilt", ignore=built)
    command = [colcon, "build", "--merge-install", "--event-handlers", "console_direct+"]
    done = subprocess.run(command, cwd=root, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return root / "install"


@pytest.fixture
def here(ros2: Clients, install: Path) -> Clients:
    """`ros2` with the example's prefix sourced."""
    (modules,) = install.glob("lib/python3*/site-packages")
    before = {
        name: ros2.environment.get(name) or os.environ.get(name)
        for name in ("AMENT_PREFIX_PATH", "PYTHONPATH")
    }
    mine = {"AMENT_PREFIX_PATH": str(install), "PYTHONPATH": str(modules)}
    joined = {n: os.pathsep.join(filter(None, [mine[n], before[n], str(ROOT)])) for n in mine}
    return replace(ros2, environment=ros2.environment | joined)


@pytest.fixture
def looks(
    here: Clients, started: Callable[..., Any], eventually: Callable[..., Any], tmp_path: Path
) -> Any:
    """The example's executable, run by `ros2 run`."""
    process = started(here, "run", "pan_tilt", "look", "--duration", "120")
    eventually(lambda: "/gaze" in here.run("topic", "list", "-t").stdout, process.said, 90.0)
    return process


def theirs(clients: Clients) -> Clients:
    if clients.whose == "equal":
        pytest.skip("ros2cli is neither installed nor its source named (UNICON_ROS2_SOURCE)")
    return clients


def test_the_package_its_executable_and_its_message_are_known(here: Clients) -> None:
    ros2 = theirs(here)
    assert "pan_tilt" in ros2.run("pkg", "list").stdout.splitlines()
    assert ros2.run("pkg", "executables", "pan_tilt").stdout.split() == ["pan_tilt", "look"]
    shown = ros2.run("interface", "show", GAZE)
    assert shown.returncode == 0, shown.stderr
    assert re.search(r"^float64 pan\b", shown.stdout, re.M)


def test_its_topics_have_its_own_type(here: Clients, looks: Any) -> None:
    topics = here.run("topic", "list", "-t").stdout.splitlines()
    assert f"/gaze [{GAZE}]" in topics
    assert f"/look_at [{GAZE}]" in topics
    assert "/joint_states [sensor_msgs/msg/JointState]" in topics


def test_generated_code_of_its_message_reads_what_it_sends(here: Clients, looks: Any) -> None:
    """As with the `.msg` in an ament_cmake package: code is generated from it here."""
    sys.path.insert(0, str(ROOT / "tools" / "lib"))
    from make_type_support import Unavailable, environment, type_support

    try:
        prefix = type_support({"pan_tilt": PACKAGE / "msg"})
    except Unavailable as error:
        pytest.skip(f"no code can be generated: {error}")
    made = environment(prefix, {**os.environ, **here.environment})
    listener = replace(here, environment={**here.environment, **made})
    done = listener.run("topic", "echo", "--once", "/gaze", GAZE)
    assert done.returncode == 0, done.stderr
    assert "base_link" in done.stdout
    assert "pan" in done.stdout
