"""A RealSense for tests: librealsense's software device, plugged in while the file `serial` exists.

Its pictures at 30 Hz: colours are (n, n + 1, n + 2) modulo 200 for the n-th pair, depths the plane
1 m + n mm, with a measurement missing at the first pixel. A file `half` beside it holds colours
back, a file `old` makes stamps an hour old, `stop` holds all back.
"""

from __future__ import annotations

import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pyrealsense2 as rs

from unicon_ros.peripheral_process import Gone

WIDTH, HEIGHT, RATE = 640, 480, 30
UNITS = 0.001
BASELINE = 0.015  # m


class Soft(rs.software_device):
    """The camera; `is_connected` is what the kernel would tell librealsense."""

    def __init__(self, plug: Path) -> None:
        rs.software_device.__init__(self)
        self._plug = plug
        self.register_info(rs.camera_info.serial_number, plug.name)
        self.register_info(rs.camera_info.name, "software")
        depth, color = self.add_sensor("Stereo Module"), self.add_sensor("RGB Camera")
        depth.add_read_only_option(rs.option.depth_units, UNITS)
        kinds = (
            (depth, rs.stream.depth, 0, 2, rs.format.z16, 600.0),
            (color, rs.stream.color, 1, 3, rs.format.rgb8, 500.0),
        )
        profiles = [sensor.add_video_stream(stream(*rest)) for sensor, *rest in kinds]
        beside = rs.extrinsics()
        beside.rotation, beside.translation = [1, 0, 0, 0, 1, 0, 0, 0, 1], [-BASELINE, 0, 0]
        profiles[0].register_extrinsics_to(profiles[1], beside)
        back = rs.extrinsics()
        back.rotation, back.translation = [1, 0, 0, 0, 1, 0, 0, 0, 1], [BASELINE, 0, 0]
        profiles[1].register_extrinsics_to(profiles[0], back)
        self.create_matcher(rs.matchers.default)
        destroyed = plug.with_name("destroyed")
        self.set_destruction_callback(lambda: destroyed.write_text("yes"))
        pushing = (plug, (depth, color), profiles)
        threading.Thread(target=push, args=pushing, daemon=True).start()

    def is_connected(self) -> bool:
        return self._plug.exists()


def stream(kind: Any, uid: int, size: int, form: Any, focal: float) -> Any:
    made = rs.video_stream()
    made.type, made.index, made.uid = kind, 0, uid
    made.width, made.height, made.fps, made.bpp, made.fmt = WIDTH, HEIGHT, RATE, size, form
    lens = rs.intrinsics()
    lens.width, lens.height, lens.fx, lens.fy = WIDTH, HEIGHT, focal, focal
    lens.ppx, lens.ppy, lens.model, lens.coeffs = 319.5, 239.5, rs.distortion.none, [0.0] * 5
    made.intrinsics = lens
    return made


def push(plug: Path, sensors: tuple[Any, ...], profiles: list[Any]) -> None:
    number, begin = 0, time.monotonic()
    plane = np.empty((HEIGHT, WIDTH), np.uint16)
    colors = np.empty((HEIGHT, WIDTH, 3), np.uint8)
    while plug.exists():
        number += 1
        time.sleep(max(0.0, begin + number / RATE - time.monotonic()))
        if plug.with_name("stop").exists():
            continue
        plane[...] = 1000 + number
        plane[0, 0] = 0
        colors[...] = np.arange(number, number + 3) % 200
        stamp = time.time() - (3600.0 if plug.with_name("old").exists() else 0.0)
        for sensor, profile, pixels in zip(sensors, profiles, (plane, colors)):
            if pixels is colors and plug.with_name("half").exists():
                continue
            frame = rs.software_video_frame()
            frame.pixels, frame.bpp = pixels.copy().view(np.uint8), pixels[0, 0].nbytes
            frame.stride = WIDTH * frame.bpp
            frame.timestamp = 1000.0 * stamp
            frame.domain = rs.timestamp_domain.system_time
            frame.frame_number, frame.profile = number, profile.as_video_stream_profile()
            if pixels is plane:
                frame.depth_units = UNITS
            with suppress(RuntimeError):  # nobody streams
                sensor.on_video_frame(frame)


def device(_: Any, __: Any, serial: str) -> Soft:
    plug = Path(serial)
    if not plug.exists():
        raise Gone(f"no RealSense {plug.name} is connected")
    return Soft(plug)
