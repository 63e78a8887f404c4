"""Process of a simulated camera: renders what the states say and publishes it; started by `camera`.

Its own process, since a software renderer takes 80 ms for a small picture and a publisher holds
Python's lock while it copies a large message: neither must be felt by the tick. It reads records of
(stamp_ns, base position, base quaternion, joint positions) from stdin, always the latest, and ends
with its parent, when stdin does.
"""

from __future__ import annotations

import json
import os
import signal
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.errors import ModelError, UniconError
from unicon_core.handles import FrameRing
from unicon_core.models.camera import ModelCamera
from unicon_core.robots import load_files
from unicon_ros.bridge.camera_topics import CameraTopics
from unicon_ros.bridge.images import frame_message, rays

__all__ = ["main"]


def main() -> int:
    """Run; tells `{"ready": true}` or `{"error": …}` on stdout first."""
    # Ctrl-C goes to the whole group of processes: ours ends with the one that it serves.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    options = json.loads(sys.argv[1])
    if not os.environ.get("MUJOCO_GL") and not os.environ.get("DISPLAY"):
        os.environ["MUJOCO_GL"] = "egl"
    told = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # what libraries print is not for the parent
    try:
        camera = _Camera(options)
        shot = options, camera.message, camera.model
        publish = CameraTopics(*shot) if options["topic"] else _nowhere
    except UniconError as error:
        print(json.dumps({"error": str(error)}), file=told, flush=True)
        return 1
    print(json.dumps({"ready": True}), file=told, flush=True)
    told.close()
    size = 8 * (8 + len(options["joints"]))
    rest = b""
    while True:
        read = os.read(0, 1 << 16)
        if not read:
            return 0
        rest += read
        whole = len(rest) // size * size
        if whole:
            record = rest[whole - size : whole]
            rest = rest[whole:]
            publish(camera.shoot(record))


class _Camera:
    """Draws one camera into a ring of messages.

    Attributes:
        message: layout of a frame.
        model: what draws.
    """

    def __init__(self, options: dict[str, Any]) -> None:
        self._kind, self._far = options["kind"], float(options["far"])
        size = int(options["width"]), int(options["height"])
        self.message = frame_message(self._kind, *size, options["frame_id"])
        self.ring = FrameRing.attach(options["ring"])
        self.model = ModelCamera(
            Path(options["model"]),
            load_files(options["robot"]),
            options["camera"],
            size,
            body=options["body"],
            position=options["position"],
            fovy=options["fovy"],
            depth=self._kind != "color",
        )
        self._rays: NDArray[np.float32] | None = None
        if self._kind == "cloud":
            if not self.model.pinhole.fx:
                raise ModelError(f"camera: {options['camera']!r} has no perspective, so no cloud")
            self._rays = rays(*size, self.model.pinhole)
        for _ in range(self.ring.slots):
            slot = self.ring.fill()
            slot[:] = np.frombuffer(self.message.template, np.uint8)
            self.ring.commit(0)

    def shoot(self, record: bytes) -> bytes:
        """Draw a record's pose into the ring; return the message."""
        stamp_ns = int(np.frombuffer(record, np.int64, 1)[0])
        values = np.frombuffer(record, np.float64, offset=8)
        picture = self.model.shoot(values[7:], values[:7])
        slot = self.ring.fill()
        into = self.message.data(slot)
        if self._kind != "color":
            picture[picture > self._far] = np.nan
        if self._rays is None:
            into[...] = picture
        else:
            np.multiply(self._rays, picture[..., None], out=into)
        self.message.stamp(slot, stamp_ns)
        message = slot.tobytes()
        self.ring.commit(stamp_ns)
        return message


def _nowhere(message: bytes) -> None:
    """Publish nothing: the frames are for handles alone."""


if __name__ == "__main__":
    # No destructors: GL libraries print tracebacks when Python tears them down.
    status = main()
    sys.stderr.flush()
    os._exit(status)
