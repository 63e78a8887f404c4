"""Slow ROS tests: soaks, kills and floods; each in a ROS domain of its own."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("psutil")

from unicon_ros.bench.report import free_domains

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent


@pytest.fixture
def start() -> Iterator[Callable[..., subprocess.Popen[bytes]]]:
    """Starts Python on a script of `processes/` or a module, in a domain; kills it at the end.

    Keywords are further environment variables.
    """
    started: list[subprocess.Popen[bytes]] = []

    def run(
        what: str, *arguments: Any, domain: int | None = None, **variables: str
    ) -> subprocess.Popen[bytes]:
        environment = dict(os.environ)
        if environment.pop("_ROS_WHEELS_BOOTSTRAP_COMPLETE", None) is not None:
            environment.pop("LD_LIBRARY_PATH", None)
        environment.setdefault("PYTHONPATH", str(ROOT))
        if domain is not None:
            environment["ROS_DOMAIN_ID"] = str(domain)
        environment |= variables
        script = HERE / "processes" / f"{what}.py"
        target = [str(script)] if script.exists() else ["-m", what]
        process = subprocess.Popen(
            [sys.executable, *target, *map(str, arguments)],
            env=environment,
            stdout=subprocess.DEVNULL,
        )
        started.append(process)
        return process

    yield run
    for process in started:
        if process.poll() is None:
            process.kill()
        process.wait(10)


@pytest.fixture
def domains() -> list[int]:
    """ROS domains of this test alone."""
    return free_domains(4)
