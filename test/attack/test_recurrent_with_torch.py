"""The slow suite installs torch by itself, into a folder of the test, and runs what needs it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent.parent
FILES = ("test/attack/test_recurrent_torchscript.py", "test/policies/test_torch.py")


@pytest.mark.slow
@pytest.mark.timeout(1700)
def test_torchscript_policies_hold_where_torch_is_installed(tmp_path: Path) -> None:
    target = tmp_path / "torch"
    install = [sys.executable, "-m", "pip", "install", "-q", "--target", str(target)]
    done = subprocess.run(
        [*install, "torch==2.13.0"], capture_output=True, text=True, check=False, timeout=1500
    )
    if done.returncode:
        last = (done.stderr.strip().splitlines() or ["no reason told"])[-1]
        pytest.skip(f"torch cannot be installed here: {last}")
    environment = {**os.environ, "PYTHONPATH": str(target)}
    for file in FILES:
        held = subprocess.run(
            [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", file],
            cwd=ROOT,
            env=environment,
            capture_output=True,
            text=True,
            check=False,
            timeout=600,
        )
        assert held.returncode == 0, held.stdout[-3000:]
        assert " passed" in held.stdout
        assert " skipped" not in held.stdout
