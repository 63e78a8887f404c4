"""A package that is deleted takes nothing else with it: the core and the command line go on."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import pytest
from source_tree import copy_source

REMOVED = ("unicon_lab", "unicon_sims", "unicon_hardware", "unicon_manipulation")


@pytest.fixture(scope="module")
def python(tmp_path_factory: pytest.TempPathFactory, under_colcon: bool) -> list[str]:
    """Return a Python with our dependencies and entry points that finds only a part of us."""
    if under_colcon:
        pytest.skip("colcon tests its own installation")
    pytest.importorskip("mujoco")
    pytest.importorskip("onnxruntime")
    folder = tmp_path_factory.mktemp("part")
    source = copy_source(folder / "source")
    for package in REMOVED:
        shutil.rmtree(source / package)
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", folder / "venv"], check=True)
    [places] = (folder / "venv").glob("lib/python*/site-packages")
    # As plain paths: no finder of an editable installation is put in place by them.
    (places / "parts.pth").write_text(f"{source}\n{sysconfig.get_path('purelib')}\n")
    return [str(folder / "venv" / "bin" / "python"), "-m", "unicon_ros"]


def unicon(python: list[str], folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    plain = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    return subprocess.run(
        [*python, *words], cwd=folder, env=plain, capture_output=True, text=True, timeout=60
    )


def test_a_walk_runs_and_is_checked(python: list[str], tmp_path: Path) -> None:
    words = ("run", "go2_walk", "--no-ros", "--speed", "max", "--duration", "0.5")
    ran = unicon(python, tmp_path, *words, "--report", "run.json")
    assert (ran.returncode, ran.stderr) == (0, "")
    assert (tmp_path / "run.json").is_file()
    checked = unicon(python, tmp_path, "check", "go2_walk")
    assert checked.returncode == 0, checked.stdout
    assert checked.stdout.endswith("clean\n")


def test_what_is_gone_is_no_command_and_one_error(python: list[str], tmp_path: Path) -> None:
    told = unicon(python, tmp_path, "--help").stdout
    assert "\n    check " in told
    assert "\n    sweep " not in told
    refused = unicon(python, tmp_path, "run", "go2_walk", "--set", "platform=pybullet")
    assert refused.returncode == 1
    [line] = refused.stderr.splitlines()
    assert "no module 'unicon_sims.pybullet.platform'" in line
