"""A Mid-360 that is byte-exact: its clouds and IMU come, it is pulled out, and it comes back."""

from __future__ import annotations

import os
import re
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import mid360_peer
import numpy as np
import pytest
import yaml

from unicon_base.errors import UniconError, WorkflowError
from unicon_core.handles import FrameRing
from unicon_core.robots import load_robot
from unicon_core.states import States
from unicon_core.workflow.autowire import BuildContext, read_options
from unicon_hardware.peripherals.livox.cloud import livox_message
from unicon_hardware.peripherals.livox.livox import livox
from unicon_ros.peripheral import Peripheral

# What these tests run against, the most that config/evidence.yaml may say by them.
EVIDENCE = "stand_in"

# Of this process alone: tests run side by side.
HERE = f"127.84.{os.getpid() >> 8 & 0xFF}.{os.getpid() & 0xFE | 1}"
THERE = HERE.replace("127.84", "127.85")


def wrong(text: str, *_: str) -> WorkflowError:
    return WorkflowError(f"livox{text}")


class Rig:
    """The block with its states, and what it tells."""

    def __init__(self, **options: Any) -> None:
        self.states, self.lines = States(livox.declares()), list[str]()  # type: ignore[attr-defined]
        context = BuildContext(self.states, load_robot("go2"), 0.005, tell=self.lines.append)
        options = {"lidar": THERE, "host": HERE} | options
        self.block = livox(context, **read_options(livox, options, wrong))

    @property
    def ring(self) -> FrameRing:
        assert isinstance(self.block.tick, Peripheral)
        return self.block.tick.rings["cloud"]

    @property
    def alive(self) -> bool:
        return bool(self.states["livox_alive"])

    def until(self, holds: Callable[[], bool], patience: float = 5.0) -> float:
        """Tick until something holds; return for how long, in [s]."""
        begin = time.monotonic()
        while not holds():
            assert time.monotonic() - begin < patience, self.lines
            self.block.tick()
            time.sleep(0.002)
        return time.monotonic() - begin

    def streaming(self, peer: mid360_peer.Mid360, holds: Callable[[], bool]) -> None:
        """Let the peer send at its rate until something holds."""

        def ticked() -> bool:
            self.block.tick()
            return holds()

        peer.stream(5.0, until=ticked)
        assert holds(), self.lines


@pytest.fixture
def peer() -> Iterator[mid360_peer.Mid360]:
    made = mid360_peer.Mid360(THERE)
    yield made
    made.close()


@pytest.fixture
def rig() -> Iterator[Rig]:
    made = Rig()
    yield made
    assert made.block.close is not None
    made.block.close()


def test_clouds_and_imu_come_and_go(rig: Rig, peer: mid360_peer.Mid360) -> None:
    states = rig.states
    rig.until(lambda: bool(rig.lines))
    assert "does not answer at port 56100; it is used once it is there" in rig.lines[0]
    rig.until(lambda: peer.wants(0x0006) is not None)
    assert peer.wants(0x0006) == (HERE, 56301)
    assert peer.wants(0x0007) == (HERE, 56401)
    assert peer.keys[0x0000] == b"\1"
    rig.streaming(peer, lambda: int(states["livox_cloud_handle"]) >= 2 and rig.alive)
    np.testing.assert_allclose(states["livox_ang_vel"], [0.1, -0.2, 0.3], rtol=1e-6)
    np.testing.assert_allclose(states["livox_lin_acc"], [0, 4.903325, 9.80665], rtol=1e-6)
    assert (int(states["livox_lost"]), int(states["livox_refused"])) == (0, 0)
    handle = int(states["livox_cloud_handle"])
    age = time.monotonic_ns() - rig.ring.stamp_ns(handle)
    assert 0.09e9 < age < 0.6e9
    frame = rig.ring.frame(handle)
    assert frame is not None
    points = livox_message("livox_frame").data(frame.data)
    assert np.isfinite(points["x"]).sum() in (208 * 96, 209 * 96)
    assert points["x"][5] == np.float32(1.005)
    # It is pulled out: neutral within 0.2 s of the last datagram, give or take a busy machine.
    assert rig.until(lambda: not rig.alive) < 0.6
    assert not states["livox_lin_acc"].any()
    assert int(states["livox_cloud_handle"]) == 0
    rig.until(lambda: "sends no points any more" in rig.lines[-1])
    rig.streaming(peer, lambda: rig.alive and int(states["livox_cloud_handle"]) > handle)


