"""A process ends with its status though the middleware never does, holding Python's lock."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = [pytest.mark.ros, pytest.mark.timeout(120)]

STAND = "robot: go2\nplatform: fake\nrate: 50\npacing: {hang: 10}\nflow: {hold: {}}\n"

HANGS = """\
import ctypes, sys
from rclpy.node import Node
import unicon_ros.process_exit
unicon_ros.process_exit.exit_watchdog.__wrapped__.__defaults__ = (1.0,)  # its PATIENCE
Node.destroy_node = lambda node: ctypes.PyDLL(None).sleep(600)
"""


def ended(code: str, *arguments: str) -> int:
    command = [sys.executable, "-c", HANGS + code, *arguments]
    return subprocess.run(command, capture_output=True, timeout=60, check=False).returncode


def test_a_node_ends_with_the_status_of_a_fault(tmp_path: Path) -> None:
    pytest.importorskip("rclpy")
    (tmp_path / "stand.yaml").write_text(STAND)
    code = (
        "from unicon_base.errors import Fault\n"
        "from unicon_core.platforms.fake import FakePlatform\n"
        "from unicon_ros.node_main import main\n"
        "def silent(platform):\n"
        "    raise Fault('the robot is silent')\n"
        "FakePlatform.recv = silent\n"
        "sys.exit(main())\n"
    )
    given = [
        "--ros-args",
        "-p",
        f"workflow:={tmp_path / 'stand.yaml'}",
        "-p",
        "exit_on_fault:=true",
    ]
    assert ended(code, *given) == 3


def test_a_run_leaves_its_report_and_status(tmp_path: Path) -> None:
    pytest.importorskip("rclpy")
    (tmp_path / "stand.yaml").write_text(STAND)
    report = tmp_path / "report.json"
    code = "from unicon_ros.cli.main import main; sys.exit(main(sys.argv[1:]))"
    given = ["run", str(tmp_path / "stand.yaml"), "--ros", "--duration", "0.1"]
    assert ended(code, *given, "--report", str(report)) == 0
    assert report.exists()


def test_whoever_ends_in_time_is_left_alone() -> None:
    code = (
        "from unicon_ros.process_exit import exit_watchdog\n"
        "import time\n"
        "with exit_watchdog(7, 0.1): pass\n"
        "time.sleep(0.5); sys.exit(5)\n"
    )
    pytest.importorskip("rclpy")
    assert ended(code) == 5
