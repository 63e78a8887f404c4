"""What attacks through ROS share: peers of our own, runs in threads, a robot behind topics."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy")

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "ros"))

from peer import Peer, wait_for  # noqa: E402
from ros_helpers import Run  # noqa: E402

from unicon_core.robots import load_robot  # noqa: E402

__all__ = ["HERE", "REACT", "Peer", "Run", "behind_topics", "peer", "robot", "running", "wait_for"]

REACT = """\
schema: unicon.workflow/1
robot: go2
platform: fake
rate: 100
commands: [{velocity_command: {constant: [0.1, 0.0, 0.0]}}]
flow: {sway: {gains: {"*_hip_joint": [1.0, 0, 0]}, time_constant: 0.0}}
"""
"""Moves its hips as far as `cmd_vel` says, on the fake robot."""
MAKE = "unicon_ros.bridge.ros_platform:make"
BEHIND = """\
schema: unicon.workflow/1
robot: go2
platform: {make}
platforms: {{"{make}": {{connect: {connect}, map: {map}, damping: {damping}}}}}
rate: 100
pacing: {{hang: 5.0}}  # a busy machine may hold a process up
flow: {{hold: {{}}}}
safety: {safety}
"""


@contextmanager
def peer(script: str, *arguments: str) -> Iterator[Peer]:
    """A plain rclpy script of `peers/`, killed at the end."""
    process = Peer(sys.executable, str(HERE / "peers" / f"{script}.py"), *arguments)
    try:
        yield process
    finally:
        process.kill()


@contextmanager
def robot(lie: str, seconds: float) -> Iterator[Peer]:
    """A Go2 behind topics that tells the truth for so long from its first command on."""
    with peer("lying_robot", lie, str(seconds), *load_robot("go2").joint_names) as process:
        yield process


@contextmanager
def running(path: Path | str, **options: Any) -> Iterator[Run]:
    """A workflow with its bridge in a thread, ended at the end."""
    run = Run(path, **options).start()
    try:
        yield run
    finally:
        if run.alive:
            run.end()
        run.session.close()


def behind_topics(
    folder: Path,
    safety: str,
    map: str | Path = "ros_robot",
    connect: float = 10.0,
    damping: float = 0.1,
) -> Path:
    """Write a workflow of a robot behind topics that holds its pose; users damp it for 0.5 s."""
    path = folder / "behind_topics.yaml"
    path.write_text(
        BEHIND.format(
            make=MAKE,
            safety=f"{{only: [{safety}]}}" if safety else "none",
            map=map,
            connect=connect,
            damping=damping,
        )
    )
    return path
