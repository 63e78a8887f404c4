"""Block `livox`: clouds and IMU of a Livox Mid-360, received by a process of its own.

    commands:
      - livox: {lidar: 192.168.1.112}

A cloud is a whole sensor_msgs/PointCloud2 of 0.1 s in a `FrameRing`; the state
`livox_cloud_handle` numbers the newest.
"""

from __future__ import annotations

import ipaddress
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal

from unicon_base import WorkflowError
from unicon_base.schema.marks import Within
from unicon_core.flow import Block
from unicon_core.states import StateSpec
from unicon_core.workflow.autowire import BuildContext
from unicon_hardware.peripherals.livox.cloud import livox_message
from unicon_ros.bridge.images import Reliability, large_data, topic_options
from unicon_ros.peripheral import peripheral_block, peripheral_states

MODULE = "unicon_hardware.peripherals.livox.process"
Port = Annotated[int, Within(1024, 65535)]


def livox(
    context: BuildContext,
    *,
    lidar: str,
    host: str = "",
    point_port: Port = 56301,
    imu_port: Port = 56401,
    data_type: Literal[1, 2, 3] = 1,
    configure: bool = True,
    checksum: bool = True,
    silence: Annotated[float, Within(0.05, 10.0, "s")] = 0.2,
    frame_id: str = "livox_frame",
    prefix: str = "livox",
    topic: str = "",
    reliability: Reliability = "reliable",
    node: str = "",
    namespace: str | None = None,
    ros_args: Sequence[str] = (),
) -> Block:
    """Write the newest cloud's handle and the IMU of a Mid-360.

    Args:
        context: of the workflow.
        lidar: address of the scanner: 192.168.1.1 and the last two digits of its serial number.
        host: address of this computer; the one on the way to the scanner if empty.
        point_port: of this computer; another one for each scanner.
        imu_port: of this computer; another one for each scanner.
        data_type: of the points: 1 in [mm], 2 in [cm] and shorter, 3 spherical.
        configure: tell the scanner where to send; else another program has done so.
        checksum: refuse what does not fit its checksum.
        silence: without points for so long it is not there, in [s].
        frame_id: of the clouds: the scanner's own frame, x forward, y left, z up.
        prefix: stands before the names of its states.
        topic: where the clouds are published too, such as `livox/points`; nowhere if empty.
        reliability: of the topic: `reliable`, which every subscriber gets, or `best_effort`.
        node: name of the process's node; that of its states if empty.
        namespace: of that node.
        ros_args: ROS arguments of that node, such as remaps.

    Raises:
        WorkflowError: an option is wrong.
        UniconError: another program has the ports, or the topic cannot be.
        MissingDependencyError: rclpy is not installed, and a topic is given.
    """
    for label, address in (("lidar", lidar), ("host", host or "127.0.0.1")):
        try:
            ipaddress.IPv4Address(address)
        except ValueError as error:
            raise WorkflowError(
                f"livox: {label} is {address!r}; give an IPv4 address such as 192.168.1.112"
            ) from error
    if point_port == imu_port:
        raise WorkflowError(f"livox: point_port and imu_port are {imu_port}; give two ports")
    options = {
        "lidar": lidar,
        "host": host,
        "point_port": point_port,
        "imu_port": imu_port,
        "data_type": data_type,
        "configure": configure,
        "checksum": checksum,
        "silence": silence,
        "frame_id": frame_id,
        "topic": topic,
        "ros": topic_options(node or prefix, namespace, ros_args, reliability),
    }
    return peripheral_block(
        context,
        prefix,
        MODULE,
        options,
        values=_values(prefix),
        frames={"cloud": livox_message(frame_id)},
        environment=large_data() if topic else None,
    )


def _values(name: str) -> Mapping[str, StateSpec]:
    return {
        f"{name}_ang_vel": StateSpec((3,), unit="rad/s", frame=name, description="turning"),
        f"{name}_lin_acc": StateSpec(
            (3,), unit="m/s²", frame=name, description="acceleration, gravity in it"
        ),
        f"{name}_lost": StateSpec((), "int64", description="datagrams that did not come"),
        f"{name}_refused": StateSpec((), "int64", description="datagrams that were not taken"),
    }


def _declares(prefix: str = "livox", **_: Any) -> Mapping[str, StateSpec]:
    return peripheral_states(prefix, _values(prefix), ["cloud"])


setattr(livox, "declares", _declares)  # noqa: B010  a function has none to mypy
