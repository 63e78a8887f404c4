"""Killed peers and discovery servers, floods of services, a hundred starts: the tick's p99 stays.

Peers have Fast DDS's defaults and ours have theirs: what users get who set nothing but loopback. A
second, quiet host runs the same workflow at the same time in a domain of its own, so that what else
the machine does falls on both.
"""

from __future__ import annotations

import json
import os
import shutil
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from windows import Windows, compare

ROUNDS = 5
WINDOW = 3.0  # s
BAR = 1.5
ABSENCE = 25.0  # s; the clients of a discovery server take it for alive for 20 s

ROS = Path(__file__).resolve().parent.parent / "ros"
WORKFLOW = """\
schema: unicon.workflow/1
robot: go2
platform: fake
rate: 200
commands: [{velocity_command: {constant: [0.1, 0.0, 0.0]}}]
flow: {sway: {gains: {"*_hip_joint": [1.0, 0, 0]}, time_constant: 0.0}}
safety: [finite, joint_limits]
"""
Start = Callable[..., subprocess.Popen[bytes]]

pytestmark = [pytest.mark.ros, pytest.mark.slow, pytest.mark.timeout(300)]


@pytest.fixture
def workflow(tmp_path: Path) -> Path:
    path = tmp_path / "steady.yaml"
    path.write_text(WORKFLOW)
    return path


@pytest.fixture(autouse=True)
def defaults(monkeypatch: pytest.MonkeyPatch, domains: list[int]) -> None:
    """No profile; peers that this process starts meet the host that is disturbed."""
    for name in ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("ROS_DOMAIN_ID", str(domains[0]))


class Hosts:
    """The host that is disturbed, with further environment variables, and the quiet one."""

    def __init__(
        self, start: Start, workflow: Path, folder: Path, domains: list[int], **variables: str
    ) -> None:
        self.files = [folder / "disturbed.npz", folder / "quiet.npz"]
        self.disturbed, self.quiet = (
            start("steady_host", workflow, file, domain=domain, **more)
            for file, domain, more in zip(self.files, domains, (variables, {}))
        )
        time.sleep(4.0)

    def end(self) -> None:
        for host in (self.disturbed, self.quiet):
            host.terminate()
            assert host.wait(20) == 0

    def compare(self, windows: Windows) -> dict[str, float]:
        facts = compare(*self.files, windows.spans)
        print(facts)
        return facts


@pytest.fixture
def hosts(start: Start, workflow: Path, tmp_path: Path, domains: list[int]) -> Hosts:
    """Two hosts."""
    return Hosts(start, workflow, tmp_path, domains)


class DiscoveryServer:
    """Fast DDS's discovery server on loopback; killed and started at will."""

    def __init__(self) -> None:
        beside = Path(sys.executable).parent / "fast-discovery-server"
        self.program = shutil.which("fast-discovery-server") or shutil.which(beside)
        if self.program is None:
            pytest.skip("no fast-discovery-server: it comes with Fast DDS")
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(("127.0.0.1", 0))
            self.port = probe.getsockname()[1]
        self.variables = {"ROS_DISCOVERY_SERVER": f"127.0.0.1:{self.port}"}
        self.start()

    def start(self) -> None:
        # Importing rclpy has told this process where the wheels' libraries are.
        self.process = subprocess.Popen(
            [str(self.program), "-i", "0", "-l", "127.0.0.1", "-p", str(self.port)],
            stdout=subprocess.DEVNULL,
        )
        time.sleep(1.0)
        assert self.process.poll() is None

    def kill(self) -> None:
        self.process.kill()
        self.process.wait(10)


@pytest.fixture
def server() -> Iterator[DiscoveryServer]:
    """A discovery server."""
    made = DiscoveryServer()
    yield made
    made.kill()


