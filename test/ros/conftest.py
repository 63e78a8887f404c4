"""ROS tests: a domain of its own for each test, plain peers as processes, workflows to run."""

from __future__ import annotations

import os
import random
import socket
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")

from ros_helpers import REACT, SWAY, Peer, Run

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent


def is_free(domain: int) -> bool:
    """Tell whether no participant of this machine is in a domain (RTPS 9.6.2: ports from it)."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(("", 7400 + 250 * domain + 10))
        except OSError:
            return False
    return True


@pytest.fixture(autouse=True)
def domain(monkeypatch: pytest.MonkeyPatch) -> int:
    """A ROS domain of this test alone: one whose first participant's port nobody has."""
    number = next(n for n in random.SystemRandom().sample(range(1, 102), 101) if is_free(n))
    monkeypatch.setenv("ROS_DOMAIN_ID", str(number))
    return number


@pytest.fixture
def peers() -> Iterator[Callable[..., Peer]]:
    """Starts plain rclpy scripts of `peers/`, and kills them at the end."""
    started: list[Peer] = []

    def start(script: str, *arguments: str, python: str = sys.executable) -> Peer:
        peer = Peer(python, str(HERE / "peers" / f"{script}.py"), *arguments)
        started.append(peer)
        return peer

    yield start
    for peer in started:
        peer.kill()


@pytest.fixture
def nodes() -> Iterator[Callable[..., Peer]]:
    """Starts unicon_node with ROS arguments, and kills it at the end."""
    started: list[Peer] = []
    code = "import sys; from unicon_ros.node_main import main; sys.exit(main())"

    def start(*arguments: str) -> Peer:
        os.environ.setdefault("PYTHONPATH", str(ROOT))
        peer = Peer(sys.executable, "-c", code, *arguments)
        started.append(peer)
        return peer

    yield start
    for peer in started:
        peer.kill()


@pytest.fixture
def sway(tmp_path: Path) -> Path:
    """A simulated Go2 that stands and leans forward as the velocity command says."""
    path = tmp_path / "sway.yaml"
    path.write_text(SWAY)
    return path


@pytest.fixture
def react(tmp_path: Path) -> Path:
    """A fake Go2 whose hip targets follow the velocity command at once."""
    path = tmp_path / "react.yaml"
    path.write_text(REACT)
    return path


@pytest.fixture
def runs() -> Iterator[Callable[..., Run]]:
    """Starts workflows with a bridge, and ends them."""
    started: list[Run] = []

    def start(*arguments: Any, **options: Any) -> Run:
        run = Run(*arguments, **options)
        started.append(run)
        return run.start()

    yield start
    for run in started:
        if run.alive:
            run.end()
        run.session.close()
