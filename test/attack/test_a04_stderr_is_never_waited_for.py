"""What writes to standard error past our writer (Python, ROS's own log) holds no tick up either."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from runs import HERE, ROOT, Run

NOISY = """\
import warnings

from unicon_core.flow import Tick


def noisy() -> Tick:
    warnings.simplefilter("always")

    def step() -> None:
        warnings.warn("x" * 200, RuntimeWarning)

    return step
"""


@pytest.fixture
def full_pipe() -> Iterator[int]:
    """The writing end of a pipe that nobody reads, and that is full."""
    out, into = os.pipe()
    os.set_blocking(into, False)
    try:
        while True:
            os.write(into, b"x")
    except BlockingIOError:
        os.set_blocking(into, True)
    yield into
    os.close(into)
    os.close(out)


@pytest.mark.slow
def test_warnings_of_python_stop_no_commands(tmp_path: Path, full_pipe: int) -> None:
    (tmp_path / "wordy.py").write_text(NOISY)
    flow = "zip: [hold, {call: {function: 'wordy:noisy'}}]"
    run = Run(tmp_path, flow=flow)
    run.start(stderr=full_pipe, stdout=subprocess.DEVNULL)
    run.until_sent(30)
    run.process.send_signal(signal.SIGINT)
    assert run.process.wait(20) == 0
    assert run.closed


@pytest.mark.ros
@pytest.mark.timeout(120)
def test_the_log_of_ros_stops_no_commands(tmp_path: Path, full_pipe: int) -> None:
    rclpy = pytest.importorskip("rclpy")
    from lifecycle_msgs.srv import ChangeState

    from unicon_ros.bench.report import loopback_environment

    environment = loopback_environment()
    environment["PYTHONPATH"] = os.pathsep.join(map(str, (HERE, ROOT)))
    log = tmp_path / "commands.log"
    path = tmp_path / "recorded.yaml"
    path.write_text(
        "robot: go2\nplatform: estop_platform:make\nrate: 50\npacing: {hang: 10}\n"
        f'platforms: {{"estop_platform:make": {{log: {log}}}}}\nflow: {{hold: {{}}}}\n'
    )
    code = "import sys; from unicon_ros.node_main import main; sys.exit(main())"
    command = [sys.executable, "-c", code, "--ros-args", "-p", f"workflow:={path}"]
    process = subprocess.Popen(command, env=environment, stderr=full_pipe, stdout=full_pipe)

    def sent() -> int:
        return log.read_text().count("send") if log.exists() else 0

    def until_sent(count: int) -> None:
        end = time.monotonic() + 30.0
        while sent() < count:
            assert time.monotonic() < end, f"{sent()} of {count} commands"
            time.sleep(0.01)

    context = rclpy.context.Context()
    rclpy.init(context=context, domain_id=int(environment["ROS_DOMAIN_ID"]))
    node = rclpy.create_node("peer", context=context)
    try:
        until_sent(10)
        client = node.create_client(ChangeState, "/unicon/change_state")
        assert client.wait_for_service(20.0)
        request = ChangeState.Request()
        request.transition.id = 99  # rcl_lifecycle tells that it does not know it
        client.call_async(request)
        time.sleep(0.5)
        until_sent(sent() + 25)
        process.send_signal(signal.SIGTERM)
        assert process.wait(20) == 0
        assert "close" in log.read_text()
    finally:
        process.kill()
        process.wait()
        node.destroy_node()
        context.try_shutdown()


RELAYED = """\
import os, threading, time
from unicon_core.non_blocking_writer import relayed_stderr

with relayed_stderr():
    os.write(2, b"in time; ")
threading.Thread(target=lambda: (time.sleep(0.1), os.write(2, b"late; "))).start()
os.write(2, b"behind it; ")
"""


def test_what_is_written_behind_a_run_is_not_waited_for(full_pipe: int) -> None:
    process = subprocess.run([sys.executable, "-c", RELAYED], stderr=full_pipe, timeout=20)
    assert process.returncode == 0


def test_nothing_is_lost_where_somebody_reads() -> None:
    process = subprocess.run([sys.executable, "-c", RELAYED], stderr=subprocess.PIPE, timeout=20)
    assert process.stderr == b"in time; behind it; late; "
