"""Platform `ros`: a robot (or Gazebo) that lives behind plain ROS 2 topics, for workflows.

    platform: ros
    platforms:
      ros: {map: ros_robot}       # its states in, its commands out
    pacing: {trigger: state}      # tick when joint states arrive

What the map subscribes is what `recv` writes, polled raw and drained to the latest; what it
publishes is what `send` reads. A topic that is silent for its `timeout` is a fault.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from unicon_core.blocks.projected_gravity import projected_gravity
from unicon_core.errors import Fault, MissingDependencyError, PlatformError, UniconError
from unicon_core.resources import find_config
from unicon_core.robots import Robot
from unicon_core.states import States
from unicon_core.states.standard import COMMAND_STATES
from unicon_msgs_map import Decoder, Encoder, MapError, MapStateError, load_map
from unicon_ros import compat
from unicon_ros.bridge.map_fit import examine_platform
from unicon_ros.bridge.middleware_threads import calm_middleware_threads
from unicon_ros.bridge.own_node import OwnNode
from unicon_ros.bridge.topics_in import TopicIn
from unicon_ros.bridge.topics_out import TopicOut

__all__ = ["RosPlatform", "make"]


def make(
    states: States,
    robot: Robot,
    period: float,
    *,
    map: str = "ros_robot",
    node_name: str = "unicon_platform",
    namespace: str | None = None,
    ros_args: Sequence[str] = (),
    connect: float = 5.0,
    relative_to: Path | None = None,
) -> RosPlatform:
    """Build the platform and wait for the robot.

    Args:
        period: of a tick in [s].
        map: name in `config/maps/` or path; its subscriptions write the robot's states, its
            publications read the commands.
        node_name: of the node of its own that the platform makes.
        namespace: of that node.
        ros_args: ROS arguments of that node, such as remaps.
        connect: how long to wait for the first message of each topic in [s].
        relative_to: folder of the workflow, for a relative map path.

    Raises:
        MissingDependencyError: rclpy is not installed.
        PlatformError: the map does not fit, or no message came in time.
    """
    if states.num_robots is not None:
        raise PlatformError("platform 'ros' has one robot; leave num_robots out")
    path = find_config("maps", map, error=PlatformError, relative_to=relative_to)
    own = OwnNode(node_name, namespace, ros_args)
    try:
        platform = RosPlatform(states, robot, period, path, own)
    except MissingDependencyError:
        own.close()
        raise
    except (UniconError, MapError) as error:
        own.close()
        raise PlatformError(f"platform 'ros': {error}") from error
    try:
        platform.connect(connect)
    except BaseException:
        platform.close()
        raise
    return platform


# What `unicon check` may ask before anything is opened.
make.examine = examine_platform  # type: ignore[attr-defined]


class RosPlatform:
    """A robot behind topics; build it with `make`.

    Attributes:
        topics: full names of the topics that it reads and writes.
    """

    name = "ros"
    simulated = False

    def __init__(
        self, states: States, robot: Robot, period: float, path: Path, own: OwnNode
    ) -> None:
        self._states, self._robot, self._own, self._path = states, robot, own, path
        mapping = load_map(path)
        arrays = {name: states[name] for name in states}
        names = {name: spec.names for name, spec in states.layout.specs.items() if spec.names}
        variables: dict[str, object] = {"joint_names": list(robot.joint_names)}
        group = compat.polled_group()
        self._warnings: list[str] = []
        self._in: list[TopicIn] = []
        self._out: list[TopicOut] = []
        self._needed: list[TopicIn] = []
        for given in mapping.subscribe:
            # Silence is a fault here; zeros in its place would be commanded by the last damping.
            spec = replace(given, on_timeout="hold")
            made = _made(spec, partial(Decoder.build, spec, arrays, names, variables))
            if made is not None:
                decoder, message = made
                topic = TopicIn(own.node, decoder, message, False, group, self._warnings.append)
                self._in.append(topic)
                if not spec.optional:
                    self._needed.append(topic)
        for entry in mapping.publish:
            made = _made(entry, partial(Encoder.build, entry, arrays, names, variables))
            if made is not None:
                encoder, message = made
                every, warn = entry.every(period), self._warnings.append
                self._out.append(TopicOut(own.node, encoder, message, every, 0, group, warn))
        if not self._in:
            raise PlatformError(f"map {path} subscribes to nothing; a robot tells its joint_pos")
        if not all(topic.polled for topic in self._in):
            raise PlatformError("this rclpy cannot be polled; use one of Humble, Jazzy or Kilted")
        heard, said = [topic.topic for topic in self._in], [out.topic for out in self._out]
        self.topics = (*heard, *said)
        written = dict.fromkeys(state for topic in self._in for state in topic.states)
        self._stamped = "stamp_ns" in written
        self._gravity: Callable[[], None] | None = None
        if "base_quat" in written and "projected_gravity" not in written:
            self._gravity = projected_gravity(states["base_quat"], states["projected_gravity"])
            written["projected_gravity"] = None
        self.writes = tuple(dict.fromkeys([*written, "stamp_ns"]))
        self.reads = tuple(
            dict.fromkeys(
                state
                for out in self._out
                for state in out.block.reads
                if state not in self.writes or state in COMMAND_STATES
            )
        )
        self._wait_set = compat.ReusedWaitSet([self._in[0].subscription], own.context)
        self._closed = False

    def connect(self, timeout: float) -> None:
        """Wait for the first message of every topic that is not optional.

        Raises:
            PlatformError: none came within `timeout` in [s].
        """
        end = time.monotonic() + timeout
        while missing := [topic for topic in self._needed if not topic.heard]:
            for topic in self._in:
                topic.poll()
            if time.monotonic() > end:
                silent = missing[0]
                said = "; ".join(dict.fromkeys([*self._warnings, silent.last_error])).strip("; ")
                raise PlatformError(
                    f"platform 'ros': no message on {silent.topic} within {timeout:g} s"
                    f"{f' ({said})' if said else ''}; start the robot, or correct namespace, "
                    f"remaps or the map {self._path}"
                )
            self._own.executor.spin_once(0.005)  # tells what a peer's QoS does not match
        calm_middleware_threads()

    def wait(self, timeout: float) -> bool:
        """Return True when the first topic of the map has a message, False after `timeout` [s]."""
        first = self._in[0]
        if first.prefetch():
            return True
        self._wait_set.sleep(timeout)
        return first.prefetch()

    def arrivals(self) -> int:
        """Return how many messages of that topic have come so far."""
        return self._in[0].received

    def recv(self) -> bool | None:
        """Bring the latest messages into the states.

        Raises:
            Fault: a topic that the robot needs was silent for its time-out.
        """
        self._in[0].accept()
        for topic in self._in[1:]:
            topic.poll()
        for topic in self._needed:
            if topic.stale:
                raise Fault(f"{topic.silence}; the robot is silent")
        if self._gravity is not None:
            self._gravity()
        if not self._stamped:
            self._states.stamp_ns[...] = time.monotonic_ns()
        return None

    def rehearse(self) -> None:
        """Do what `send` does up to the publishing, to warm up."""
        for out in self._out:
            out.rehearse()

    def send(self) -> bool | None:
        """Publish the commands that are due."""
        for out in self._out:
            out.tick()
        return None

    def close(self) -> None:
        """Send a damping command (no stiffness, targets where the joints are), then let go."""
        if self._closed:
            return
        self._closed = True
        states, damping = self._states, np.nan_to_num(self._robot.joint_damping)
        if any(topic.heard for topic in self._in):
            states.joint_pos_target[...] = states.joint_pos
            states.joint_vel_target[...] = 0.0
            states.joint_effort_ff[...] = 0.0
            states.joint_stiffness[...] = 0.0
            states.joint_damping[...] = damping
            for out in self._out:
                out.flush()
        self._wait_set.close()
        for topic in self._in:
            topic.close()
        for out in self._out:
            out.close()
        self._own.close()

    def reset(self) -> None:
        """Nothing: a robot is not put back."""

    def info(self) -> Mapping[str, Any]:
        """Return map, topics and what came in."""
        return {
            "map": str(self._path),
            "topics": list(self.topics),
            "received": {topic.topic: topic.received for topic in self._in},
            "published": {out.topic: out.published for out in self._out},
            "notes": list(self._warnings),
        }


def _made(spec: Any, build: Callable[[], Any]) -> tuple[Any, Any] | None:
    """Return codec and message class; None where either is missing and the entry is optional."""
    message = compat.message_class(spec.type)
    if message is None:
        if spec.optional:
            return None
        package = spec.type.split("/")[0]
        raise PlatformError(
            f"{spec.where or spec.topic}: the type {spec.type} is not installed; "
            f"install the ROS package {package}"
        )
    try:
        return build(), message
    except MapStateError:
        if spec.optional:
            return None
        raise
