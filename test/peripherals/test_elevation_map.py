"""Block `elevation_map`: frames of a sensor become heights around the robot, or a fault."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from unicon_base.errors import Fault, UniconError
from unicon_core.flow import Block, Stage
from unicon_core.handles import FrameRing
from unicon_core.models.camera import Intrinsics
from unicon_core.platforms.kit.base import rotation
from unicon_core.policies import perception
from unicon_core.states import States, StateSpec, standard_states
from unicon_core.workflow.autowire import BuildContext
from unicon_ros import elevation_map as module
from unicon_ros.bridge.images import FrameMessage, cloud_message, frame_message, rays
from unicon_ros.elevation_map import OPTICAL, ElevationMap
from unicon_ros.peripheral import FrameSource

W, H = 40, 30
POSITION = np.array([0.3, 0.0, 0.1])
LOW = np.array([np.cos(0.25), 0.0, np.sin(0.25), 0.0])  # the base leans forward by half a radian


def ground(x: Any, y: Any) -> Any:
    return np.where(x > 1.2, 0.2, 0.0)


class Sensor:
    """A sensor whose frames a test makes."""

    outside = True

    def __init__(self, message: FrameMessage) -> None:
        self.ring = FrameRing.create(len(message.template))
        self.ring.touch(message.template)
        self.sources = {"eye": FrameSource(self.ring, message)}

    def __call__(self) -> None: ...


class Bench:
    """An elevation map with a base that is put where a test wants it."""

    dated = False
    """Stamps count from 1970, as a RealSense's, else from the machine's start, as a Livox's."""

    def __init__(self, message: FrameMessage, **options: Any) -> None:
        specs = standard_states(["j"]) | {"eye_handle": StateSpec((), "int64")}
        self.states = States(specs | ElevationMap.declares(size=options.get("size", 4.0)))
        self.sensor, self.message = Sensor(message), message
        sensor = Block("eye", self.sensor, writes=("eye_handle",), stage=Stage.RECV)
        context = BuildContext(self.states, None, 0.02, blocks=[sensor])  # type: ignore[arg-type]
        given = {"handle": "eye_handle", "position": tuple(POSITION), **options}
        self.block = ElevationMap(context, **given)
        self.place(0.0)

    def place(self, x: float, quat: Any = LOW) -> None:
        self.states["base_pos_w"][...] = x, 0.0, 0.4
        self.states["base_quat"][...] = quat

    def shoot(self, change: Callable[[np.ndarray], None] = lambda _: None) -> None:
        """Fill the next frame with what the sensor sees of the ground from the base's place."""
        turn = rotation(self.states["base_quat"])
        from_sensor = turn @ rotation(np.array(OPTICAL))
        origin = self.states["base_pos_w"] + turn @ POSITION
        focal = 0.5 * H / np.tan(np.radians(30.0))
        ways = rays(W, H, Intrinsics(focal, focal, (W - 1) / 2, (H - 1) / 2)).reshape(-1, 3)
        world = ways @ from_sensor.T
        depth = np.full(len(ways), np.nan)
        for along in np.arange(0.05, 4.0, 0.002)[::-1]:  # the nearest crossing is written last
            there = origin + along * world
            depth[there[:, 2] <= ground(there[:, 0], there[:, 1])] = along
        slot = self.sensor.ring.fill()
        data = self.message.data(slot)
        if data.dtype.names is not None:
            for k, axis in enumerate("xyz"):
                data[axis] = ways[:, k] * depth
        else:
            seen = depth if data.ndim == 2 else ways * depth[:, None]
            data[...] = seen.reshape(data.shape)
        change(data)
        stamp = module.time.time_ns() if self.dated else module.time.monotonic_ns()
        self.states["eye_handle"][...] = self.sensor.ring.commit(stamp)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[float]]:
    """Return the time of the block in [s], in a list."""
    now = [100.0]

    class Clock:
        monotonic = staticmethod(lambda: now[0])
        monotonic_ns = staticmethod(lambda: round(now[0] * 1e9))
        time_ns = staticmethod(lambda: 1_800_000_000_000_000_000 + round(now[0] * 1e9))

    for each in (module, perception):
        monkeypatch.setattr(each, "time", Clock)
    return iter([now])


POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4")])
MESSAGES = {
    "depth": frame_message("depth", W, H, "eye"),
    "cloud": frame_message("cloud", W, H, "eye"),
    "scanner": cloud_message(W * H, POINT, "eye"),
}


