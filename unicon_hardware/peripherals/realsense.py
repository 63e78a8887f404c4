"""RealSense: colours and depths of one camera, in pairs, by handles and as topics.

    commands:
      - realsense: {serial: "123456789012", aligned: true, topic: front}

`realsense_color_handle` and `realsense_depth_handle` number frames of one moment; each frame is a
whole sensor_msgs/Image. Depths are 32FC1 in [m] with NaN where nothing was measured (REP-118), as
the simulated camera's are: who reads one reads the other. The camera's own uint16 count units of
its own (1 mm by default, 0.1 mm of a D405), so millimetres in 16UC1 would lose what it measures.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pkgutil import resolve_name
from typing import Any

import numpy as np

from unicon_base import AnyDict, MissingDependencyError, UniconError, one_line
from unicon_base.arrays import Array, Float32, Float64, UInt8
from unicon_core.flow import Block
from unicon_core.models.camera import Intrinsics
from unicon_core.states import StateSpec
from unicon_core.workflow.autowire import BuildContext
from unicon_ros.bridge.bindings import checked_prefix
from unicon_ros.bridge.images import (
    CameraTopics,
    FrameMessage,
    Reliability,
    frame_message,
    info_message,
    large_data,
    rays,
    topic_options,
)
from unicon_ros.peripheral import Count, Stale, peripheral_block, peripheral_states
from unicon_ros.peripheral_process import SLICE, Feed, Gone, end, serve

PROCESS = "unicon_hardware.peripherals.realsense"


def realsense(
    *,
    context: BuildContext,
    prefix: str = "realsense",
    serial: str = "",
    width: Count = 640,
    height: Count = 480,
    rate: Count = 30,
    aligned: bool = False,
    cloud: bool = False,
    topic: str = "",
    frame_prefix: str = "",
    stale: Stale = 0.3,
    reliability: Reliability = "reliable",
    node: str = "",
    namespace: str | None = None,
    ros_args: Sequence[str] = (),
    device: str | None = None,
) -> Block:
    """Take pictures of a RealSense camera; handles are 0 while it is not there.

    Args:
        context: of the workflow.
        prefix: stands before the names of its states, its frames and its node.
        serial: number of the camera; empty for the first that is found.
        width: of both pictures, [pixels].
        height: of both pictures, [pixels].
        rate: pairs per second, one that the camera has.
        aligned: depths as the colour camera sees them, pixel by pixel.
        cloud: points too, x, y, z in [m] in the frame of the depths.
        topic: stands before the names of its topics; empty to publish nothing, for handles alone.
        frame_prefix: stands before the names of its frames; that of the robot's node.
        stale: so long no pair may come, in [s].
        reliability: of the topics: `reliable`, which all subscribers get, or `best_effort`.
        node: name of the process's node; the peripheral's if empty.
        namespace: of that node.
        ros_args: ROS arguments of that node, such as remaps.
        device: `module:function` that finds the camera in place of us, for tests.

    Raises:
        UniconError: an option is wrong, or the camera has no such pictures.
        MissingDependencyError: pyrealsense2 is not installed, or rclpy where there is a topic.
    """
    name = prefix
    options = {
        "serial": str(serial),
        "size": [int(width), int(height)],
        "rate": int(rate),
        "aligned": bool(aligned),
        "cloud": bool(cloud),
        "topic": topic,
        "frame_prefix": checked_prefix(frame_prefix),
        "ros": topic_options(node or name, namespace, ros_args, reliability),
        "device": device,
    }
    return peripheral_block(
        context,
        name,
        PROCESS,
        options,
        values=(),
        frames=messages(name, options),
        stale=stale,
        environment=large_data(),
    )


def messages(name: str, options: AnyDict) -> dict[str, FrameMessage]:
    """Return the layout of the frames in each ring.

    Args:
        name: of the peripheral.
        options: of it, as its process gets them.
    """
    (width, height), before = options["size"], options["frame_prefix"] + name
    depth = "color" if options["aligned"] else "depth"
    frames = {"color": "color", "depth": depth, **({"cloud": depth} if options["cloud"] else {})}
    return {
        ring: frame_message(ring, width, height, f"{before}_{seen_by}_optical_frame")
        for ring, seen_by in frames.items()
    }


def _declares(*, prefix: str = "realsense", cloud: bool = False, **_: Any) -> dict[str, StateSpec]:
    return peripheral_states(prefix, {}, ("color", "depth", *(("cloud",) if cloud else ())))


realsense.declares = _declares  # type: ignore[attr-defined]


SILENCE = 2.0
"""A camera that gives nothing for so long is opened anew, in [s]."""

CLOCKS_APART = 1.0
"""A stamp of the camera that is further from our clock is not believed, in [s]."""


class _RealSense:
    """One camera, streaming."""

    def __init__(self, feed: Feed) -> None:
        rs = self._rs = _library()
        options = feed.options
        self._feed, self._messages = feed, messages(feed.name, options)
        find = _found if options["device"] is None else resolve_name(options["device"])
        self._context = rs.context()
        self._device = find(rs, self._context, options["serial"])
        (width, height), rate = options["size"], options["rate"]
        self._pipeline, config = rs.pipeline(self._context), rs.config()
        config.enable_stream(rs.stream.color, width, height, rs.format.rgb8, rate)
        config.enable_stream(rs.stream.depth, width, height, rs.format.z16, rate)
        self._pipeline.set_device(self._device)
        if not config.can_resolve(self._pipeline):
            if not self._device.is_connected():
                raise Gone("it was unplugged while it was opened")
            raise UniconError(
                f"{feed.name}: the camera has no colours and depths of {width} x {height} at "
                f"{rate} Hz; give width, height and rate of a mode of both (rs-enumerate-devices)"
            )
        try:
            profile = self._pipeline.start(config)
        except RuntimeError as error:  # another process has it
            raise Gone(f"it cannot be opened ({one_line(error)})") from error
        self._align = rs.align(rs.stream.color) if options["aligned"] else None
        depth_of = rs.stream.color if options["aligned"] else rs.stream.depth
        color = profile.get_stream(rs.stream.color).as_video_stream_profile()
        depth = profile.get_stream(depth_of).as_video_stream_profile()
        self._rays: Float32 | None = None
        if options["cloud"]:
            self._rays = rays(width, height, _pinhole(depth.intrinsics))
        for ring, message in self._messages.items():
            if not feed.rings[ring].latest:  # else it holds frames of a process that has died
                feed.rings[ring].touch(message.template)
        self._heard, self._told, self._taken = time.monotonic(), False, (-1, -1)
        self._topics: CameraTopics | None = None
        self._publish: dict[str, Callable[[bytes], None]] = {}
        if options["topic"]:
            self._open_topics(options, color, depth)

    def _open_topics(self, options: AnyDict, color: Any, depth: Any) -> None:
        feed = self._feed
        self._topics = CameraTopics(options["ros"], feed.tell)
        over = "aligned_depth_to_color" if options["aligned"] else "depth"
        names = {
            "color": "color/image_raw",
            "depth": f"{over}/image_raw",
            "cloud": f"{over}/points",
        }
        for ring, message in self._messages.items():
            info = None
            if ring != "cloud":
                seen = (color if ring == "color" else depth).intrinsics
                coefficients = self._coefficients(ring, seen)
                width, height = options["size"]
                info = info_message(width, height, message.frame_id, _pinhole(seen), coefficients)
            topic = f"{options['topic']}/{names[ring]}"
            self._publish[ring] = self._topics.add(topic, message.type, info)
        if not options["aligned"]:
            turned = color.get_extrinsics_to(depth)  # column-major; points of colours to depths
            quat = _quaternion(np.reshape(turned.rotation, (3, 3)).T)
            frame, parent = (self._messages[ring].frame_id for ring in ("color", "depth"))
            self._topics.tell_frame(frame, parent, np.array(turned.translation), quat)

    def _coefficients(self, ring: str, seen: Any) -> tuple[float, ...]:
        """Return k1, k2, p1, p2, k3 of `plumb_bob`; zeros where the model is another one."""
        values = tuple(float(value) for value in seen.coeffs)
        models = self._rs.distortion
        if any(values) and seen.model not in (models.brown_conrady, models.none):
            name = str(seen.model).rpartition(".")[2]
            self._feed.tell(f"{self._feed.name}: {ring} is distorted by {name}, camera_info has 0")
            return (0.0,) * 5
        return values

    def poll(self) -> None:
        """Take a pair, if one comes."""
        try:
            came, pair = self._pipeline.try_wait_for_frames(round(1000 * SLICE))
        except RuntimeError as error:
            raise Gone(f"it failed ({one_line(error)})") from error
        now = time.monotonic()
        if not came and not self._device.is_connected():
            raise Gone("it was unplugged")
        if came and self._is_new(pair):
            self._heard = now
            self._take(pair if self._align is None else self._align.process(pair))
        elif now - self._heard > SILENCE:
            raise Gone(f"it gave no pairs of pictures for {SILENCE:g} s")
        if self._topics is not None:
            self._topics.look()

    def _is_new(self, pair: Any) -> bool:
        """Tell whether both pictures are new: librealsense repeats one where the other is alone."""
        color, depth = pair.get_color_frame(), pair.get_depth_frame()
        if not color or not depth:
            return False
        numbers = color.get_frame_number(), depth.get_frame_number()
        if any(number == taken for number, taken in zip(numbers, self._taken)):
            return False
        self._taken = numbers
        return True

    def _take(self, pair: Any) -> None:
        color, depth = pair.get_color_frame(), pair.get_depth_frame()
        pictures = {"color": np.asarray(color.get_data()), "depth": np.asarray(depth.get_data())}
        for ring, picture in pictures.items():
            if picture.shape != self._messages[ring].shape:
                if not self._told:
                    self._told = True
                    what = f"{ring} of shape {picture.shape}, not {self._messages[ring].shape}"
                    self._feed.tell(f"{self._feed.name}: the camera gives {what}; left out")
                return
        wall_ns = self._stamp_ns(depth)
        old_ns = time.time_ns() - wall_ns
        filled = {}
        for ring, message in self._messages.items():
            slot = filled[ring] = self._feed.rings[ring].fill()
            message.stamp(slot, wall_ns)
        self._data("color", filled)[...] = pictures["color"]
        metres = self._data("depth", filled)
        np.multiply(pictures["depth"], np.float32(depth.get_units()), out=metres)
        metres[pictures["depth"] == 0] = np.nan
        if self._rays is not None:
            np.multiply(self._rays, metres[..., None], out=self._data("cloud", filled))
        for ring in filled:
            self._feed.rings[ring].commit(wall_ns)
        self._feed.publish(time.monotonic_ns() - old_ns)
        for ring, publish in self._publish.items():
            publish(filled[ring].tobytes())

    def _data(self, ring: str, filled: dict[str, UInt8]) -> Array:
        message = self._messages[ring]
        return message.data(filled[ring])

    def _stamp_ns(self, frame: Any) -> int:
        """Return when a frame was taken, [ns] of the system's clock; now, if it does not tell."""
        now, domain = time.time_ns(), self._rs.timestamp_domain
        if frame.frame_timestamp_domain in (domain.global_time, domain.system_time):
            told: int = round(frame.get_timestamp() * 1e6)
            if 0 <= now - told < CLOCKS_APART * 1e9:
                return told
        return now

    def close(self) -> None:
        """Stop it, and let its topics go."""
        if self._topics is not None:
            self._topics.close()
        self._pipeline.stop()