def test_what_is_refused_is_counted_and_changes_nothing(rig: Rig, peer: mid360_peer.Mid360) -> None:
    rig.until(lambda: peer.wants(0x0006) is not None)
    rig.streaming(peer, lambda: rig.alive)
    peer.count, stamp = 0, int(1e15)  # its clock is set
    good = mid360_peer.datagram(1, bytes(1344), 96, 0, stamp)
    bad = [
        good[:-1],
        bytes(1380),
        os.urandom(1380),
        good[:40] + b"x" + good[41:],
        mid360_peer.datagram(2, bytes(768), 96, 1, stamp)[:700],
        bytes(9000),
    ]
    foreign = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    foreign.bind((HERE.replace("127.84", "127.86"), 56300))
    with foreign:
        for number in range(20):  # keeps it alive
            peer.send(mid360_peer.datagram(1, bytes(1344), 96, number, stamp + 480_000 * number))
            if number < len(bad):
                peer.send(bad[number])
                foreign.sendto(good, (HERE, 56301))
            time.sleep(0.02)
            rig.block.tick()
    late = mid360_peer.datagram(1, bytes(1344), 96, 30, stamp)
    still = mid360_peer.datagram(0, struct.pack("<6f", *[float("nan")] * 6), 1, 0, stamp)
    peer.send(late)
    before = rig.states["livox_ang_vel"].copy()
    peer.send(still)
    rig.until(lambda: int(rig.states["livox_refused"]) >= 2 * len(bad) + 2, 0.5)
    assert int(rig.states["livox_refused"]) == 2 * len(bad) + 2
    assert int(rig.states["livox_lost"]) == 0
    np.testing.assert_array_equal(rig.states["livox_ang_vel"], before)
    rig.until(lambda: sum("was refused" in line for line in rig.lines) >= 5)
    told = "\n".join(rig.lines)
    for why in ("foreign sender", "wrong length", "wrong checksum", "late", "not finite"):
        assert f"refused: {why}; all such are counted" in told, told
    assert "checksum: false takes them" in told
    assert "was set" in told


@pytest.mark.slow
def test_a_scanner_that_refuses_or_does_not_turn_is_named(
    rig: Rig, peer: mid360_peer.Mid360
) -> None:
    peer.state = 6
    rig.until(lambda: peer.asked >= 2)
    rig.until(lambda: bool(rig.lines))
    assert "livox" in rig.lines[0]
    assert not rig.alive
    assert rig.block.close is not None
    rig.block.close()
    second = Rig()
    second.until(lambda: bool(second.lines))
    assert "sends no points to port 56301; its state: motor starting" in second.lines[0]
    assert second.block.close is not None
    second.block.close()
    peer.code = 0x20
    third = Rig()
    third.until(lambda: bool(third.lines))
    assert "refuses its configuration: parameter not supported (0x20, key 0x001a)" in third.lines[0]
    assert third.block.close is not None
    third.block.close()
    fourth = Rig(host="192.0.2.84")  # of no interface of ours: its cable is out
    fourth.until(lambda: bool(fourth.lines))
    assert f"no way to {THERE} from 192.0.2.84: Cannot assign" in fourth.lines[0]
    assert fourth.block.close is not None
    fourth.block.close()


@pytest.mark.slow
def test_a_port_that_is_taken_is_an_error() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind((HERE, 56301))
        with pytest.raises(UniconError, match=f"another program listens at {HERE}:56301"):
            Rig()


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ({"lidar": "scanner"}, "lidar is 'scanner'; give an IPv4 address"),
        ({"host": "::1"}, "host is '::1'; give an IPv4 address"),
        ({"point_port": 80}, "point_port is 80; write a whole number from 1024 to 65535"),
        ({"imu_port": 56301}, "are 56301; give two ports"),
        ({"data_type": 4}, "data_type is 4; write 1 or 2 or 3"),
        ({"silence": float("nan")}, "silence is nan; write a number from 0.05 to 10"),
    ],
)
def test_wrong_options_are_named(options: dict[str, Any], why: str) -> None:
    with pytest.raises(WorkflowError, match=why):
        Rig(**options)


