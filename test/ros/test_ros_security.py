"""A run that ROS is told to secure is secured or refused, never neither."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = [pytest.mark.ros, pytest.mark.timeout(120)]

RUN = ["run", "go2_stand", "--ros", "--set", "platform=fake", "--speed", "max", "--duration", "0.5"]


def run(tmp_path: Path, strategy: str, enclave: str) -> subprocess.CompletedProcess[str]:
    (tmp_path / "enclaves" / "known").mkdir(parents=True)
    security = {
        "ROS_SECURITY_KEYSTORE": str(tmp_path),
        "ROS_SECURITY_ENABLE": "true",
        "ROS_SECURITY_STRATEGY": strategy,
    }
    command = [sys.executable, "-m", "unicon_ros", *RUN, "--ros-args", "--enclave", enclave]
    return subprocess.run(
        command, env=os.environ | security, capture_output=True, text=True, check=False
    )


@pytest.mark.parametrize("enclave", ["/known", "/nobody"])
def test_without_what_it_takes_it_is_refused(enclave: str, tmp_path: Path) -> None:
    done = run(tmp_path, "Enforce", enclave)
    assert done.returncode == 1, done.stderr
    assert "ticks" not in done.stdout
    last = done.stderr.splitlines()[-1]
    assert last.startswith("unicon: error: ")
