"""Camera: a block that has a camera of the robot's model drawn and published by another process.

    deferred:
      - call:
          function: unicon_ros.bridge.camera:camera
          body: base_link             # mounted on a body, or `camera: NAME` of the model
          position: [0.3, 0.0, 0.05]  # in the body's frame; looks along its x, z is up
          rate: 10
          topic: camera/image_raw

The picture is of the pose that the states tell, so it works beside any platform that has a model
file, or whose robot has one, and that tells where the base of a walking robot is. The tick only
hands over the pose (some µs at `rate`) and takes a handle: the state `camera_handle` numbers the
newest frame in `Camera.ring`, and `Camera.frame(handle)` is that frame in place. It is a peripheral
(`unicon_ros.peripheral`): `camera_alive` and `camera_stamp_ns` go with the handle, and all
three are 0 while its process is silent or gone.

Beside pictures and depths goes `camera_info`, and /tf_static tells the optical frame.
"""

from __future__ import annotations

import select
import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from unicon_base import AnyDict, ModelError, UniconError
from unicon_base.arrays import Array, Float32
from unicon_base.schema.marks import positive
from unicon_core.handles import FrameRing
from unicon_core.models.camera import ModelCamera
from unicon_core.models.find import find_model, model_of, terrain_of
from unicon_core.robots import Robot, load_files, robot_files
from unicon_core.robots.robot import Place
from unicon_core.states import StateSpec
from unicon_core.states.groups import subset
from unicon_core.terrain.words import Terrain
from unicon_core.workflow.autowire import BuildContext
from unicon_ros.bridge.bindings import checked_prefix
from unicon_ros.bridge.images import (
    CameraTopics,
    Reliability,
    frame_message,
    info_message,
    large_data,
    rays,
    topic_options,
)
from unicon_ros.peripheral import Count, Peripheral, Stale, peripheral_states
from unicon_ros.peripheral_process import SLICE, Feed, end, serve

PROCESS = "unicon_ros.bridge.camera"

STALE = 2.0
"""So long a camera may be silent by itself, in [s]: a software renderer takes its time."""


class Camera:
    """The block; make it with `camera`.

    Attributes:
        peripheral: its process.
        outside: what it tells comes from its process, so that no replay computes it.
        ring: the frames, each a whole message.
        message: layout of a frame.
        sources: as of `Peripheral`.
    """

    name = "camera"
    reads: tuple[str, ...] = ("joint_pos", "base_pos_w", "base_quat", "stamp_ns")
    endless = True
    outside = True

    def __init__(
        self, context: BuildContext, name: str, every: int, stale: float, options: AnyDict
    ) -> None:
        states, robot = context.states, context.robot
        if not robot.floats:  # its base stands where the model has it
            self.reads = ("joint_pos", "stamp_ns")
        kind, size = options["kind"], (options["width"], options["height"])
        self.message = frame_message(kind, *size, options["frame_id"])
        self._states, self._every, self._wait = states, every, 0
        self._record = np.zeros(8 + len(robot.joint_names))
        self._stamp = self._record.view(np.int64)[:1]
        self._bytes = self._record.view(np.uint8)
        self._poses = FrameRing.create(self._record.nbytes)
        data = {"poses": str(self._poses.path)}
        self.writes = tuple(_states(name))
        try:
            self.peripheral = Peripheral(
                states,
                subset(states.layout, self.writes),
                PROCESS,
                {"name": name, "options": options, "data": data},
                {"": self.message},
                stale,
                context.period,
                context.tell,
                large_data(),
            )
        except BaseException:
            self._poses.close()
            raise
        self.ring, self.sources = self.peripheral.rings[""], self.peripheral.sources

    def __call__(self) -> None:
        """Take the newest handle, and hand over the pose when it is due."""
        self.peripheral()
        if self._wait:
            self._wait -= 1
            return
        self._wait = self._every - 1
        states, record = self._states, self._record
        record[1:4] = states["base_pos_w"]
        record[4:8] = states["base_quat"]
        record[8:] = states["joint_pos"]
        self._stamp[0] = states["stamp_ns"]
        self._poses.fill()[:] = self._bytes
        self._poses.commit(time.monotonic_ns())
        self.peripheral.wish("draw")

    def frame(self, handle: int) -> Array | None:
        """Return a frame in place, shape `message.shape`; None when it was overwritten."""
        raw = self.ring.frame(handle)
        if raw is None:
            return None
        view = self.message.data(raw.data)
        view.flags.writeable = False
        return view

    def close(self) -> None:
        """End the process and let the frames go; safe to call twice."""
        self.peripheral.close()
        self._poses.close()


