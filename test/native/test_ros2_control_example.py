"""The example of a controller for ros2_control: against its headers, and run without ROS."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from unicon_ros.cli.main import main

pytest.importorskip("mujoco")
onnxruntime = pytest.importorskip("onnxruntime")
pytestmark = pytest.mark.slow

HERE = Path(__file__).resolve().parent
EXAMPLE = HERE.parents[1] / "examples" / "ros2_control"
STRICT = ("-std=c++17", "-Wall", "-Wextra", "-Werror")
COMPILERS = ["g++", "clang++"]


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An exported walk."""
    out = tmp_path_factory.mktemp("walk") / "out"
    words = ["--set", "commands=[]", "--set", "flow={policy: walk}", "--ticks", "200"]
    assert main(["export", "go2_walk", "--cpp", str(out), *words]) == 0
    return out


def compiled(compiler: str, *words: str | Path) -> None:
    if shutil.which(compiler) is None:
        pytest.skip(f"no {compiler}")
    done = subprocess.run([compiler, *STRICT, *words], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr


def headers() -> list[Path]:
    """Return folders of headers of ROS 2, or skip: packages lie in `include/PACKAGE` or beside."""
    given = os.environ.get("UNICON_ROS2_CONTROL", "")
    prefixes = [Path(each) for each in given.split(":") if each] or [*Path("/opt/ros").glob("*")]
    folders = [
        folder
        for prefix in prefixes
        for folder in (prefix / "include", *prefix.joinpath("include").glob("*/"))
    ]
    if not any(
        each.joinpath("controller_interface/controller_interface.hpp").is_file() for each in folders
    ):
        pytest.skip(
            "no headers of ros2_control in /opt/ros (ros-$ROS_DISTRO-controller-interface), nor "
            "below a prefix of UNICON_ROS2_CONTROL=PREFIX:…"
        )
    return folders


@pytest.mark.parametrize("compiler", COMPILERS)
def test_it_compiles_against_the_interface(compiler: str, walk: Path) -> None:
    found = [word for each in headers() for word in ("-isystem", str(each))]
    compiled(compiler, "-fsyntax-only", f"-I{walk}", *found, EXAMPLE / "unicon_controller.cpp")


@pytest.mark.parametrize("compiler", COMPILERS)
def test_it_commands_what_was_recorded(compiler: str, walk: Path, tmp_path: Path) -> None:
    library = next((Path(onnxruntime.__file__).parent / "capi").glob("libonnxruntime.so*"), None)
    if library is None:
        pytest.skip("onnxruntime without a shared library")
    places = [f"-I{each}" for each in (walk, EXAMPLE, HERE / "ros2_stub")]
    sources = HERE / "ros2_control_robot.cpp", walk / "controller.cpp"
    flags = ("-O2", "-ffp-contract=off", *places, *sources, "-o", tmp_path / "robot", "-ldl")
    compiled(compiler, *flags)
    done = subprocess.run([tmp_path / "robot", walk, library], capture_output=True, text=True)
    print(done.stdout)
    assert done.returncode == 0, done.stdout + done.stderr
