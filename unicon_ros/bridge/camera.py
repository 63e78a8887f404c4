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
newest frame in `Camera.ring`, and `Camera.frame(handle)` is that frame in place.

Beside pictures and depths goes `camera_info`, and /tf_static tells the optical frame.
"""

from __future__ import annotations

import json
import os
import select
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unicon_core.errors import UniconError, alternatives
from unicon_core.handles import FrameRing
from unicon_core.models.find import find_model, model_of
from unicon_core.resources import find_config, same_modules
from unicon_core.robots import Robot, robot_files
from unicon_core.states import States, StateSpec
from unicon_core.workflow.autowire import BuildContext
from unicon_ros.bridge.bindings import checked_prefix
from unicon_ros.bridge.images import frame_message
from unicon_ros.transport import PROFILES

__all__ = ["Camera", "camera"]

START = 60.0  # s for the process to be ready: a software renderer compiles shaders


class Camera:
    """The block; make it with `camera`.

    Attributes:
        ring: the frames, each a whole message.
        message: layout of a frame.
        handle: the state with the newest frame's number.
    """

    name = "camera"
    reads: tuple[str, ...] = ("joint_pos", "base_pos_w", "base_quat", "stamp_ns")
    endless = True

    def __init__(
        self,
        states: States,
        robot: Robot,
        every: int,
        handle: NDArray[np.int64],
        options: dict[str, Any],
    ) -> None:
        if not robot.floats:  # its base stands where the model has it
            self.reads = ("joint_pos", "stamp_ns")
        kind, size = options["kind"], (options["width"], options["height"])
        self.message = frame_message(kind, *size, options["frame_id"])
        self.ring = FrameRing.create(len(self.message.template))
        self.handle = handle
        self.dropped = 0
        self._head = self.ring._head
        self._first = self.ring.slots  # the process fills the templates in first
        self._states, self._every, self._wait = states, every, 0
        self._record = np.zeros(8 + len(robot.joint_names))
        self._stamp = self._record.view(np.int64)[:1]
        options = options | {"ring": str(self.ring.path), "joints": list(robot.joint_names)}
        try:
            self._process = _start(options)
        except BaseException:
            self.ring.close()
            raise

    def __call__(self) -> None:
        """Hand over the pose when it is due, and take the newest handle."""
        latest = int(self._head[0])
        if latest > self._first:
            self.handle[...] = latest
        if self._wait:
            self._wait -= 1
            return
        self._wait = self._every - 1
        states, record = self._states, self._record
        record[1:4] = states["base_pos_w"]
        record[4:8] = states["base_quat"]
        record[8:] = states["joint_pos"]
        self._stamp[0] = states["stamp_ns"]
        assert self._process.stdin is not None
        try:
            os.write(self._process.stdin.fileno(), record.data)
        except OSError:  # a process that hangs or has died: the tick goes on without pictures
            self.dropped += 1

    def frame(self, handle: int) -> NDArray[Any] | None:
        """Return a frame in place, shape `message.shape`; None when it was overwritten."""
        raw = self.ring.frame(handle)
        if raw is None:
            return None
        view = self.message.data(raw.data)
        view.flags.writeable = False
        return view

    def close(self) -> None:
        """End the process and let the frames go; safe to call twice."""
        process = self._process
        if process.poll() is None and process.stdin is not None:
            process.stdin.close()
            try:
                process.wait(5.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait(5.0)
        self.ring.close()


def camera(
    context: BuildContext,
    *,
    kind: str = "color",
    camera: str | None = None,
    body: str | None = None,
    position: Sequence[float] = (0.0, 0.0, 0.0),
    fovy: float = 60.0,
    model: str | None = None,
    width: int = 320,
    height: int = 240,
    far: float = 20.0,
    rate: float = 10.0,
    topic: str = "camera/image_raw",
    frame_id: str = "",
    frame_prefix: str = "",
    handle: str = "camera_handle",
    reliability: str = "best_effort",
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
        handle: state that takes the handle; `camera_handle` is declared by itself.
        reliability: of the topic: `best_effort` or `reliable`.
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
    for label, value in (("width", width), ("height", height), ("rate", rate), ("fovy", fovy)):
        if not value > 0:
            raise UniconError(f"camera: {label} is {value}; give more than 0")
    if reliability not in ("best_effort", "reliable"):
        choices = alternatives(reliability, ("best_effort", "reliable"))
        raise UniconError(f"camera: reliability {reliability!r}; {choices}")
    if handle not in states:
        raise UniconError(
            f"camera: no state {handle!r}; declare it under 'states:' as {{dtype: int64}}"
        )
    path = find_model(model, context.relative_to) if model else model_of(platform, robot)
    name = camera or f"{body}_camera"
    options = {
        "kind": kind,
        "camera": name,
        "body": body,
        "position": [float(x) for x in position],
        "fovy": float(fovy),
        "robot": {member: str(path) for member, path in robot_files(robot).items()},
        "model": str(path),
        "width": int(width),
        "height": int(height),
        "far": float(far),
        "topic": topic,
        "frame_id": checked_prefix(frame_prefix) + (frame_id or f"{name}_optical_frame"),
        "frame_prefix": frame_prefix,
        "reliability": reliability,
        "node": node,
        "namespace": namespace,
        "ros_args": list(ros_args),
    }
    every = max(1, round(1.0 / (rate * context.period)))
    return Camera(states, robot, every, states[handle], options)


def _declares(robot: Robot, handle: str = "camera_handle", **_: Any) -> dict[str, StateSpec]:
    return {handle: StateSpec((), "int64", description="number of the newest frame, 0 if none")}


camera.declares = _declares  # type: ignore[attr-defined]


def _start(options: dict[str, Any]) -> subprocess.Popen[bytes]:
    environment = same_modules()
    guard, libraries = "_ROS_WHEELS_BOOTSTRAP_COMPLETE", "LD_LIBRARY_PATH"
    ours = str(Path(sys.prefix, "lib")) in environment.get(libraries, "").split(os.pathsep)
    if guard in environment and not ours:  # the ROS wheels of another venv have set both
        del environment[guard]
        environment.pop(libraries, None)
    profile = str(find_config("dds", "large_data", ".xml"))
    for variable in PROFILES:
        if environment.get(variable, "").endswith("fast_discovery.xml"):
            environment[variable] = profile  # which has fast discovery too
        environment.setdefault(variable, profile)
    process = subprocess.Popen(
        [sys.executable, "-m", "unicon_ros.bridge.camera_process", json.dumps(options)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        bufsize=0,
        env=environment,
    )
    try:
        told = _first_line(process)
    except BaseException:
        process.kill()
        process.wait()
        raise
    if "error" in told:
        process.wait()
        raise UniconError(told["error"])
    assert process.stdin is not None
    os.set_blocking(process.stdin.fileno(), False)
    return process


def _first_line(process: subprocess.Popen[bytes]) -> dict[str, Any]:
    assert process.stdout is not None
    ready, _, _ = select.select([process.stdout], [], [], START)
    line = process.stdout.readline() if ready else b""
    if not line:
        how = "ended at once" if ready else f"was not ready after {START:g} s"
        raise UniconError(f"camera: its process {how}; see what it wrote above")
    told: dict[str, Any] = json.loads(line)
    return told