def camera(
    context: BuildContext,
    *,
    kind: str = "color",
    camera: str | None = None,
    body: str | None = None,
    position: Sequence[float] = (0.0, 0.0, 0.0),
    fovy: Annotated[float, positive(unit="°")] = 60.0,
    model: str | None = None,
    width: Count = 320,
    height: Count = 240,
    far: float = 20.0,
    rate: Annotated[float, positive(unit="Hz")] = 10.0,
    topic: str = "camera/image_raw",
    frame_id: str = "",
    frame_prefix: str = "",
    handle: str = "camera_handle",
    stale: Stale = STALE,
    reliability: Reliability = "reliable",
    node: str = "camera",
    namespace: str | None = None,
    ros_args: Sequence[str] = (),
) -> Camera:
    """Build a camera.

    Args:
        context: says states, robot, platform and period.
        kind: `color`, `depth` or `cloud`.
        camera: name of a camera of the model.
        body: body to mount a camera on, in place of `camera`.
        position: of that camera in the body's frame, [m]; it looks along x, z is up.
        fovy: its vertical field of view, [deg].
        model: MJCF or URDF, as of `find_model`; the platform's if None, else the robot's.
        width: of the picture, [pixels].
        height: of the picture, [pixels].
        far: depth beyond which there is no measurement (NaN), [m].
        rate: pictures per second, at most.
        topic: name; `camera_info` stands beside it; empty to publish nothing, for handles alone.
        frame_id: optical frame of the header; made of the camera's name if empty.
        frame_prefix: stands before the names of its frames; that of the robot's node.
        handle: state that takes the handle, NAME_handle; NAME_alive and NAME_stamp_ns go with it.
        stale: so long its process may be silent before all three are 0, in [s].
        reliability: of the topic: `reliable`, which all subscribers get, or `best_effort`.
        node: name of the process's node.
        namespace: of that node.
        ros_args: ROS arguments of that node, such as remaps.

    Raises:
        UniconError: an option is wrong, there is no offscreen OpenGL, or no such camera or body.
        MissingDependencyError: rclpy is not installed.
    """
    states, robot, platform = context.states, context.robot, context.platform
    if states.num_robots is not None:
        raise UniconError("camera: one robot is rendered; leave num_robots out")
    if (camera is None) == (body is None):
        raise UniconError("camera: give either camera: NAME of the model, or body: NAME to mount")
    if (own := handle.removesuffix("_handle")) in ("", handle):
        raise UniconError(f"camera: handle {handle!r}; give NAME_handle, such as front_handle")
    path = find_model(model, context.relative_to) if model else model_of(platform, robot)
    terrain = terrain_of(platform)
    name = camera or f"{body}_camera"
    options = {
        "kind": kind,
        "camera": name,
        "body": body,
        "position": [float(x) for x in position],
        "fovy": float(fovy),
        "robot": {member: str(path) for member, path in robot_files(robot).items()},
        "mounts": {name: asdict(mount) for name, mount in robot.mounts.items()},
        "model": str(path),
        "terrain": None if terrain is None else asdict(terrain),
        "width": int(width),
        "height": int(height),
        "far": float(far),
        "topic": topic,
        "frame_id": checked_prefix(frame_prefix) + (frame_id or f"{name}_optical_frame"),
        "frame_prefix": frame_prefix,
        "ros": topic_options(node, namespace, ros_args, reliability),
    }
    every = max(1, round(1.0 / (rate * context.period)))
    return Camera(context, own, every, stale, options)


