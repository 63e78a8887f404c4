"""A package that pip installed is complete: code, types, resources, executables."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from source_tree import PACKAGES, copy_source, tracked_files


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory, under_colcon: bool) -> Path:
    """Install a copy of the source tree with `pip install`, and return the prefix."""
    if under_colcon:
        pytest.skip("colcon tests its own installation")
    if _old_setuptools():
        pytest.importorskip("wheel", reason="setuptools before 70.1 builds with the package wheel")
    source = copy_source(tmp_path_factory.mktemp("source") / "unicon_ros")
    prefix = tmp_path_factory.mktemp("prefix")
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "install", "--quiet"]
    # --ignore-installed: the development installation of this environment stays as it is.
    options = ["--no-deps", "--no-build-isolation", "--no-index", "--ignore-installed"]
    done = subprocess.run(
        [*pip, *options, "--prefix", str(prefix), str(source)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return prefix


@pytest.fixture(scope="module")
def site_packages(installed: Path) -> Path:
    """Return the folder below the prefix that holds the code."""
    [init] = installed.rglob("unicon_core/__init__.py")
    return init.parent.parent


def _old_setuptools() -> bool:
    import setuptools

    return tuple(map(int, setuptools.__version__.split(".")[:2])) < (70, 1)


def _data(path: Path) -> bool:
    # pip compiles the launch file where it lies.
    return path.is_file() and path.suffix != ".pyc"


def test_every_resource_is_installed_below_share(installed: Path) -> None:
    share = installed / "share" / "unicon_ros"
    expected = {n for n in tracked_files() if n.startswith(("config/", "launch/"))}
    found = {p.relative_to(share).as_posix() for p in share.rglob("*") if _data(p)}
    assert found == {*expected, "package.xml"}
    marker = installed / "share" / "ament_index" / "resource_index" / "packages" / "unicon_ros"
    assert marker.is_file()


def test_every_module_and_what_stands_beside_it_is_installed(site_packages: Path) -> None:
    packages = tuple(f"{package}/" for package in PACKAGES)
    endings = (
        ".py",
        "py.typed",
        ".msg",
        ".h",
        ".cpp",
        ".txt",
        ".yaml",
        ".json",
        ".xml",
        ".mplstyle",
    )
    expected = {n for n in tracked_files() if n.startswith(packages) and n.endswith(endings)}
    missing = {name for name in expected if not (site_packages / name).is_file()}
    assert missing == set()


def test_tests_and_tools_are_not_installed(site_packages: Path) -> None:
    assert not (site_packages / "test").exists()
    assert not (site_packages / "tools").exists()


@pytest.mark.parametrize("name", ["unicon", "unicon_node"])
def test_an_executable_is_installed(installed: Path, name: str) -> None:
    assert os.access(installed / "bin" / name, os.X_OK)


def test_resources_are_found_where_pip_put_them(
    installed: Path, site_packages: Path, tmp_path: Path
) -> None:
    code = "from unicon_base.resources import find_config; print(find_config('robots', 'go2'))"
    env = {k: v for k, v in os.environ.items() if k not in ("UNICON_PATH", "AMENT_PREFIX_PATH")}
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        env={**env, "PYTHONPATH": str(site_packages)},
        capture_output=True,
        text=True,
        check=True,
    )
    expected = installed / "share" / "unicon_ros" / "config" / "robots" / "go2.yaml"
    assert Path(done.stdout.strip()) == expected
