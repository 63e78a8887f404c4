"""RealSense: colours and depths of one camera, in pairs, by handles and as topics.

    commands:
      - realsense: {serial: "123456789012", aligned: true, topic: front}

`realsense_color_handle` and `realsense_depth_handle` number frames of one moment; each frame is a
whole sensor_msgs/Image. Depths are 32FC1 in [m] with NaN where nothing was measured (REP-118), as
the simulated camera's are: who reads one reads the other. The camera's own uint16 count units of
its own (1 mm by default, 0.1 mm of a D405), so millimetres in 16UC1 would lose what it measures.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from unicon_core.flow import Block
from unicon_core.states import StateSpec
from unicon_core.workflow.autowire import BuildContext
from unicon_ros.bridge.bindings import checked_prefix
from unicon_ros.bridge.camera_topics import RELIABILITIES, large_data, topic_options
from unicon_ros.bridge.images import FrameMessage, frame_message
from unicon_ros.peripherals.peripheral import (
    check_positive,
    peripheral_block,
    peripheral_states,
)

PROCESS = "unicon_ros.peripherals.realsense_process"


def realsense(
    *,
    context: BuildContext,
    prefix: str = "realsense",
    serial: str = "",
    width: int = 640,
    height: int = 480,
    rate: int = 30,
    aligned: bool = False,
    cloud: bool = False,
    topic: str = "",
    frame_prefix: str = "",
    stale: float = 0.3,
    reliability: str = RELIABILITIES[0],
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
    check_positive(name, width=width, height=height, rate=rate)
    options = {
        "serial": str(serial),
        "size": [int(width), int(height)],
        "rate": int(rate),
        "aligned": bool(aligned),
        "cloud": bool(cloud),
        "topic": topic,
        "frame_prefix": checked_prefix(frame_prefix),
        "ros": topic_options(name, node or name, namespace, ros_args, reliability),
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


def messages(name: str, options: dict[str, Any]) -> dict[str, FrameMessage]:
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