def _states(name: str) -> dict[str, StateSpec]:
    return peripheral_states(name, {}, [""])


def _declares(robot: Robot, handle: str = "camera_handle", **_: Any) -> dict[str, StateSpec]:
    return _states(str(handle).removesuffix("_handle"))


camera.declares = _declares  # type: ignore[attr-defined]


class _Camera:
    """Draws one camera into a ring of messages."""

    def __init__(self, feed: Feed) -> None:
        options = feed.options
        self._feed, self._kind, self._far = feed, options["kind"], float(options["far"])
        size = int(options["width"]), int(options["height"])
        self._message = frame_message(self._kind, *size, options["frame_id"])
        self._ring, self._poses = feed.rings[""], FrameRing.attach(feed.data["poses"])
        model = self._model = ModelCamera(
            Path(options["model"]),
            load_files(options["robot"], {k: Place(**v) for k, v in options["mounts"].items()}),
            options["camera"],
            size,
            terrain=None if options["terrain"] is None else Terrain(**options["terrain"]),
            body=options["body"],
            position=options["position"],
            fovy=options["fovy"],
            depth=self._kind != "color",
        )
        self._rays: Float32 | None = None
        if self._kind == "cloud":
            if not model.pinhole.fx:
                raise ModelError(f"camera: {options['camera']!r} has no perspective, so no cloud")
            self._rays = rays(*size, model.pinhole)
        if not self._ring.latest:  # else it holds frames of a process that has died
            self._ring.touch(self._message.template)
        self._seen = self._stamp_ns = 0
        self._topics: CameraTopics | None = None
        if options["topic"]:
            self._topics = CameraTopics(options["ros"], feed.tell)
            info = None
            if self._kind != "cloud":
                info = info_message(*size, options["frame_id"], model.pinhole)
            self._publish = self._topics.add(options["topic"], self._message.type, info)
            if model.mount is not None:
                parent, at, quat = model.mount
                parent = options["frame_prefix"] + parent
                self._topics.tell_frame(options["frame_id"], parent, at, quat)

    def poll(self) -> None:
        """Wait for a pose, and draw it; tell meanwhile that we are there."""
        self._feed.wishes.clear()  # they only wake us
        if self._poses.latest == self._seen:
            select.select([0], [], [], SLICE)
        handle = self._poses.latest
        pose = None if handle == self._seen else self._poses.frame(handle)
        if pose is not None:
            record, stamp_ns = pose.tobytes(), self._poses.stamp_ns(handle)
            if self._poses.holds(handle):
                self._seen, self._stamp_ns = handle, stamp_ns
                self._shoot(record)
        if self._stamp_ns:
            self._feed.publish(self._stamp_ns)
        if self._topics is not None:
            self._topics.look()

    def _shoot(self, record: bytes) -> None:
        """Draw a pose into the ring, and publish it."""
        stamp_ns = int(np.frombuffer(record, np.int64, 1)[0])
        values = np.frombuffer(record, np.float64, offset=8)
        picture = self._model.shoot(values[7:], values[:7])
        slot = self._ring.fill()
        into = self._message.data(slot)
        if self._kind != "color":
            picture[picture > self._far] = np.nan
        if self._rays is None:
            into[...] = picture
        else:
            np.multiply(self._rays, picture[..., None], out=into)
        self._message.stamp(slot, stamp_ns)
        self._ring.set_offset(self._stamp_ns - stamp_ns)
        self._ring.commit(stamp_ns)
        if self._topics is not None:
            self._publish(slot.tobytes())

    def close(self) -> None:
        """Let the topics go; the renderer ends with the process."""
        if self._topics is not None:
            self._topics.close()


if __name__ == "__main__":
    end(serve(_Camera))
