"""Our own nodes leave Fast DDS's shared memory alone, unless the user chose; peers hear them."""

from __future__ import annotations

import os
import socket
import struct
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from unicon_base.resources import find_config
from unicon_ros import compat
from unicon_ros.bridge import own_node as transport

JAZZY, KILTED = transport.PROFILES
FAST = str(find_config("dds", "fast_discovery", ".xml"))
LARGE = str(find_config("dds", "large_data", ".xml"))
LOOPBACK = str(find_config("dds", "no_shared_memory", ".xml"))
LOCALHOST = {transport.RANGE: "LOCALHOST"}
UDP = {transport.TRANSPORTS: "UDPv4"}
ON_LOOPBACK = {
    JAZZY: LOOPBACK,
    KILTED: None,
    transport.LOCALHOST_ONLY: None,
    transport.RANGE: "SUBNET",
}

pytestmark = [pytest.mark.ros, pytest.mark.timeout(120)]


@pytest.mark.parametrize(
    ("environment", "expected"),
    [
        ({}, UDP),
        ({transport.RANGE: "SUBNET"}, UDP),
        ({transport.RANGE: "SYSTEM_DEFAULT", "ROS_STATIC_PEERS": "192.0.2.7"}, UDP),
        ({transport.LOCALHOST_ONLY: "0"}, UDP),
        ({"ROS_DISCOVERY_SERVER": "192.0.2.7:11811"}, UDP),
        ({JAZZY: FAST}, UDP),
        (LOCALHOST, ON_LOOPBACK),
        ({transport.LOCALHOST_ONLY: "1"}, ON_LOOPBACK),
        ({**LOCALHOST, JAZZY: FAST, KILTED: FAST}, ON_LOOPBACK),
        ({**LOCALHOST, "ROS_STATIC_PEERS": "127.0.0.1;localhost"}, ON_LOOPBACK),
        ({**LOCALHOST, "ROS_DISCOVERY_SERVER": ";127.0.0.1:11811"}, ON_LOOPBACK),
        # There is no loopback profile where peers or the server are on other machines.
        ({**LOCALHOST, "ROS_STATIC_PEERS": "127.0.0.1;192.0.2.7"}, {}),
        ({**LOCALHOST, "ROS_DISCOVERY_SERVER": "192.0.2.7:11811"}, {}),
        ({**LOCALHOST, "ROS_DISCOVERY_SERVER": "localhost.example:11811"}, {}),
        ({transport.RANGE: "OFF"}, {}),
        # The user's choices.
        ({transport.TRANSPORTS: "DEFAULT"}, {}),
        ({**LOCALHOST, transport.TRANSPORTS: "DEFAULT"}, {}),
        ({JAZZY: LARGE}, {}),
        ({**LOCALHOST, JAZZY: FAST, KILTED: LARGE}, {}),
        ({KILTED: "absent.xml"}, {}),
        ({"FASTDDS_ENVIRONMENT_FILE": "servers.json"}, {}),
        ({"ROS2_EASY_MODE": "127.0.0.1"}, {}),
    ],
)
def test_what_the_environment_leads_to(
    environment: dict[str, str], expected: dict[str, str | None], tmp_path: Path
) -> None:
    assert transport.changes(environment, tmp_path, JAZZY, LOOPBACK, True) == expected


def test_a_profile_that_fast_dds_will_not_read_is_not_relied_on(tmp_path: Path) -> None:
    assert transport.changes(LOCALHOST, tmp_path, JAZZY, LOOPBACK, False) == {}
    assert transport.changes({}, tmp_path, JAZZY, LOOPBACK, False) == UDP


@pytest.mark.parametrize("name", transport.FILES)
def test_a_profile_in_the_working_folder_is_the_users_choice(name: str, tmp_path: Path) -> None:
    (tmp_path / name).touch()
    assert transport.changes({}, tmp_path, JAZZY, LOOPBACK, True) == {}
    assert transport.changes(LOCALHOST, tmp_path, JAZZY, LOOPBACK, True) == {}


