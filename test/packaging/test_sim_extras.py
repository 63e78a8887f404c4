"""Each simulator's extra installs by itself in a fresh venv and passes the conformance suite there.

An extra takes one to ten minutes and up to 4 GB, which go again.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import venv
from pathlib import Path

import pytest

from unicon_core.conformance import Conformance

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1800)]

ROOT = Path(__file__).resolve().parents[2]
TESTS = len([name for name in dir(Conformance) if name.startswith("test_")])
ENGINES = {
    "sim": "Mujoco",
    "sim-pybullet": "Pybullet",
    "sim-mjx": "Mjx",
    "sim-newton": "Newton",
    "sim-genesis": "Genesis",
}


def ran(*words: str | Path) -> subprocess.CompletedProcess[str]:
    """Run a program; return what it printed."""
    env = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "LD_LIBRARY_PATH")}
    command = [str(word) for word in words]
    return subprocess.run(
        command, capture_output=True, text=True, check=False, env=env, cwd=ROOT, timeout=1700
    )


@pytest.mark.parametrize("extra", ENGINES)
def test_an_extra_is_enough(extra: str, tmp_path: Path) -> None:
    if extra == "sim-pybullet" and sys.version_info >= (3, 12):
        pytest.skip("PyBullet has wheels for Python 3.10 and 3.11 only")
    if shutil.disk_usage(tmp_path).free < 12e9:
        pytest.skip("12 GB of free disk are needed")
    venv.create(tmp_path / "venv", with_pip=True)
    python = tmp_path / "venv" / "bin" / "python"
    wanted = [f"{ROOT}[{extra}]", "pytest", "pytest-timeout"]
    got = ran(python, "-m", "pip", "install", "-q", "--no-cache-dir", *wanted)
    if re.search("NameResolution|Temporary failure|Max retries|Failed to establish", got.stderr):
        pytest.skip(f"not to be had from here: {got.stderr.strip().splitlines()[-1]:.200}")
    assert got.returncode == 0, got.stderr
    suite = "test/platforms/test_conformance.py"
    words = ["-q", "--noconftest", "-m", "slow or not slow", "-p", "no:cacheprovider"]
    done = ran(python, "-m", "pytest", *words, "-k", ENGINES[extra], suite)
    assert done.returncode == 0, done.stdout[-3000:]
    passed = re.search(r"(\d+) passed", done.stdout)
    assert passed is not None
    assert int(passed[1]) >= TESTS
    assert "skipped" not in done.stdout
    shutil.rmtree(tmp_path / "venv")