def plain(script: str, *arguments: str, **variables: str) -> subprocess.Popen[str]:
    """Start a plain rclpy peer of the ROS tests, with further environment variables."""
    return subprocess.Popen(
        [sys.executable, str(ROS / "peers" / f"{script}.py"), *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        env=os.environ | variables,
    )


def reads(peer: subprocess.Popen[str], word: str) -> None:
    """Read a peer's lines until one holds a word."""
    assert peer.stdout is not None
    for line in peer.stdout:
        if word in line:
            return
    raise AssertionError(f"the peer ended without {word!r}")


class Heard:
    """The joint positions that a watcher tells, always the latest."""

    def __init__(self, watcher: subprocess.Popen[str]) -> None:
        self.positions: list[float] = []
        self.count = 0
        threading.Thread(target=self._read, args=(watcher.stdout,), daemon=True).start()

    def _read(self, lines: Any) -> None:
        for line in lines:
            if '"joints"' in line:
                self.positions = json.loads(line)["position"]
                self.count += 1

    def goes_on(self, more: int = 20) -> None:
        """Wait for further messages, or fail."""
        until, late = self.count + more, time.monotonic() + 20.0
        while self.count < until:
            assert time.monotonic() < late, f"no joints any more after {self.count}"
            time.sleep(0.01)


def longest_publish(result: Any) -> float:
    """Return the longest that publishing took in a tick, in periods of the run."""
    publishing = [i for i, name in enumerate(result["names"]) if name.startswith("publish")]
    assert publishing
    ends = result["rows"][:, 4:]
    longest = max(int((ends[:, i] - ends[:, i - 1]).max()) for i in publishing)
    print(f"longest publish: {longest * 1e-6:.3f} ms")
    return float(longest / np.median(np.diff(result["start"])))


def test_peers_that_are_killed_do_not_delay_ticks(hosts: Hosts) -> None:
    windows = Windows()
    for _ in range(ROUNDS):
        peers = [plain("robot_watcher", "--command", "0.2", "0", "0") for _ in range(3)]
        for peer in peers:
            reads(peer, '"joints"')
            assert peer.stdout is not None
            threading.Thread(target=peer.stdout.read, daemon=True).start()
        time.sleep(2.0)  # they command from 1.5 s on
        with windows.disturb():
            for peer in peers:
                time.sleep(0.5)
                peer.kill()
            time.sleep(WINDOW - 1.5)
        for peer in peers:
            peer.wait(10)
    hosts.end()
    result = np.load(hosts.files[0])
    assert not result["faults"].size
    assert int(result["received"]) > 50
    # A blocked publisher takes 335 ms: 67 periods of this run.
    assert longest_publish(result) < 20
    facts = hosts.compare(windows)
    assert facts["tick_ratio"] < BAR, facts


def test_a_discovery_server_that_is_killed_does_not_delay_ticks(
    server: DiscoveryServer, start: Start, workflow: Path, tmp_path: Path, domains: list[int]
) -> None:
    hosts = Hosts(start, workflow, tmp_path, domains, **server.variables)
    peer = plain("robot_watcher", "--command", "0.2", "0", "0", **server.variables)
    windows = Windows()
    try:
        heard = Heard(peer)
        heard.goes_on()
        rest = heard.positions
        time.sleep(2.0)  # it commands from 1.5 s on
        commanded = heard.positions
        assert commanded != rest
        for _ in range(3):
            with windows.disturb():
                time.sleep(0.5)
                server.kill()
                time.sleep(WINDOW - 0.5)
            with windows.disturb():  # nobody answers the clients
                time.sleep(WINDOW)
            heard.goes_on()
            assert heard.positions == commanded  # a silent `cmd_vel` would be zero by now
            time.sleep(ABSENCE - 2 * WINDOW)
            server.start()
            late = plain("robot_watcher", **server.variables)
            try:
                Heard(late).goes_on(1)
            finally:
                late.kill()
                late.wait(10)
    finally:
        peer.kill()
        peer.wait(10)
    hosts.end()
    result = np.load(hosts.files[0])
    assert not result["faults"].size
    assert longest_publish(result) < 20
    facts = hosts.compare(windows)
    assert facts["tick_ratio"] < BAR, facts


def test_a_flood_of_services_does_not_delay_ticks_and_estop_gets_through(hosts: Hosts) -> None:
    windows = Windows()
    for number in range(ROUNDS):
        flood = plain("caller", "steady", "wait=0.5", f"flood=start,{WINDOW + 1.5}")
        time.sleep(2.0)  # its own start takes CPU, which is not the flood
        with windows.disturb():
            time.sleep(WINDOW - 1.0)
        if number == ROUNDS - 1:
            assert plain("caller", "steady", "estop").wait(30) == 0
            assert hosts.disturbed.wait(20) == 0
        flood.wait(30)
    hosts.quiet.terminate()
    assert hosts.quiet.wait(20) == 0
    result = np.load(hosts.files[0])
    assert list(result["faults"]) == ["emergency stop by the service ~/estop"]
    assert int(result["served"]) > 100
    facts = hosts.compare(windows)
    assert facts["tick_ratio"] < BAR, facts


def test_after_a_hundred_starts_and_stops_ticks_are_as_they_were(
    start: Start, workflow: Path, tmp_path: Path, domains: list[int]
) -> None:
    files = [tmp_path / "many.npz", tmp_path / "quiet.npz"]
    quiet = start("steady_host", workflow, files[1], domain=domains[1])
    many = start("many_starts", workflow, files[0], 100, domain=domains[0])
    assert many.wait(250) == 0
    quiet.terminate()
    assert quiet.wait(20) == 0
    result = np.load(files[0])
    assert int(result["starts"]) == 100 + 2 * ROUNDS
    spans = [(int(begin), int(end)) for begin, end in result["windows"]]
    before = compare(*files, spans[:ROUNDS])
    after = compare(*files, spans[-ROUNDS:])
    print(before, after)
    assert after["tick_ratio"] < BAR, (before, after)
    # Threads, files and memory of a run go with it.
    assert int(result["threads_after"]) <= int(result["threads_before"])
    assert int(result["files_after"]) <= int(result["files_before"]) + 2
    assert int(result["rss_after"]) - int(result["rss_before"]) < 20_000_000
