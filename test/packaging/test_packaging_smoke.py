"""A quick look at the package where it is installed: it imports, answers and finds its files.

The only tests that run where UNICON_TESTS=smoke is set, as inside the colcon test.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from source_tree import ROOT

pytestmark = pytest.mark.smoke
HEAVY = ("rclpy", "mujoco", "onnxruntime")


def run(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    # The source tree comes last: an installation that is sourced goes first.
    path = os.pathsep.join(p for p in (os.environ.get("PYTHONPATH", ""), str(ROOT)) if p)
    return subprocess.run(
        [sys.executable, *arguments],
        cwd=cwd,
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )


def heavy_modules_after(code: str, cwd: Path) -> list[str]:
    ask = f"import json, sys; print(json.dumps([m for m in {HEAVY} if m in sys.modules]))"
    done = run("-c", f"{code}\n{ask}", cwd=cwd)
    assert done.returncode == 0, done.stderr
    loaded: list[str] = json.loads(done.stdout.splitlines()[-1])
    return loaded


@pytest.mark.parametrize(
    "package", ["unicon_base", "unicon_core", "unicon_msgs_map", "unicon_ros", "unicon_lab"]
)
def test_importing_a_package_loads_neither_ros_nor_simulator_nor_onnx(
    package: str, tmp_path: Path
) -> None:
    assert heavy_modules_after(f"import {package}", tmp_path) == []


def test_help_loads_neither_ros_nor_simulator_nor_onnx(tmp_path: Path) -> None:
    code = (
        "from unicon_ros.cli.main import main\n"
        "try:\n    main(['--help'])\nexcept SystemExit as done:\n    assert not done.code"
    )
    assert heavy_modules_after(code, tmp_path) == []


def test_python_dash_m_prints_the_commands(tmp_path: Path) -> None:
    done = run("-m", "unicon_ros", "--help", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    for command in ("run", "check", "show", "robots"):
        assert command in done.stdout


def test_the_main_workflow_is_found_and_clean(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    done = run("-m", "unicon_ros", "check", "go2_stand", cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
