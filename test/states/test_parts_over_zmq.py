"""Parts on two machines: the link is cut and comes back, strangers call, readers stop."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from zmq_peers import Link

from unicon_base.errors import PlatformError
from unicon_core.flow import compile_graph
from unicon_core.workflow.document import load_document
from unicon_core.workflow.program import Program

pytest.importorskip("zmq", reason="pyzmq is not installed: pip install 'unicon_ros[zmq]'")

WORKFLOW = """\
name: parts-{pid}
robot: {robot}
platform: fake
rate: 100
store: {{zmq: "tcp://127.0.0.1:{port}"}}
parts:
  robot: {{publishes: [joint_pos, stamp_ns, joint_pos_target], silent: {{after: 0.2}}}}
  desk: {{publishes: [velocity_command], silent: {{after: 0.3, then: hold}}}}
commands:
  - {{velocity_command: {{schedule: [[0.0, 0.7, 0.0, 0.0]]}}, on: desk}}
flow: hold
safety: [finite, joint_limits]
"""
PORTS = 4  # two groups for each part


def free_ports() -> int:
    """Return the first of some ports in a row that nobody has."""
    for first in range(20_000 + os.getpid() % 20_000, 64_000, PORTS):
        try:
            for port in range(first, first + PORTS):
                socket.create_server(("127.0.0.1", port)).close()
        except OSError:
            continue
        return first
    raise AssertionError("no free ports")


class Robot:
    """The robot's part in this process, ticked by `run`."""

    def __init__(self, path: Path) -> None:
        self.program = Program(load_document(path), part="robot")
        self.told: list[str] = []
        self.program.warn = self.told.append
        self._graph = compile_graph(self.program.root)

    @property
    def command(self) -> float:
        return float(self.program.states.velocity_command[0])

    def neutral(self) -> bool:
        return self.command == 0.0

    def run(self, seconds: float, until: Callable[[], bool] = bool) -> None:
        """Tick at 100 Hz; with `until` at most so long."""
        end = time.monotonic() + seconds
        while time.monotonic() < end and not until():
            self._graph.step()
            self._graph.deferred()
            time.sleep(0.01)
        assert until is bool or until(), self.told


def write(folder: Path, port: int, robot: str = "go2") -> Path:
    path = folder / "divided.yaml"
    path.write_text(WORKFLOW.format(pid=os.getpid(), port=port, robot=robot))
    return path


def desk(path: Path, *more: str) -> subprocess.Popen:
    command = [sys.executable, "-m", "unicon_ros", "run", str(path), "--part", "desk", "--no-ros"]
    pipe = subprocess.PIPE
    return subprocess.Popen([*command, *more], stdout=pipe, stderr=pipe, text=True)


@pytest.fixture
def port() -> int:
    return free_ports()


@pytest.fixture
def robot(tmp_path: Path, port: int) -> Iterator[Robot]:
    made = Robot(write(tmp_path, port))
    yield made
    made.program.close()


def test_a_cut_link_is_a_zero_command_and_no_fault(tmp_path, robot, port):
    away = port + 100
    links = [Link(port + k, away + k) for k in range(PORTS)]
    there = desk(tmp_path / "divided.yaml", "--set", f"store.zmq=tcp://127.0.0.1:{away}")
    try:
        robot.run(20.0, lambda: robot.command > 0.6)
        for link in links:
            link.cut()
        robot.run(5.0, robot.neutral)
        robot.run(1.0)
        assert robot.neutral()
        for link in links:
            link.mend()
        robot.run(10.0, lambda: robot.command > 0.6)
        assert robot.command == np.float32(0.7)
        assert there.poll() is None
        there.send_signal(signal.SIGSTOP)  # whoever stands still harms nobody
        robot.run(5.0, robot.neutral)
        there.send_signal(signal.SIGCONT)
        robot.run(10.0, lambda: robot.command > 0.6)
    finally:
        there.send_signal(signal.SIGCONT)
        there.send_signal(signal.SIGINT)
        _, error = there.communicate(timeout=30)
        for link in links:
            link.close()
    assert "Traceback" not in error
    assert "part 'robot' has been silent for 0.3 s: its states stay as they were" in error
    assert sum("is heard" in line for line in robot.told) == 3


def test_another_layout_is_refused_on_both_sides(tmp_path, robot, port):
    other = tmp_path / "other"
    other.mkdir()
    there = desk(write(other, port, "g1_29dof"))
    robot.run(20.0, lambda: there.poll() is not None)
    _, error = there.communicate()
    assert there.returncode == 1
    # Whichever group is heard first tells.
    assert re.search(r"state 'joint_pos(_target)?': shape is \[29\] here and \[12\] there", error)
    assert robot.command == 0.0


def test_a_killed_desk_changes_nothing_and_another_may_come(tmp_path, robot, port):
    path = tmp_path / "divided.yaml"
    first = desk(path)
    robot.run(20.0, lambda: robot.command > 0.6)
    first.kill()
    first.communicate()
    robot.run(5.0, robot.neutral)
    second = desk(path)
    robot.run(20.0, lambda: robot.command > 0.6)
    second.send_signal(signal.SIGINT)
    second.communicate(timeout=30)
    assert not [line for line in robot.told if "fault" in line]


def test_a_platform_that_fails_leaves_the_addresses_free(tmp_path, port, monkeypatch):
    def fails(*_, **__):
        raise PlatformError("no such robot")

    path = write(tmp_path, port)
    with monkeypatch.context() as patched:
        patched.setattr("unicon_core.platforms.fake.FakePlatform.__init__", fails)
        with pytest.raises(PlatformError, match="no such robot") as _held:  # with its frames
            Program(load_document(path), part="robot")
    Program(load_document(path), part="robot").close()