def test_the_document_names_options_that_there_are() -> None:
    text = (Path(__file__).parents[2] / "docs" / "reference" / "peripherals.md").read_text(
        encoding="utf-8"
    )
    examples = [yaml.safe_load(block) for block in re.findall(r"```yaml\n(.*?)```", text, re.S)]
    found = [x["livox"] for one in examples for x in one.get("commands", ()) if "livox" in x]
    states = States(livox.declares())  # type: ignore[attr-defined]
    for options in found:
        block = livox(BuildContext(states, load_robot("go2"), 0.005, dry=True), **options)
        assert block.writes == tuple(livox.declares())  # type: ignore[attr-defined]
    assert found
    for name in livox.declares():  # type: ignore[attr-defined]
        assert f"`{name}`" in text, name


@pytest.mark.slow
def test_clouds_are_published_for_a_default_subscriber(peer: mid360_peer.Mid360) -> None:
    rclpy = pytest.importorskip("rclpy")
    from sensor_msgs.msg import PointCloud2

    rig = Rig(topic="livox/points", node=f"scanner_{os.getpid()}")
    context = rclpy.context.Context()
    rclpy.init(context=context)
    node = rclpy.create_node(f"viewer_{os.getpid()}", context=context)
    executor = rclpy.executors.SingleThreadedExecutor(context=context)
    executor.add_node(node)
    heard = list[Any]()
    try:
        node.create_subscription(PointCloud2, "livox/points", heard.append, 10)
        rig.until(lambda: peer.wants(0x0006) is not None)

        def looked() -> bool:
            rig.block.tick()
            executor.spin_once(timeout_sec=0.0)
            return len(heard) >= 3

        peer.stream(20.0, until=looked)
        assert len(heard) >= 3, rig.lines
        cloud = heard[-1]
        assert (cloud.header.frame_id, cloud.height) == ("livox_frame", 1)
        points = np.frombuffer(bytes(cloud.data), livox_message("livox_frame").dtype)
        assert np.isfinite(points["x"]).sum() in (208 * 96, 209 * 96)
        assert abs(time.time() - cloud.header.stamp.sec) < 10.0
    finally:
        assert rig.block.close is not None
        rig.block.close()
        executor.shutdown()
        node.destroy_node()
        rclpy.try_shutdown(context=context)


@pytest.mark.slow
@pytest.mark.timeout(120)
def test_a_minute_at_the_real_rate_loses_nothing() -> None:
    seconds = 60.0
    program = Path(__file__).with_name("mid360_peer.py")
    peer = subprocess.Popen(
        [sys.executable, str(program), THERE, str(seconds)], stdout=subprocess.PIPE, text=True
    )
    rig = Rig(silence=1.0)
    assert isinstance(rig.block.tick, Peripheral)
    pid = rig.block.tick.process.pid
    try:
        rig.until(lambda: rig.alive)
        busy, handles, points = _busy(pid), list[int](), 0
        message, worst = livox_message("livox_frame"), 0.0
        begin = time.monotonic()
        while rig.alive:
            rig.block.tick()
            handle = int(rig.states["livox_cloud_handle"])
            if handle and (not handles or handle > handles[-1]):
                handles.append(handle)
                worst = max(worst, 1e-9 * (time.monotonic_ns() - rig.ring.stamp_ns(handle)))
                frame = rig.ring.frame(handle)
                assert frame is not None
                points += int(np.isfinite(message.data(frame.data)["x"]).sum())
            if rig.alive:
                lost = int(rig.states["livox_lost"]), int(rig.states["livox_refused"])
            time.sleep(0.005)
            assert time.monotonic() - begin < seconds + 30.0
        share = (_busy(pid) - busy) / seconds
        sent = int(peer.communicate(timeout=10.0)[0].split()[0])
    finally:
        peer.kill()
        peer.wait()
        assert rig.block.close is not None
        rig.block.close()
    print(f"{sent} datagrams, {len(handles)} clouds, {share:.1%} of a core, oldest {worst:.3f} s")
    assert sent > 2083 * seconds - 10
    assert lost == (0, 0)
    assert handles == list(range(1, len(handles) + 1))
    assert abs(points - 96 * sent) <= 96 * 212  # the last cloud ends with the scanner
    assert share < 0.15  # 0.09 measured


def _busy(pid: int) -> float:
    """Return for how long a process has had a core, in [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
