"""Process of a simulated camera: renders what the states say and publishes it; of `camera`.

Its own process, since a software renderer takes 80 ms for a small picture and a publisher holds
Python's lock while it copies a large message: neither must be felt by the tick. It draws the newest
pose of a ring: (stamp_ns, base position, base quaternion, joint positions).
"""

from __future__ import annotations

import os
import select
from pathlib import Path

import numpy as np

from unicon_base.arrays import Float32
from unicon_base.errors import ModelError
from unicon_core.handles import FrameRing
from unicon_core.models.camera import ModelCamera
from unicon_core.robots import load_files
from unicon_core.robots.robot import Place
from unicon_core.terrain.words import Terrain
from unicon_ros.bridge.camera_topics import CameraTopics
from unicon_ros.bridge.images import frame_message, info_message, rays
from unicon_ros.peripheral_process import SLICE, Feed, end, serve


class _Camera:
    """Draws one camera into a ring of messages."""

    def __init__(self, feed: Feed) -> None:
        if not os.environ.get("MUJOCO_GL") and not os.environ.get("DISPLAY"):
            os.environ["MUJOCO_GL"] = "egl"
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
        self._ring.commit(stamp_ns)
        if self._topics is not None:
            self._publish(slot.tobytes())

    def close(self) -> None:
        """Let the topics go; the renderer ends with the process."""
        if self._topics is not None:
            self._topics.close()


if __name__ == "__main__":
    end(serve(_Camera))