def _library() -> Any:
    try:
        import pyrealsense2
    except ImportError as error:
        install = "pip install 'unicon_ros[realsense]'"
        if "libusb" in str(error):
            install = "apt install libusb-1.0-0"
        raise MissingDependencyError("realsense", "pyrealsense2", install) from error
    return pyrealsense2


def _found(rs: Any, context: Any, serial: str) -> Any:
    """Return the camera of a serial number, or the first.

    Raises:
        Gone: it is not connected.
    """
    known = []
    for device in context.query_devices():
        known.append(device.get_info(rs.camera_info.serial_number))
        if serial in ("", known[-1]):
            return device
    there = f"; there is {', '.join(known)}" if known else ""
    raise Gone(f"no RealSense{f' {serial}' if serial else ''} is connected{there}")


def _pinhole(seen: Any) -> Intrinsics:
    return Intrinsics(seen.fx, seen.fy, seen.ppx, seen.ppy)


def _quaternion(matrix: Float64) -> Float64:
    """Return the quaternion wxyz, w >= 0, of a rotation of less than half a turn."""
    w = 0.5 * np.sqrt(max(1.0 + np.trace(matrix), 1e-12))
    xyz = (matrix - matrix.T)[[2, 0, 1], [1, 2, 0]] / (4.0 * w)
    quat = np.array((w, *xyz))
    quat /= np.linalg.norm(quat)
    return quat


if __name__ == "__main__":
    end(serve(_RealSense))