def matches(bench: Bench) -> bool:
    """Return whether all that was measured, off the riser by a cell, is the ground."""
    heights, valid = bench.states["height_map"], bench.states["height_map_valid"] == 1
    at = (np.arange(len(heights)) - (len(heights) - 1) / 2) * 0.05
    x = bench.states["height_map_centre"][0] + at
    off = (heights - ground(x, x))[valid & (np.abs(x - 1.2) > 0.06)]
    return off.size > 50 and bool(np.abs(off).max() < 0.01)


@pytest.mark.parametrize("dated", [True, False])
@pytest.mark.parametrize("kind", MESSAGES)
def test_a_frame_becomes_the_ground_around_the_robot(kind: str, dated: bool, clock: Any) -> None:
    bench, now = Bench(MESSAGES[kind], base_height=0.4), next(clock)
    bench.dated = dated
    for x in (0.0, 0.3):
        bench.place(x)
        now[0] += 0.02
        bench.block()
        bench.shoot()
        now[0] += 0.02
        bench.block()
        assert matches(bench)
    heights, middle = bench.states["height_map"], len(bench.states["height_map"]) // 2
    assert heights[middle, middle] == pytest.approx(0.0, abs=1e-6)  # under the body, not seen
    assert not bench.states["height_map_valid"][middle, middle]
    assert np.isfinite(heights).all()


def test_a_frame_is_placed_by_the_pose_of_its_time(clock: Any) -> None:
    bench, now = Bench(MESSAGES["cloud"]), next(clock)
    bench.block()
    bench.shoot()
    handle = int(bench.states["eye_handle"])
    bench.states["eye_handle"][...] = 0
    for _ in range(10):  # it comes 0.2 s late, and the robot has gone on
        now[0] += 0.02
        bench.place(1.0)
        bench.block()
    bench.states["eye_handle"][...] = handle
    bench.block()
    assert matches(bench)
    assert bench.states["height_map_centre"][0] == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize(
    "lost",
    ["frozen", "overwritten", "late", "unplugged", "pose"],
)
@pytest.mark.parametrize("then", ["fault", "last"])
def test_what_brings_no_frame_is_a_fault_or_the_last_map(lost: str, then: Any, clock: Any) -> None:
    bench, now = Bench(MESSAGES["depth"], stale=0.5, on_stale=then), next(clock)
    bench.block()
    bench.shoot()
    bench.block()
    before = bench.states["height_map"].copy()
    assert np.isfinite(before).all()

    def run() -> None:
        for _ in range(30):
            now[0] += 0.02
            if lost == "overwritten":  # the ring has gone round, the handle stays behind
                old = int(bench.states["eye_handle"])
                for _ in range(4):
                    bench.sensor.ring.fill()
                    bench.sensor.ring.commit(0)
                bench.states["eye_handle"][...] = old
            elif lost == "late":  # of a time of which no pose is kept
                bench.sensor.ring.fill()
                bench.states["eye_handle"][...] = bench.sensor.ring.commit(0)
            elif lost == "unplugged":
                bench.states["eye_handle"][...] = 0
            elif lost == "pose":
                bench.states["base_quat"][0] = np.nan
                bench.sensor.ring.fill()
                stamp = module.time.monotonic_ns()
                bench.states["eye_handle"][...] = bench.sensor.ring.commit(stamp)
            bench.block()

    if then == "fault":
        with pytest.raises(Fault, match="no frame of 'eye_handle' for"):
            run()
    else:
        run()
        assert np.array_equal(bench.states["height_map"], before)


def test_no_measurement_changes_nothing(clock: Any) -> None:
    bench = Bench(MESSAGES["depth"])
    bench.block()
    bench.shoot(lambda data: data.fill(np.nan))
    bench.block()
    assert not bench.states["height_map_valid"].any()
    assert np.isnan(bench.states["height_map"]).all()


def test_wrong_frames_and_handles_are_refused() -> None:
    with pytest.raises(UniconError, match="'eye_handle' has no depths; take a depth or a cloud"):
        Bench(frame_message("color", W, H, "eye"))
    with pytest.raises(UniconError, match=r"no block before it fills 'eye_hand'.*eye_handle"):
        Bench(MESSAGES["cloud"], handle="eye_hand")
    with pytest.raises(UniconError, match="size / resolution is 200, at most 128"):
        Bench(MESSAGES["cloud"], resolution=0.02)
    states = States(standard_states(["j"]), 2)
    with pytest.raises(UniconError, match="leave num_robots out"):
        ElevationMap(BuildContext(states, None, 0.02))  # type: ignore[arg-type]
