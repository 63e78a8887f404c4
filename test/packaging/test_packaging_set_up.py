"""`make venv` decides rightly on machines that this one is not."""

from __future__ import annotations

import importlib.util
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest
from source_tree import ROOT

SCRIPT = ROOT / "tools" / "lib" / "make_venv.py"


@pytest.fixture(scope="module")
def make_venv() -> ModuleType:
    spec = importlib.util.spec_from_file_location("make_venv", SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_an_old_python_is_named_with_the_remedy(make_venv: ModuleType) -> None:
    assert make_venv.obstacle((3, 8, 10), True) == (
        "python3 is 3.8, unicon_ros needs 3.10 or newer: install one and run "
        "'make venv PYTHON=python3.12'"
    )


def test_a_missing_venv_module_is_named_with_the_remedy(make_venv: ModuleType) -> None:
    assert make_venv.obstacle((3, 12), False) == (
        "python3 lacks the venv module: install it ('sudo apt install python3-venv' on Debian "
        "and Ubuntu) and run 'make venv' again"
    )


def test_nothing_stands_in_the_way_of_a_complete_python(make_venv: ModuleType) -> None:
    assert make_venv.obstacle((3, 10), True) is None


def test_a_plain_x86_machine_gets_all_extras_of_setup_py(make_venv: ModuleType) -> None:
    setup_py = (ROOT / "setup.py").read_text(encoding="utf-8")
    _, extras, _, _ = make_venv.plan(None, "Linux", "x86_64", None)
    common = set(re.findall(r'^    "([\w-]+)": (?:\[|SIM)', setup_py, re.MULTILINE))
    # parquet is part of sweep; the others are what tests need besides.
    assert set(extras) == common - {"parquet"} | {"hw-unitree", "hw-arx", "foxglove"}


def test_a_plain_x86_machine_gets_the_ros_wheels(make_venv: ModuleType) -> None:
    venv_args, extras, constraints, note = make_venv.plan(None, "Linux", "x86_64", None)
    assert (venv_args, constraints, note) == ([], [], None)
    assert "ros" in extras


def test_an_arm_machine_is_told_to_source_a_ros_installation(make_venv: ModuleType) -> None:
    _, extras, _, note = make_venv.plan(None, "Linux", "aarch64", None)
    assert "ros" not in extras
    assert note == (
        "no ROS wheels exist for Linux aarch64: for --ros, source a ROS 2 installation (such as "
        "'. /opt/ros/jazzy/setup.sh') and run 'make clean-venv venv'"
    )


def test_a_sourced_ros_is_used_with_its_own_numpy(make_venv: ModuleType) -> None:
    venv_args, extras, constraints, _ = make_venv.plan("jazzy", "Linux", "x86_64", "1.26.4")
    assert venv_args == ["--system-site-packages"]
    assert "ros" not in extras
    assert constraints == ["numpy<2"]


def test_a_sourced_ros_with_numpy_2_holds_nothing_back(make_venv: ModuleType) -> None:
    assert make_venv.plan("lyrical", "Linux", "x86_64", "2.3.1")[2] == []


def test_the_library_path_of_another_venv_does_not_leak_in(make_venv: ModuleType) -> None:
    leaked = {make_venv.BOOTSTRAP_GUARD: "1", "LD_LIBRARY_PATH": "elsewhere", "PATH": "p"}
    assert make_venv.clean_environment(leaked) == {"PATH": "p"}


def test_the_library_path_of_a_sourced_ros_stays(make_venv: ModuleType) -> None:
    sourced = {"LD_LIBRARY_PATH": "ros/lib"}
    assert make_venv.clean_environment(sourced) == sourced


def test_uv_gets_what_pip_is_set_to(make_venv: ModuleType) -> None:
    listed = (
        ":env:.constraint='/g.txt'\nglobal.constraint='/h.txt'\n"
        "global.index-url='https://a/simple'\nglobal.extra-index-url='file:///b https://c'\n"
        "install.find-links='/d\\n/e'\n:env:.cert='/f.crt'\n"
    )
    found = make_venv.uv_environment(listed)
    assert found.pop("UV_INDEX_STRATEGY") == "unsafe-best-match"  # as pip does
    assert found == {
        "UV_DEFAULT_INDEX": "https://a/simple",
        "UV_INDEX": "file:///b https://c",
        "UV_FIND_LINKS": "/d,/e",
        "UV_CONSTRAINT": "/g.txt",
        "UV_SYSTEM_CERTS": "1",
    }


def test_pip_installs_where_uv_has_no_equal_of_a_setting(make_venv: ModuleType) -> None:
    assert make_venv.uv_environment("global.proxy='http://p'\n") is None


@pytest.mark.skipif(shutil.which("make") is None, reason="make is not installed")
def test_make_venv_with_an_old_python_prints_one_line_and_creates_nothing(tmp_path: Path) -> None:
    # A stand-in python3 that runs the script under a version that is too old.
    for name in ("Makefile", "setup.py", "pyproject.toml"):
        shutil.copy(ROOT / name, tmp_path)
    (tmp_path / "tools" / "lib").mkdir(parents=True)
    shutil.copy(SCRIPT, tmp_path / "tools" / "lib")
    old = tmp_path / "old_python3"
    old.write_text(
        f"#!{sys.executable}\nimport runpy, sys\nsys.argv.pop(0)\n"
        "sys.version_info = (3, 8, 10)\nrunpy.run_path(sys.argv[0], run_name='__main__')\n",
        encoding="utf-8",
    )
    old.chmod(0o755)
    env = {**os.environ, "MAKEFLAGS": ""}
    done = subprocess.run(
        ["make", "venv", f"PYTHON={old}"],
        cwd=tmp_path,
        env=env,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode != 0
    assert "make venv: python3 is 3.8, unicon_ros needs 3.10 or newer" in done.stderr
    assert "Traceback" not in done.stderr
    assert not (tmp_path / ".venv").exists()
