"""Plain subscribers to what cameras publish."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent


@pytest.fixture
def viewer() -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Starts a plain subscriber."""
    started: list[subprocess.Popen[str]] = []

    def start(topic: str, kind: str, *qos: str) -> subprocess.Popen[str]:
        environment = dict(os.environ)
        for name in ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE"):
            environment[name] = str(ROOT / "config" / "dds" / "large_data.xml")
        peer = subprocess.Popen(
            [sys.executable, str(HERE / "plain_viewer.py"), topic, kind, *qos],
            env=environment,
            stdout=subprocess.PIPE,
            text=True,
        )
        started.append(peer)
        assert peer.stdout is not None
        assert json.loads(peer.stdout.readline())["ready"]
        return peer

    yield start
    for peer in started:
        peer.kill()
        peer.wait(10)
