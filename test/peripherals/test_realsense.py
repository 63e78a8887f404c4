"""RealSense: pairs of pictures at 30 Hz through librealsense's own pipeline, unplugged and back."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

pytest.importorskip(
    "pyrealsense2", reason="pip install 'unicon_ros[realsense]'; apt install libusb-1.0-0"
)

from unicon_base.errors import UniconError
from unicon_core.flow import Block
from unicon_core.robots import load_robot
from unicon_core.states import States
from unicon_core.workflow.autowire import BuildContext
from unicon_hardware.peripherals.realsense import _found, _quaternion, messages, realsense
from unicon_ros.peripheral import Peripheral

# What these tests run against, the most that config/evidence.yaml may say by them.
EVIDENCE = "vendor"

ROOT = Path(__file__).resolve().parent.parent.parent
LARGE = ROOT / "config" / "dds" / "large_data.xml"


class Rig:
    """A block and its states."""

    def __init__(self, plug: Path, name: str = "realsense", **options: Any) -> None:
        self.name, self.lines = name, list[str]()
        self.states = States(realsense.declares(robot=None, prefix=name, **options))  # type: ignore[attr-defined]
        context = BuildContext(self.states, load_robot("go2"), 0.002, tell=self.lines.append)
        device = {"serial": str(plug), "device": "soft_realsense:device"}
        self.block: Block = realsense(context=context, prefix=name, **device, **options)
        assert isinstance(self.block.tick, Peripheral)
        self.tick = self.block.tick
        aligned, cloud = options.get("aligned", False), options.get("cloud", False)
        size = {"size": [640, 480], "frame_prefix": "", "aligned": aligned, "cloud": cloud}
        self.messages = messages(name, size)

    def value(self, state: str) -> int:
        return int(self.states[f"{self.name}_{state}"])

    def values(self) -> list[int]:
        return [int(self.states[name]) for name in self.states.layout.specs]

    def until(self, holds: Callable[[], object], patience: float = 10.0) -> float:
        """Tick until something holds; return for how long, in [s]."""
        begin = time.monotonic()
        while not holds():
            assert time.monotonic() - begin < patience, (self.lines, self.values())
            self.block.tick()
            time.sleep(0.002)
        return time.monotonic() - begin

    def picture(self, ring: str) -> NDArray[Any]:
        raw = self.tick.rings[ring].frame(self.value(f"{ring}_handle"))
        assert raw is not None
        return self.messages[ring].data(raw.data).copy()

    def number(self) -> int:
        """Return the number of the pair, told by its depths."""
        return round(1000 * float(self.picture("depth")[5, 5])) - 1000


@pytest.fixture
def plug(tmp_path: Path) -> Path:
    (tmp_path / "123").touch()
    return tmp_path / "123"


@pytest.fixture
def rigs() -> Iterator[Callable[..., Rig]]:
    made: list[Rig] = []

    def start(*arguments: Any, **options: Any) -> Rig:
        made.append(Rig(*arguments, **options))
        return made[-1]

    yield start
    for rig in made:
        rig.tick.close()
        assert not [ring for ring in rig.tick.rings.values() if ring.path.exists()]


def test_pairs_come_at_30_hz_and_an_unplugged_camera_is_neutral_at_once_and_comes_back(
    rigs: Callable[..., Rig], plug: Path
) -> None:
    rig = rigs(plug)
    rig.until(lambda: rig.value("alive"))
    pairs: dict[int, int] = {}

    def look(until: float) -> bool:
        handle, other = rig.value("color_handle"), rig.value("depth_handle")
        if handle not in pairs:
            assert other == handle
            pairs[handle] = number = rig.number()
            expected = np.arange(number, number + 3) % 200
            assert rig.picture("color")[7, 9].tolist() == expected.tolist()
            assert np.isnan(rig.picture("depth")[0, 0])
            assert 0 <= time.monotonic_ns() - rig.value("stamp_ns") < 0.2e9
        return time.monotonic() > until

    end = time.monotonic() + 1.5
    rig.until(lambda: look(end))
    numbers = list(pairs.values())
    assert numbers == sorted(numbers)
    assert len(pairs) > 0.9 * (numbers[-1] - numbers[0] + 1)
    assert numbers[-1] - numbers[0] > 38

    plug.unlink()
    assert rig.until(lambda: not rig.value("alive"), 0.25) < 0.25  # before it is stale
    assert not any(rig.values())
    rig.until(lambda: plug.with_name("destroyed").exists())
    plug.touch()
    rig.until(lambda: rig.value("alive"))
    assert rig.value("color_handle") > max(pairs)
    rig.until(lambda: len(rig.lines) == 2)
    assert rig.lines == [
        "realsense: it was unplugged; its values are neutral until it is back",
        "realsense: it is there",
    ]


@pytest.mark.slow
def test_a_camera_that_gives_nothing_or_only_half_is_neutral(
    rigs: Callable[..., Rig], plug: Path
) -> None:
    rig = rigs(plug)
    rig.until(lambda: rig.value("alive"))
    for fault in ("half", "stop"):
        plug.with_name(fault).touch()
        rig.until(lambda: not rig.value("alive"), 1.5)
        assert not any(rig.values())
        rig.until(lambda: any("no pairs of pictures for 2 s" in line for line in rig.lines))
        plug.with_name(fault).unlink()
        rig.until(lambda: rig.value("alive"))
        rig.until(lambda: "realsense: it is there" in rig.lines)
        rig.lines.clear()


@pytest.mark.slow
def test_stamps_that_cannot_be_are_not_believed(rigs: Callable[..., Rig], plug: Path) -> None:
    plug.with_name("old").touch()
    rig = rigs(plug)
    rig.until(lambda: rig.value("alive"))
    assert 0 <= time.monotonic_ns() - rig.value("stamp_ns") < 1e9


@pytest.mark.slow
def test_aligned_depths_are_seen_from_the_colours_and_points_are_there(
    rigs: Callable[..., Rig], plug: Path
) -> None:
    rig = rigs(plug, aligned=True, cloud=True)
    rig.until(lambda: rig.value("alive"))
    depth, points = rig.picture("depth"), rig.picture("cloud")
    assert rig.messages["depth"].frame_id == "realsense_color_optical_frame"
    # The colour camera sees wider: the plane ends at the border of the depths, and beyond is none.
    focal, other = 500.0, 600.0
    half = 320 / other * focal  # of the plane, in pixels of the colours
    row = np.isfinite(depth[240])
    shift = -0.015 * focal / float(np.nanmax(depth))
    first, last = np.flatnonzero(row)[[0, -1]]
    assert first == pytest.approx(319.5 - half + shift, abs=2.5)
    assert last == pytest.approx(319.5 + half + shift, abs=2.5)
    z = depth[240, 400]
    expected = [(400 - 319.5) / focal * z, (240 - 239.5) / focal * z, z]
    np.testing.assert_allclose(points[240, 400], expected, rtol=1e-5)
    assert np.isnan(points[0, 0]).all()


@pytest.mark.slow
def test_two_at_once_and_the_process_of_one_is_killed_or_stopped(
    rigs: Callable[..., Rig], plug: Path
) -> None:
    other = plug.with_name("456")
    other.touch()
    one, two = rigs(plug, "left"), rigs(other, "right")
    one.until(lambda: one.value("alive"))
    two.until(lambda: two.value("alive"))
    os.kill(one.tick.process.pid, signal.SIGSTOP)
    assert one.until(lambda: not one.value("alive"), 1.0) < 0.6
    assert not any(one.values())
    two.until(lambda: two.value("color_handle") > 30)
    os.kill(one.tick.process.pid, signal.SIGCONT)
    one.until(lambda: one.value("alive"))
    os.kill(one.tick.process.pid, signal.SIGKILL)
    one.until(lambda: not one.value("alive"), 1.0)
    assert not any(one.values())
    one.until(lambda: one.value("alive"), 20.0)
    assert one.tick.started == 2
    assert "was killed by SIGKILL" in one.lines[0]


@pytest.mark.slow
def test_a_size_that_the_camera_has_not_is_one_line(plug: Path) -> None:
    with pytest.raises(
        UniconError, match="has no colours and depths of 320 x 240 at 30 Hz"
    ) as told:
        Rig(plug, width=320, height=240)
    assert "\n" not in str(told.value)


def test_no_camera_names_those_that_are_there() -> None:
    import pyrealsense2 as rs

    from unicon_ros.peripheral_process import Gone

    class Device:
        def get_info(self, _: Any) -> str:
            return "42"

    class Context:
        devices: tuple[Device, ...] = ()

        def query_devices(self) -> tuple[Device, ...]:
            return self.devices

    with pytest.raises(Gone, match=r"^no RealSense is connected$"):
        _found(rs, Context(), "")
    Context.devices = (Device(),)
    assert isinstance(_found(rs, Context(), "42"), Device)
    assert isinstance(_found(rs, Context(), ""), Device)
    with pytest.raises(Gone, match=r"^no RealSense 7 is connected; there is 42$"):
        _found(rs, Context(), "7")


def test_a_rotation_is_that_quaternion() -> None:
    from unicon_core.models.loaded import rotate

    half = np.radians(35) / 2
    axis = np.array((0.6, 0.0, -0.8))
    quat = np.array((np.cos(half), *(np.sin(half) * axis)))
    matrix = np.column_stack([rotate(quat, each) for each in np.eye(3)])
    np.testing.assert_allclose(_quaternion(matrix), quat, atol=1e-12)


@pytest.mark.slow
def test_a_default_subscriber_hears_both_topics(
    rigs: Callable[..., Rig], plug: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("rclpy")
    from unicon_ros.bench.report import free_domain

    monkeypatch.setenv("ROS_DOMAIN_ID", str(free_domain()))
    environment = dict(os.environ)
    for variable in ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE"):
        environment[variable] = str(LARGE)
    topics = {"color/image_raw": "Image", "depth/camera_info": "CameraInfo"}
    peers = []
    for topic, kind in topics.items():
        viewer = str(ROOT / "test" / "images" / "plain_viewer.py")
        command = [sys.executable, viewer, f"front/{topic}", kind]
        peers.append(subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True))
    try:
        for peer in peers:
            assert peer.stdout is not None
            assert json.loads(peer.stdout.readline())["ready"]
        rig = rigs(plug, topic="front", frame_prefix="r1/")
        rig.until(lambda: rig.value("alive"))
        end = time.monotonic() + 4.0
        rig.until(lambda: time.monotonic() > end)
    finally:
        for peer in peers:
            peer.kill()
    colors, infos = (
        [json.loads(line) for line in peer.stdout if line.endswith("}\n")]
        for peer in peers
        if peer.stdout
    )
    assert len(colors) > 60
    assert colors[-1]["frame"] == "r1/realsense_color_optical_frame"
    assert abs(colors[-1]["stamp"] - time.time_ns()) < 5e9
    assert len(infos) > 60
    assert infos[-1]["frame"] == "r1/realsense_depth_optical_frame"
    assert infos[-1]["k"] == [600.0, 0.0, 319.5, 0.0, 600.0, 239.5, 0.0, 0.0, 1.0]
    assert {each["stamp"] for each in colors} & {each["stamp"] for each in infos}