@pytest.fixture
def untouched(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A user who has set nothing of Fast DDS, in a process where nobody has used rclpy."""
    compat.import_rclpy()
    for name in (*transport.PROFILES, transport.LOCALHOST_ONLY, *transport.CHOICES):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv(transport.RANGE, "LOCALHOST")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(transport, "_loaded", None)
    monkeypatch.setattr(compat, "imported_first", lambda: True)
    monkeypatch.setattr(compat, "fast_dds_profiles", lambda: JAZZY)


@pytest.mark.usefixtures("untouched")
def test_the_environment_is_another_one_only_while_a_node_is_made() -> None:
    before = dict(os.environ)
    with transport.without_shared_memory():
        assert os.environ[JAZZY] == LOOPBACK
        assert os.environ[transport.RANGE] == "SUBNET"
    assert dict(os.environ) == before
    with suppress(RuntimeError), transport.without_shared_memory():
        raise RuntimeError("a bad name")
    assert dict(os.environ) == before


@pytest.mark.usefixtures("untouched")
def test_the_first_profile_of_a_process_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(transport.RANGE, "SUBNET")
    with transport.without_shared_memory():
        assert os.environ[transport.TRANSPORTS] == "UDPv4"
    monkeypatch.setenv(transport.RANGE, "LOCALHOST")  # too late for the loopback profile
    before = dict(os.environ)
    with transport.without_shared_memory():
        assert dict(os.environ) == before


@pytest.mark.usefixtures("untouched")
def test_where_rclpy_was_there_before_nothing_is_widened(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compat, "imported_first", lambda: False)
    before = dict(os.environ)
    with transport.without_shared_memory():
        assert dict(os.environ) == before


@pytest.mark.usefixtures("untouched")
def test_other_middlewares_are_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compat, "fast_dds_profiles", lambda: None)
    before = dict(os.environ)
    with transport.without_shared_memory():
        assert dict(os.environ) == before


def test_the_variable_is_the_one_that_this_fast_dds_reads(monkeypatch: pytest.MonkeyPatch) -> None:
    rclpy = compat.import_rclpy()
    if not rclpy.utilities.get_rmw_implementation_identifier().startswith("rmw_fastrtps"):
        assert compat.fast_dds_profiles() is None
        return
    name = compat.fast_dds_profiles()
    assert name in transport.PROFILES
    other = "rmw_cyclonedds_cpp"
    monkeypatch.setattr(rclpy.utilities, "get_rmw_implementation_identifier", lambda: other)
    assert compat.fast_dds_profiles() is None


@pytest.mark.parametrize(
    ("command", "profile"), [("node", None), ("run", None), ("run", FAST)], ids=str
)
def test_ours_has_no_shared_memory_stays_on_loopback_and_talks_with_a_plain_peer(
    command: str,
    profile: str | None,
    nodes: Callable[..., Any],
    processes: Callable[..., Any],
    peers: Callable[..., Any],
    react: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    if not Path("/proc/self/maps").exists() or compat.fast_dds_profiles() is None:
        pytest.skip("tells the shared memory of Fast DDS from /proc")
    for name in transport.PROFILES:
        if profile is None:
            monkeypatch.delenv(name)
        else:
            monkeypatch.setenv(name, profile)
    if command == "node":
        ours = nodes("--ros-args", "-p", f"workflow:={react}")
    else:
        ours = processes(sys.executable, "-m", "unicon_ros", "run", str(react), "--ros", "--quiet")
    peer = peers("robot_watcher", "--command", "0.5", "0", "0")
    peer.wait_for(lambda: len(peer.of("joints")) > 5, "joint_states")
    rest = peer.of("joints")[0]["position"]
    peer.wait_for(lambda: peer.of("joints")[-1]["position"] != rest, "what the command does")
    assert _shared_memory(peer.process.pid)  # the peer's own: Fast DDS's default has it
    assert not _shared_memory(ours.process.pid)
    addresses = _udp_addresses(ours.process.pid)
    assert addresses
    assert {a for a in addresses if not a.startswith(("127.", "239."))} == set()


def _shared_memory(pid: int) -> set[str]:
    maps = Path(f"/proc/{pid}/maps").read_text(encoding="utf-8")
    return {line.split()[-1] for line in maps.splitlines() if "/dev/shm/fast" in line}


def _udp_addresses(pid: int) -> set[str]:
    """Return the local IPv4 addresses of a process's UDP sockets."""
    links = [os.readlink(link) for link in Path(f"/proc/{pid}/fd").iterdir()]
    own = {link[8:-1] for link in links if link.startswith("socket:[")}
    rows = [line.split() for line in Path("/proc/net/udp").read_text().splitlines()[1:]]
    return {
        socket.inet_ntoa(struct.pack("=I", int(row[1].split(":")[0], 16)))
        for row in rows
        if row[9] in own
    }
