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

from unicon_core.errors import ModelError, UniconError, alternatives
from unicon_core.handles import FrameRing
from unicon_core.robots import load_robot
from unicon_ros.bridge.camera_model import intrinsics, optical_frame
from unicon_ros.bridge.camera_topics import CameraTopics
from unicon_ros.bridge.images import frame_message, rays

__all__ = ["main"]

NO_GL = (
    "camera: no offscreen OpenGL ({reason}); on Debian and Ubuntu: apt install libegl1 "
    "libgl1-mesa-dri, or libosmesa6 with MUJOCO_GL=osmesa"
)


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
        publish = CameraTopics(options, camera) if options["topic"] else _nowhere
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
    """Renders one camera into a ring of messages.

    Attributes:
        message: layout of a frame.
        pinhole: what the pictures are taken with.
        mount: parent frame of the optical frame, position [m] and quaternion wxyz, or None.
    """

    def __init__(self, options: dict[str, Any]) -> None:
        try:
            import mujoco
        except Exception as error:  # without a GL library already the import fails
            raise UniconError(NO_GL.format(reason=_one_line(error))) from error
        self._mujoco = mujoco
        self._kind, self._far = options["kind"], float(options["far"])
        width, height = int(options["width"]), int(options["height"])
        self.message = frame_message(self._kind, width, height, options["frame_id"])
        self.ring = FrameRing.attach(options["ring"])
        model = self._model = _model(mujoco, options, width, height)
        self._data = mujoco.MjData(model)
        self._camera = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, options["camera"])
        joints = [
            mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name) for name in options["joints"]
        ]
        if min(joints) < 0:
            missing = options["joints"][joints.index(-1)]
            raise ModelError(f"camera: the model has no joint {missing!r}")
        self._index = np.array([model.jnt_qposadr[joint] for joint in joints])
        free = np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE)
        self._base = int(model.jnt_qposadr[free[0]]) if free.size else -1
        try:
            self._renderer = mujoco.Renderer(model, height, width)
        except Exception as error:  # GL libraries raise classes of their own
            raise UniconError(NO_GL.format(reason=_one_line(error))) from error
        if self._kind != "color":
            self._renderer.enable_depth_rendering()
        self.pinhole = intrinsics(model, self._camera, width, height)
        self._rays: NDArray[np.float32] | None = None
        if self._kind == "cloud":
            if not self.pinhole.fx:
                raise ModelError(f"camera: {options['camera']!r} has no perspective, so no cloud")
            self._rays = rays(width, height, self.pinhole)
        self.mount = optical_frame(mujoco, model, load_robot(options["robot"]), self._camera)
        for _ in range(self.ring.slots):
            slot = self.ring.fill()
            slot[:] = np.frombuffer(self.message.template, np.uint8)
            self.ring.commit(0)

    def shoot(self, record: bytes) -> bytes:
        """Render a record's pose into the ring; return the message."""
        mujoco, model, data = self._mujoco, self._model, self._data
        stamp_ns = int(np.frombuffer(record, np.int64, 1)[0])
        values = np.frombuffer(record, np.float64, offset=8)
        data.qpos[self._index] = values[7:]
        if self._base >= 0:
            data.qpos[self._base : self._base + 7] = values[:7]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_camlight(model, data)
        self._renderer.update_scene(data, self._camera)
        slot = self.ring.fill()
        into = self.message.data(slot)
        if self._kind == "color":
            self._renderer.render(out=into)
        else:
            self._depth(self._renderer.render(), into)
        self.message.stamp(slot, stamp_ns)
        message = slot.tobytes()
        self.ring.commit(stamp_ns)
        return message

    def _depth(self, depth: NDArray[np.float32], into: NDArray[np.float32]) -> None:
        depth[depth > self._far] = np.nan
        if self._rays is None:
            into[...] = depth
        else:
            np.multiply(self._rays, depth[..., None], out=into)


def _model(mujoco: Any, options: dict[str, Any], width: int, height: int) -> Any:
    path = Path(options["model"])
    try:
        spec = mujoco.MjSpec.from_file(str(path))
    except ValueError as error:
        raise ModelError(f"camera: {path}: {_one_line(error)}") from error
    vis = spec.visual.global_
    vis.offwidth, vis.offheight = max(width, vis.offwidth), max(height, vis.offheight)
    if options["body"] is not None:
        body = spec.body(options["body"])
        if body is None:
            known = [each.name for each in spec.bodies if each.name]
            raise ModelError(
                f"camera: no body {options['body']!r} in {path}; "
                f"{alternatives(options['body'], known)}"
            )
        # MuJoCo's cameras look along -z with y up; this one along the body's x with z up.
        body.add_camera(
            name=options["camera"],
            pos=options["position"],
            quat=[0.5, 0.5, -0.5, -0.5],
            fovy=options["fovy"],
        )
    elif options["camera"] not in [each.name for each in spec.cameras]:
        known = [each.name for each in spec.cameras]
        raise ModelError(
            f"camera: no camera {options['camera']!r} in {path}; "
            f"{alternatives(options['camera'], known)}; or mount one: body: NAME, position: [m]"
        )
    return spec.compile()


def _nowhere(message: bytes) -> None:
    """Publish nothing: the frames are for handles alone."""


def _one_line(error: BaseException) -> str:
    text = " ".join(str(error).split())
    return text or type(error).__name__


if __name__ == "__main__":
    # No destructors: GL libraries print tracebacks when Python tears them down.
    status = main()
    sys.stderr.flush()
    os._exit(status)
