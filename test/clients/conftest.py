"""What users of a workspace run beside us: `ros2` and `ros2 launch`, each robot in a domain."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")

from their_clients import CLI, LAUNCH, ROOT, Clients, find_clients, make_prefix

from unicon_ros.bench.report import free_domain

sys.path.insert(0, str(ROOT / "test" / "attack"))  # the robot that writes commands down


@pytest.fixture(autouse=True)
def domain(monkeypatch: pytest.MonkeyPatch) -> int:
    """A ROS domain of this test alone."""
    number = free_domain()
    monkeypatch.setenv("ROS_DOMAIN_ID", str(number))
    return number


@pytest.fixture(scope="session")
def prefix(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An ament prefix with this source tree as package unicon_ros."""
    return make_prefix(tmp_path_factory.mktemp("prefix") / "install")


@pytest.fixture(scope="session")
def ros2(tmp_path_factory: pytest.TempPathFactory, prefix: Path) -> Clients:
    """`ros2`: installed, from source, or calls that equal its own."""
    return find_clients(tmp_path_factory.mktemp("ros2cli"), prefix, CLI)


@pytest.fixture(scope="session")
def ros2_launch(tmp_path_factory: pytest.TempPathFactory, prefix: Path) -> Clients:
    """`ros2` with `launch`."""
    return find_clients(tmp_path_factory.mktemp("launch"), prefix, (*CLI, *LAUNCH))


@pytest.fixture
def started(tmp_path: Path) -> Iterator[Callable[..., Any]]:
    """Starts `ros2 …` in the background; kills its whole group at the end."""
    processes: list[subprocess.Popen[bytes]] = []

    def start(clients: Clients, *words: str) -> Any:
        output = tmp_path / f"output_{len(processes)}.txt"
        process = clients.start(*words, output=output)
        processes.append(process)
        process.said = lambda: output.read_text(errors="replace")  # type: ignore[attr-defined]
        return process

    yield start
    for process in processes:
        try:
            os.killpg(process.pid, signal.SIGKILL)
        except ProcessLookupError:
            continue
        process.wait(10)


@pytest.fixture
def eventually() -> Callable[..., Any]:
    """Waits until something is true."""

    def wait(condition: Callable[[], Any], what: Callable[[], str], timeout: float = 40.0) -> Any:
        end = time.monotonic() + timeout
        while not (value := condition()):
            assert time.monotonic() < end, what()
            time.sleep(0.1)
        return value

    return wait
